"""Tests that numbers in files, tables and options must have ASCII digits.

Python itself also accepts "1_0" and digits of other scripts.
"""

import re
from pathlib import Path

import numpy as np
import pytest

from drake_quad.command_line.main import COMMANDS, command_module
from drake_quad.errors import InputError
from drake_quad.files import read_table
from drake_quad.logs.reading import read_log
from drake_quad.number_parsing import parse_float, parse_int
from drake_quad.scenario.files.loading import load_mission
from drake_quad.scenario.files.mesh_file import mesh_points

INVALID_NUMBERS = ["1_0", "١", "１", "1_0.5"]
PACKAGE = Path(__file__).parent.parent / "drake_quad"


@pytest.mark.parametrize("text", [*INVALID_NUMBERS, "", "one"])
def test_text_that_is_no_number_in_ascii_digits_is_refused(text):
    for read in (parse_float, parse_int):
        with pytest.raises(ValueError, match=r"."):
            read(text)


def test_numbers_in_ascii_digits_are_converted_as_by_python():
    assert (parse_float("-1.5e3"), parse_float(" .5 "), parse_int("+12")) == (-1500.0, 0.5, 12)
    assert np.isnan(parse_float("nan"))


@pytest.mark.parametrize("cell", INVALID_NUMBERS)
@pytest.mark.parametrize(
    ("name", "text", "read"),
    [
        ("course.csv", "0,0,1\nCELL,0,1\n", load_mission),
        ("pieces.csv", "duration,x^0,y^0,z^0\n1,0,CELL,1\n", load_mission),
        ("log.csv", "timestamp,battery_status.voltage_v\n0,3.9\n1,CELL\n2,3.9\n", read_log),
        ("rock.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 CELL\n", mesh_points),
        ("a.yaml", "a: {route: {kind: hover, duration: CELL}}\n", load_mission),
    ],
)
def test_no_file_reader_accepts_numbers_in_other_notations(tmp_path, name, text, read, cell):
    path = tmp_path / name
    path.write_text(text.replace("CELL", cell), encoding="utf-8")
    with pytest.raises(InputError, match=name):
        read(path)
    path.write_text(text.replace("CELL", "10"), encoding="utf-8")
    read(path)


def test_a_table_column_that_contains_another_notation_is_read_as_text(tmp_path):
    (tmp_path / "table.csv").write_text("a,b\n1_0,1\n2,2\n")
    assert read_table(tmp_path / "table.csv")["a"].tolist() == ["1_0", "2"]


@pytest.mark.parametrize("arguments", [["study", "--samples"], ["fly", "--rate"], ["study", "--seed"]])
def test_numbers_in_options_must_have_ascii_digits(arguments, capsys):
    command, option = arguments
    for value in ("1_0", "١"):
        with pytest.raises(SystemExit):
            command_module(command).options().parse_args([option, value])
        assert re.search(rf"error: {option}: invalid (int|float) value: '{value}'", capsys.readouterr().err)


@pytest.mark.slow
def test_every_command_reads_its_numbers_in_ascii_digits():
    for command in COMMANDS:
        options = command_module(command).options()
        for kind, read in ((int, parse_int), (float, parse_float)):
            assert options._registry_get("type", kind, kind) is read
