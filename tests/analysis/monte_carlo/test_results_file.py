"""A results file loses nothing that was written, and takes nothing that is not its own."""

import resource
import signal

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drake_quad import InputError
from drake_quad.analysis.monte_carlo.results_file import open_results, read_rows, sort_results

COLUMNS = ["sample", "vehicle.mass", "rmse", "crash_time"]
ROWS = np.array([[3.0, 0.681234567890123, 0.5, np.inf], [1.0, 0.7, np.nan, 4.02], [0.0, 0.69, 1e-7, np.inf]])


def write(path, rows=ROWS):
    with open_results(path, COLUMNS) as (file, known):
        file.append(rows)
    return known


def test_rows_come_back_as_they_were(tmp_path):
    path = tmp_path / "results.csv"
    assert len(write(path)) == 0
    _, rows = read_rows(path, COLUMNS)
    np.testing.assert_allclose(rows, ROWS, rtol=1e-11)
    assert path.read_text().splitlines()[2] == "1,0.7,,4.02"


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=60)
@given(data=st.data())
def test_whatever_is_cut_off_only_the_torn_row_is_lost(tmp_path, data):
    path = tmp_path / "results.csv"
    path.unlink(missing_ok=True)
    write(path)
    whole = path.read_bytes()
    cut = data.draw(st.integers(0, len(whole)))
    path.write_bytes(whole[:cut])
    left = max(whole[:cut].count(b"\n") - 1, 0)
    with open_results(path, COLUMNS) as (file, known):
        np.testing.assert_array_equal(known[:, 0], ROWS[:left, 0])
        file.append(ROWS[left:])
    assert path.read_bytes() == whole


def test_rows_are_put_in_the_order_of_their_samples(tmp_path):
    path = tmp_path / "results.csv"
    write(path)
    lines = path.read_text().splitlines()
    sort_results(path)
    assert path.read_text().splitlines() == [lines[0], lines[3], lines[2], lines[1]]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("time,x\n0,1\n", "its columns are others"),
        ("notes about something that is no table at all, and long\n", "its columns are others"),
        ("sample,vehicle.mass,rmse,crash_time\n0,0.7,0.5,\n1,what,0.5,\n", "line 3"),
        ("sample,vehicle.mass,rmse,crash_time\n0,0.7\n", "line 2"),
        ("sample,vehicle.mass,rmse,crash_time\n0,0.7,0.5,\n0,0.7,0.5,\n", "twice"),
        ("sample,vehicle.mass,rmse,crash_time\n,0.7,0.5,\n", "without the number"),
    ],
)
def test_what_is_not_ours_is_refused_and_left_alone(tmp_path, content, words):
    path = tmp_path / "results.csv"
    path.write_text(content)
    with pytest.raises(InputError, match=words), open_results(path, COLUMNS):
        pass
    assert path.read_text() == content


def test_two_runs_do_not_write_to_one_file(tmp_path):
    path = tmp_path / "results.csv"
    with open_results(path, COLUMNS), pytest.raises(InputError, match="another run"), open_results(path, COLUMNS):
        pass


def test_a_full_disk_leaves_whole_rows(tmp_path):
    """A limit on the size of files, which fails a write in its middle as a full disk does."""
    path = tmp_path / "results.csv"
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        with open_results(path, COLUMNS) as (file, _):
            file.append(ROWS[:1])
            whole = path.read_bytes()
            resource.setrlimit(resource.RLIMIT_FSIZE, (len(whole) + 10, limits[1]))
            with pytest.raises(OSError, match="too large"):
                file.append(ROWS[1:])
            assert path.read_bytes() == whole
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
            file.append(ROWS[1:])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, before)
    assert read_rows(path, COLUMNS)[1].shape == ROWS.shape
