"""Arduino sketch that runs the controller on a microcontroller without an operating system."""

from drake_quad.export.projects.project import ExportedCode, Project, check_single_precision, whole_steps


def _placeholders(code: ExportedCode) -> dict[str, str]:
    """Return the values of the template's placeholders.

    Raises:
        InputError: if the code has double precision, or its period is not a multiple of a microsecond.
    """
    check_single_precision("arduino", code.description)
    return {"MICROSECONDS": str(whole_steps("arduino", code.description, 1e-6, "microseconds"))}


ARDUINO = Project(_placeholders, code_folder="@NAME@_sketch")
