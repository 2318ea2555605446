"""Folders that cannot be written are told in a sentence."""

from pathlib import Path

import pytest

from drake_quad import InputError
from drake_quad.files import output_folder


@pytest.mark.parametrize("name", ["a\0b", "x" * 5000, "a\nb/" + "x" * 300])
def test_a_folder_that_cannot_be_named_so_is_refused(tmp_path, name):
    with pytest.raises(InputError, match="^the output folder .* cannot be written: .") as caught:
        output_folder(tmp_path / name)
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) <= 300


def test_a_folder_below_a_file_is_refused(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(InputError, match="cannot be written: not a directory"):
        output_folder(Path(tmp_path / "file" / "folder"))
