"""Tests that results files keep all written rows and reject foreign rows."""

import resource
import signal

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from drake_quad import InputError
from drake_quad.studies.results_file import ResultsFile, RowFormat, open_results, read_results, write_results

ROW_FORMAT = RowFormat(["sample", "vehicle.mass", "rmse", "crash_time", "crashed"], "this study")
ROWS = np.array(
    [[3.0, 0.681234567890123, 0.5, np.inf, 0.0], [1.0, 0.7, np.nan, 4.02, 1.0], [0.0, 0.69, 1e-7, np.inf, 0.0]]
)


def write(path, rows=ROWS, form=ROW_FORMAT):
    with open_results(path, form) as (file, stored_rows):
        file.append(rows)
    return stored_rows


def test_rows_are_read_as_they_were_written(tmp_path):
    path = tmp_path / "results.csv"
    assert len(write(path).rows) == 0
    result = read_results(path, ROW_FORMAT)
    np.testing.assert_allclose(result.rows, ROWS, rtol=1e-11)
    np.testing.assert_array_equal(result.lines, [2, 3, 4])
    assert result.invalid_lines == []
    lines = path.read_text().splitlines()
    assert lines[0] == "sample,vehicle.mass,rmse,crash_time,crashed,checksum"
    assert lines[2].startswith("1,0.7,,4.02,1,")


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=60)
@given(data=st.data())
def test_truncation_loses_only_the_incomplete_row(tmp_path, data):
    path = tmp_path / "results.csv"
    path.unlink(missing_ok=True)
    write(path)
    content = path.read_bytes()
    length = data.draw(st.integers(0, len(content)))
    path.write_bytes(content[:length])
    left = max(content[:length].count(b"\n") - 1, 0)
    with open_results(path, ROW_FORMAT) as (file, result):
        np.testing.assert_array_equal(result.rows[:, 0], ROWS[:left, 0])
        file.append(ROWS[left:])
    assert path.read_bytes() == content


@pytest.mark.slow
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=200)
@given(data=st.data())
def test_any_alteration_of_a_row_is_detected(tmp_path, data):
    """A character of the index, a value or the checksum is replaced, added or removed."""
    path = tmp_path / "results.csv"
    write_results(path, ROW_FORMAT, ROWS)
    lines = path.read_bytes().split(b"\n")
    row = data.draw(st.integers(1, len(ROWS)))
    line = lines[row]
    position, length = data.draw(st.integers(0, len(line))), data.draw(st.integers(0, 1))
    new = data.draw(st.sampled_from([b"", *(bytes([code]) for code in b"0123456789abcdef.,-+einf \r\0\xff")]))
    lines[row] = line[:position] + new + line[position + length :]
    assume(lines[row] != line)
    path.write_bytes(b"\n".join(lines))
    result = read_results(path, ROW_FORMAT)
    assert result.invalid_lines == [row + 1]
    np.testing.assert_array_equal(result.rows[:, 0], np.delete(ROWS[:, 0], row - 1))


def test_foreign_and_repeated_rows_are_ignored(tmp_path):
    path = tmp_path / "results.csv"
    write(path)
    write_results(tmp_path / "other.csv", ROW_FORMAT._replace(study="another study"), ROWS[:1])
    foreign_rows = (tmp_path / "other.csv").read_bytes().split(b"\n", 1)[1]
    repeated_row = path.read_bytes().splitlines(keepends=True)[1]
    path.write_bytes(path.read_bytes() + foreign_rows + repeated_row)
    result = read_results(path, ROW_FORMAT)
    np.testing.assert_array_equal(result.rows[:, 0], ROWS[:, 0])
    assert result.invalid_lines == [5]


def test_rewriting_a_results_file_does_not_change_it(tmp_path):
    path = tmp_path / "results.csv"
    rows = np.random.default_rng(1).normal(size=(200, len(ROW_FORMAT.columns))) * 10.0 ** np.arange(-100, 100)[:, None]
    rows[:, 0] = np.arange(200)
    write(path, rows)
    content = path.read_bytes()
    write_results(path, ROW_FORMAT, read_results(path, ROW_FORMAT).rows)
    assert path.read_bytes() == content


@pytest.mark.parametrize("content", ["time,x\n0,1\n", "notes about something that is no table at all, and long\n"])
def test_a_foreign_file_is_refused_and_not_changed(tmp_path, content):
    path = tmp_path / "results.csv"
    path.write_text(content)
    with pytest.raises(InputError, match="its columns are different"), open_results(path, ROW_FORMAT):
        pass
    assert path.read_text() == content


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(InputError, match=r"results\.csv cannot be read: no such file or directory"):
        read_results(tmp_path / "results.csv", ROW_FORMAT)


def test_two_runs_cannot_write_to_the_same_file(tmp_path):
    path = tmp_path / "results.csv"
    with open_results(path, ROW_FORMAT), pytest.raises(InputError, match="another run"), open_results(path, ROW_FORMAT):
        pass


def test_a_full_disk_leaves_only_complete_rows(tmp_path):
    """A limit on the file size interrupts a write, as a full disk does."""
    path = tmp_path / "results.csv"
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    previous_handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        with open_results(path, ROW_FORMAT) as (file, _):
            file.append(ROWS[:1])
            content = path.read_bytes()
            resource.setrlimit(resource.RLIMIT_FSIZE, (len(content) + 10, limits[1]))
            with pytest.raises(OSError, match="too large"):
                file.append(ROWS[1:])
            assert path.read_bytes() == content
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
            file.append(ROWS[1:])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, previous_handler)
    assert read_results(path, ROW_FORMAT).rows.shape == ROWS.shape


def test_partial_writes_are_completed(tmp_path):
    """A write may accept only a part of the data, as on a network drive."""
    path = tmp_path / "results.csv"

    class FileWithPartialWrites:
        def __init__(self, file):
            self.file = file

        def seek(self, *where):
            return self.file.seek(*where)

        def write(self, text):
            return self.file.write(text[:7])

    with path.open("a+b", buffering=0) as file:
        file.write(ROW_FORMAT.header)
        ResultsFile(path, ROW_FORMAT, FileWithPartialWrites(file)).append(ROWS)
    assert path.read_bytes() == ROW_FORMAT.header + ROW_FORMAT.text(ROWS)


def test_a_file_with_only_a_header_has_no_rows(tmp_path):
    path = tmp_path / "results.csv"
    for content in (b"", ROW_FORMAT.header[:9], ROW_FORMAT.header):
        path.write_bytes(content)
        with open_results(path, ROW_FORMAT) as (_, result):
            assert (result.rows.shape, result.lines.tolist(), result.invalid_lines) == ((0, 5), [], [])
        assert path.read_bytes() == ROW_FORMAT.header
