"""Tests of atomic writing, and of the errors for unusable output folders and damaged .npz files."""

import io
import threading
import warnings
import zipfile
from pathlib import Path

import numpy as np
import pytest

from drake_quad import InputError
from drake_quad.files import output_folder, read_arrays, write_atomically, write_text


@pytest.mark.parametrize("name", ["a\0b", "x" * 5000, "a\nb/" + "x" * 300])
def test_a_folder_with_an_invalid_name_is_refused(tmp_path, name):
    with pytest.raises(InputError, match="^cannot write to the output folder .*: .") as caught:
        output_folder(tmp_path / name)
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) <= 300


def test_a_folder_whose_parent_is_a_file_is_refused(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(InputError, match="cannot write to the output folder .*: not a directory"):
        output_folder(Path(tmp_path / "file" / "folder"))


def test_a_file_that_two_threads_write_at_once_is_complete(tmp_path):
    gate = threading.Barrier(2)

    def write(text):
        def fill(path):
            path.write_text(text[:5])
            gate.wait(10.0)
            path.write_text(text)

        write_atomically(tmp_path / "file.txt", fill)

    texts = ["one" * 1000, "two" * 1000]
    threads = [threading.Thread(target=write, args=(text,)) for text in texts]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [path.name for path in tmp_path.iterdir()] == ["file.txt"]
    assert (tmp_path / "file.txt").read_text() in texts


def npz(*members):
    """Return an .npz file, given pairs of the name of a member and its content in bytes."""
    file = io.BytesIO()
    with warnings.catch_warnings(action="ignore"), zipfile.ZipFile(file, "w") as packed:
        for name, data in members:
            packed.writestr(name, data)
    file.seek(0)
    return file


def npy(array):
    file = io.BytesIO()
    np.save(file, array, allow_pickle=True)
    return file.getvalue()


def npy_header(shape, kind="'<f8'"):
    """Return the bytes of an .npy file without data, given the text of the shape and of the data type in its header."""
    header = f"{{'descr': {kind}, 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header


ARRAY_BYTES = npy(np.arange(3.0))


def test_arrays_are_read_by_name():
    arrays = read_arrays(npz(("a.npy", ARRAY_BYTES), ("b.npy", npy(np.array("word")))))
    assert [*arrays] == ["a", "b"]
    np.testing.assert_array_equal(arrays["a"], [0.0, 1.0, 2.0])
    assert str(arrays["b"]) == "word"


@pytest.mark.parametrize(
    ("file", "words"),
    [
        (npz(("a.npy", b"no magic")), "is not an .npz file of arrays"),
        (npz(("a", ARRAY_BYTES[1:])), "is not an .npz file of arrays"),
        (npz(("a.npy", npy_header("(" * 300 + ")" * 300))), "is not an .npz file of arrays"),
        (npz(("a.npy", npy_header("(" * 300))), "is not an .npz file of arrays"),
        (npz(("a.npy", npy_header("(-1, 99999999999999999999)"))), "is not an .npz file of arrays"),
        (
            npz(("a.npy", npy_header("(3L,)"))),  # a header as Python 2 wrote them, about which NumPy warns
            "is not an .npz file of arrays",
        ),
        (npz(("a.npy", npy(np.array([object()])))), "is not an .npz file of arrays"),
        (npz(("a.npy", ARRAY_BYTES), ("a.npy", ARRAY_BYTES)), "contains two arrays named 'a'"),
        (npz(("a.npy", ARRAY_BYTES), ("a", ARRAY_BYTES)), "contains two arrays named 'a'"),
        (npz(("a.npy", npy(np.zeros(100)))), "is too large: its arrays have more than 800 bytes"),
        (io.BytesIO(b"PK"), "is not an .npz file of arrays"),
    ],
)
def test_a_damaged_or_oversized_npz_file_is_reported_in_one_sentence(file, words):
    with pytest.raises(ValueError, match=f"^{words}$"):
        read_arrays(file, max_bytes=800)


def test_a_failed_write_does_not_change_the_file(tmp_path):
    path = write_text(tmp_path / "kept.txt", "before")

    def write_half(target):
        target.write_text("half", encoding="utf-8")
        raise OSError("the disk is full")

    with pytest.raises(OSError, match="the disk is full"):
        write_atomically(path, write_half)
    assert [file.name for file in tmp_path.iterdir()] == ["kept.txt"]
    assert path.read_text(encoding="utf-8") == "before"
