"""Tests of the plugin that fails a session if a test writes into the repository."""

import subprocess
import sys
from pathlib import Path

import pytest

CONFTEST = f"""
import sys
sys.path.append({str(Path(__file__).parent)!r})
from repository_guard import RepositoryGuard

def pytest_configure(config):
    config.pluginmanager.register(RepositoryGuard(config.rootpath))
"""


def session(folder, body):
    """Run pytest in a folder with the file `kept.yaml` and one test, and return its exit status and output.

    Args:
        folder: empty folder, which takes the place of the repository.
        body: Python statements of the test.
    """
    (folder / "conftest.py").write_text(CONFTEST)
    (folder / "kept.yaml").write_text("a: 1")
    (folder / "test_one.py").write_text(f"from pathlib import Path\n\ndef test_one(tmp_path):\n    {body}\n")
    command = [sys.executable, "-m", "pytest", "-q", "--rootdir", folder, "-c", "/dev/null", "test_one.py"]
    result = subprocess.run([*command, "-p", "no:cacheprovider"], cwd=folder, capture_output=True, text=True)
    return result.returncode, result.stdout


@pytest.mark.long
@pytest.mark.parametrize(
    ("body", "changed"),
    [
        ("Path('saved.yaml').write_text('')", "saved.yaml"),
        ("Path('new').mkdir(); Path('new', 'made.csv').write_text('')", "new/made.csv"),
        ("Path('kept.yaml').write_text('a: 22')", "kept.yaml"),
        ("Path('kept.yaml').unlink()", "kept.yaml"),
    ],
)
def test_a_session_fails_if_a_test_writes_into_the_repository(tmp_path, body, changed):
    status, printed = session(tmp_path, body)
    assert status == pytest.ExitCode.TESTS_FAILED
    assert "1 passed" in printed
    assert f"files of the repository changed during the tests: {changed}; a test must write" in printed


@pytest.mark.long
@pytest.mark.parametrize(
    "body", ["(tmp_path / 'saved.yaml').write_text('')", "Path('out').mkdir(); Path('out', 'plot.png').write_text('')"]
)
def test_a_session_passes_if_its_tests_write_elsewhere(tmp_path, body):
    status, printed = session(tmp_path, body)
    assert status == pytest.ExitCode.OK
    assert "repository" not in printed
