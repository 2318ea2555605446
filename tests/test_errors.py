"""Tests of error messages, and of the functions that format them."""

import itertools
import pickle

import numpy as np
import pytest

from drake_quad.errors import InputError, check_integer, did_you_mean, join_names, short_repr, shorten_text


@pytest.mark.parametrize("text", ["a\nb", "\x1b[31mred", "a\0b", "\u2028", "\ud800", "\ufeff"])
def test_a_message_is_on_one_line_and_can_be_printed(text):
    message = str(InputError(f"{text} is wrong"))
    assert message.isprintable()
    assert message.encode("utf-8").endswith(b" is wrong")


def test_a_message_of_printable_characters_is_not_changed():
    sentence = "vehicle.mass is -1 kg m², but must be larger than 0 – 'größer'"
    assert str(InputError(sentence)) == sentence


def test_the_middle_of_a_long_message_is_left_out():
    message = str(InputError(f"beginning {'x' * 10_000} end"))
    assert len(message) == 400
    assert message.startswith("beginning xxx")
    assert message.endswith("xxx end")


def test_long_values_texts_and_lists_are_shortened():
    assert shorten_text("a" * 60) == "a" * 60
    assert shorten_text("a" * 50 + "b" * 50) == "a" * 38 + "..." + "b" * 19
    assert len(short_repr(list(range(10_000)))) == 60
    assert join_names([f"n{i}" for i in range(8)]).endswith("n6, n7")
    assert join_names([f"n{i}" for i in range(10)]).endswith("n7, and 2 more")


def test_at_most_two_similar_names_are_suggested():
    assert did_you_mean("mas", ["mass", "drag", "mask", "mast"]) in {
        f"did you mean {first} or {second}?" for first, second in itertools.permutations(["mass", "mask", "mast"], 2)
    }
    assert did_you_mean("mas", ["drag"]) == ""


def test_a_message_survives_pickling():
    error = InputError("a\nb is 1\\2")
    assert str(pickle.loads(pickle.dumps(error))) == str(error)


@pytest.mark.parametrize("value", [3, np.int64(3), 5])
def test_whole_numbers_within_their_bounds_are_accepted(value):
    assert check_integer(value, "count", minimum=3, maximum=5) == value


@pytest.mark.parametrize(
    ("value", "max_value", "words"),
    [
        (2, None, "count is 2, but must be at least 3"),
        (2, 5, "count is 2, but must be from 3 to 5"),
        (6, 5, "count is 6, but must be from 3 to 5"),
        (4.0, None, "count is 4.0, but must be a whole number, at least 3"),
        (True, None, "count is True, but must be a whole number, at least 3"),
    ],
)
def test_numbers_that_are_out_of_bounds_or_not_whole_are_refused(value, max_value, words):
    with pytest.raises(InputError, match=f"^{words}$"):
        check_integer(value, "count", minimum=3, maximum=max_value)
