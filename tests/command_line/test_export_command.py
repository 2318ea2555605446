"""Tests of the command that exports controllers, and of flights with exported code."""

import shutil

import pytest

from drake_quad.files import read_table

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")


@pytest.mark.long
def test_exported_code_can_be_the_controller_in_every_command(run, tmp_path):
    exported = tmp_path / "exported"
    result = run("export", "laboratory:nominal", "--output", exported)
    assert result.returncode == 0
    assert "measurement, reference" in result.stdout
    assert f"drake-quad fly laboratory:nominal --controller {exported}" in result.stdout
    names = ["controller.h", "controller.c", "export.json", "scenario.yaml"]
    assert sorted(file.name for file in exported.iterdir()) == sorted(names)
    short = ("--samples", "2", "--set", "duration=0.3", "--set", "metrics={start: 0, end: null}")
    errors = []
    for options in ([], ["--controller", exported]):
        folder = tmp_path / str(len(options))
        assert run("study", "laboratory:nominal", *short, *options, "--output", folder).returncode == 0
        (table,) = folder.rglob("results.csv")
        errors.append(read_table(table)["rmse"].tolist())
    assert errors[0] == errors[1]
    assert len(set(errors[0])) == 2


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["export", "hover", "--name", "a b"], "name is 'a b'; it must be a C identifier"),
        (["export", "onboard", "--mixer"], "mixer: the controller of onboard commands an attitude"),
        (["fly", "hover", "--on", "qemu-cortex-m7"], "--on qemu-cortex-m7 needs --controller FOLDER"),
        (["fly", "hover", "--controller", "."], "contains no exported controller"),
    ],
)
def test_wrong_options_are_refused(arguments, message, run, tmp_path):
    result = run(*arguments, "--output", tmp_path / "new")
    assert result.returncode == 2
    assert message in result.stderr
    assert not (tmp_path / "new").exists()
