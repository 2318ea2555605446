"""Tests of the error for an optional library that is not installed."""

import sys

import pytest

from drake_quad.extras import import_extra


def test_the_error_for_a_missing_library_names_the_extra_that_installs_it():
    with pytest.raises(
        ImportError, match=r"^no_library is not installed; install it with: pip install 'drake_quad\[plots\]'$"
    ):
        import_extra("no_library.part", "plots")


def test_a_broken_library_is_not_reported_as_missing(tmp_path, monkeypatch):
    (tmp_path / "broken_library.py").write_text("import no_library\n", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ImportError, match="No module named 'no_library'"):
        import_extra("broken_library", "plots")
    assert "broken_library" not in sys.modules
