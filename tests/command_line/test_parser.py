"""Tests that a mistake in a command line leads to status 2 and one sentence, which suggests the nearest name."""

import re

import pytest

from drake_quad.command_line.main import COMMANDS, command_module


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["study", "--output", ""], "--output is empty; was a shell variable without a value used?"),
        (["study", "--output="], "--output is empty; was a shell variable without a value used?"),
        (["fly", ""], "an argument is empty; was a shell variable without a value used?"),
        (["flyy"], "there is no command called 'flyy'; did you mean fly?"),
        (["fly", "--sampel", "3"], "drake-quad fly has no option --sampel; did you mean --sample?"),
        (["study", "--sampels=3"], "drake-quad study has no option --sampels; did you mean --samples?"),
        (["identify", "--nominale"], "drake-quad identify has no option --nominale; did you mean --nominal?"),
        (["map", "--k-p", "-1", "2", "--quik"], "drake-quad map has no option --quik; did you mean --quick?"),
        (["fly", "--zzz"], "drake-quad fly has no option --zzz; `drake-quad fly --help` describes all arguments"),
        (["fly", "hover", "2"], "drake-quad fly does not take the argument '2'; `drake-quad fly --help` describes"),
        (["study", "--metric", "rmsee"], "--metric: rmsee is not a metric of robustness; did you mean rmse?"),
        (["fly", "--vector", "tiff"], "there is no value of --vector called 'tiff'; there are pdf, svg"),
        (["completion", "bsh"], "there is no shell called 'bsh'; did you mean bash"),
        (["study", "--samples"], "--samples: expected one argument"),
        (["study", "--samples", "x"], "--samples: invalid int value: 'x'"),
        (["identify"], "the following arguments are required: log"),
        (["judge", "--only", "pdd"], "there is no value of --only called 'pdd'; did you mean pd or pid?"),
        (["study", "robustness", "--over", "vehicle.mas"], "is not a random parameter of .* mean vehicle.mass[?]"),
        (["tune", "hover", "--tune", "control.position.kp"], "has no field control.position.kp; did you mean k_p[?]"),
        (["fly", "hovr"], "'hovr' is neither a file nor a shipped scenario; did you mean hover?"),
        (["fly", "laboratory:hgh_wind"], "no scenario 'hgh_wind' in .* contains .*; did you mean high_wind[?]"),
        (["fly", "--controller", "controllers/lqg:lqgg"], "no scenario 'lqgg' in .*; did you mean lqg[?]"),
        (["fly", "--import", "absent.py"], "--import absent.py is not an existing Python file"),
    ],
)  # fmt: skip
def test_a_mistake_is_reported_in_one_sentence_with_the_nearest_name(run, arguments, sentence):
    result = run(*arguments)
    assert (result.returncode, result.stdout) == (2, "")
    last = result.stderr.splitlines()[-1]
    assert last.startswith("error: ")
    assert sentence in last or re.search(sentence, last)
    assert "usage:" not in result.stderr


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS)
def test_each_command_suggests_its_options(command, capsys):
    parser = command_module(command).options()
    for option in parser._option_string_actions:
        if not option.startswith("--"):
            continue
        misspelt = f"{option[:-1]}q{option[-1]}"
        with pytest.raises(SystemExit) as stop:
            parser.parse_args([misspelt])
        assert stop.value.code == 2
        assert f"has no option {misspelt}; did you mean --" in capsys.readouterr().err


def test_abbreviated_options_and_arguments_after_two_dashes_are_accepted():
    parser = command_module("study").options()
    assert parser.parse_args(["--sampl", "3"]).samples == 3
    assert parser.parse_args(["--", "--strange-name"]).scenario == "--strange-name"
