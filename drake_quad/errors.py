"""The errors that a person can cause and the ones that a computation can."""


class InputError(ValueError):
    """Something that a person wrote is wrong; the message is one sentence that says what and what is allowed."""
