import re
from pathlib import Path

import pytest

from drake_quad import load_scenario

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL)


@pytest.mark.parametrize("block", blocks("python"))
def test_every_block_of_python_runs(block, tmp_path, monkeypatch, capsys):
    (tmp_path / "diagrams").symlink_to(ROOT / "diagrams")
    monkeypatch.chdir(tmp_path)
    exec(compile(block, "README.md", "exec"), {"__name__": "__main__"})
    assert " cm" in capsys.readouterr().out


@pytest.mark.parametrize("block", blocks("yaml"))
def test_every_scenario_loads(block, tmp_path):
    for shipped in (ROOT / "diagrams").iterdir():
        (tmp_path / shipped.name).symlink_to(shipped)
    path = tmp_path / "loop.yaml"
    path.write_text(block, encoding="utf-8")
    load_scenario(path)


def test_every_path_that_it_names_exists():
    for path in re.findall(r"`((?:drake_quad|diagrams|scripts)/[\w./]*)`", README):
        assert (ROOT / path).exists(), path
