"""Plugin of pytest that fails a session if a test has written into the repository."""

import os
from pathlib import Path

import pytest

# Folders besides hidden ones into which tests may write: default output of commands, bytecode and generated pages.
_IGNORED_FOLDERS = {"out", "__pycache__", "api"}


def files_in(root: Path) -> dict[Path, tuple[int, int]]:
    """Return size and time of the last change of each file below a folder, without ignored folders."""
    files = {}
    for folder, names, _ in os.walk(root):
        names[:] = [name for name in names if not _is_ignored(name)]
        with os.scandir(folder) as entries:
            for entry in entries:
                if entry.is_file() and not entry.name.startswith("."):
                    status = entry.stat()
                    files[Path(entry.path).relative_to(root)] = status.st_size, status.st_mtime_ns
    return files


def _is_ignored(name: str) -> bool:
    return name in _IGNORED_FOLDERS or name.startswith(".") or name.endswith(".egg-info")


class RepositoryGuard:
    """Compares the files of a repository before and after all tests.

    Args:
        root: root folder of the repository.
    """

    def __init__(self, root: Path) -> None:
        self._root, self._before = root, files_in(root)

    @pytest.hookimpl(tryfirst=True)
    def pytest_sessionfinish(self, session) -> None:
        """Let the session fail if a file was created, changed or removed."""
        after = files_in(self._root)
        paths = sorted(path for path in {*self._before, *after} if self._before.get(path) != after.get(path))
        if paths:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED
            reporter = session.config.pluginmanager.get_plugin("terminalreporter")
            reporter.ensure_newline()
            reporter.write_line(
                f"files of the repository changed during the tests: {', '.join(map(str, paths))}; a test must write"
                " into its tmp_path",
                red=True,
            )
