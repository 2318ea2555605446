"""Test that all files that contain the version of the package agree."""

import re
from importlib.metadata import version

import drake_quad


def test_all_files_have_the_same_version(root):
    newest = re.search(r"^## (\S+) \((\S+)\)", (root / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    citation = (root / "CITATION.cff").read_text(encoding="utf-8")
    assert newest[1] == drake_quad.__version__
    assert f"\nversion: {drake_quad.__version__}\ndate-released: {newest[2]}\n" in citation
    assert version("drake_quad") == drake_quad.__version__
