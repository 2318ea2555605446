"""On-disk cache of machine code and computed results, in a folder to which only this user can write.

Each file contains an object file or a pickled result, followed by a digest of the file's name and of its content. The
digest detects files that were damaged or renamed. It does not protect against manipulation by other users. Therefore
the folder and the files must belong to this user, and nobody else may have write permission.
"""

import functools
import hashlib
import logging
import os
import re
import stat
import sys
from contextlib import suppress
from pathlib import Path

from drake_quad.files import write_atomically

# Largest total size of the cache, bytes. A kernel has 5 to 200 kB, so the cache can contain thousands of kernels.
MAX_BYTES = 256 * 2**20
_DIGEST_SIZE = 32  # bytes, size of a SHA-256 digest
# Pattern of the cache's files and temporary files. Pruning deletes only files that match.
_CACHE_FILE_NAME = re.compile(r"\.?(kernel|result)_[0-9a-f]{32}(\.\d+)*\.(o|pickle)")
# Opening a file must not follow a symbolic link or block on a FIFO. Windows has no flags for this, but needs the flag
# for binary mode.
_READ_FLAGS = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
_WRITE_FLAGS = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | getattr(os, "O_BINARY", 0)


def read(name: str) -> bytes | None:
    """Return the cached content with a given name; None if its file does not exist or cannot be trusted."""
    folder = cache_folder()
    if folder is None or not _is_trusted(folder):
        return None
    path = folder / _file_name(name)
    try:
        with os.fdopen(os.open(path, _READ_FLAGS), "rb") as file:
            status = os.fstat(file.fileno())
            if not stat.S_ISREG(status.st_mode) or not _is_private(status) or status.st_size > MAX_BYTES:
                return None
            content = file.read()
    except OSError:
        return None
    payload, digest = content[:-_DIGEST_SIZE], content[-_DIGEST_SIZE:]
    if not payload or digest != _digest(name, payload):
        return None
    with suppress(OSError):
        os.utime(path)  # pruning deletes the least recently used files first
    return payload


def write(name: str, payload: bytes) -> None:
    """Write an object file or a result to the cache. If writing fails, the next process computes the content again.

    After one in sixteen writes, selected by the last digit of the name, the folder is pruned to `MAX_BYTES`.
    """
    folder = cache_folder()
    if folder is None:
        return

    def fill(path: Path) -> None:
        with os.fdopen(os.open(path, _WRITE_FLAGS, 0o600), "wb") as file:
            file.write(payload + _digest(name, payload))

    with suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        if _is_trusted(folder):
            write_atomically(folder / _file_name(name), fill)
            if name.endswith("0"):
                prune(folder, MAX_BYTES)


def prune(folder: Path, max_bytes: int) -> None:
    """Delete the least recently used files of the cache until the total size is at most `max_bytes`.

    Other processes may read, write and prune at the same time. A process that does not find a file computes its content
    again.
    """
    files = []
    with os.scandir(folder) as entries:
        for entry in entries:
            if _CACHE_FILE_NAME.fullmatch(entry.name):
                with suppress(OSError):
                    status = entry.stat(follow_symlinks=False)
                    files.append((status.st_mtime_ns, Path(entry.path), status.st_size))
    total = sum(size for *_, size in files)
    for _, path, size in sorted(files):
        if total <= max_bytes:
            break
        with suppress(OSError):
            path.unlink()
        total -= size


def cache_folder() -> Path | None:
    """Return the cache folder that DRAKE_QUAD_CACHE specifies, by default a folder in the user's cache directory.

    Returns:
        The folder, which may not exist yet. None if the cache is disabled: the variable is empty or not an absolute
        path, or the user has no home directory. Relative paths in other environment variables are ignored, as the XDG
        Base Directory Specification requires.
    """
    setting = os.environ.get("DRAKE_QUAD_CACHE")
    if setting is not None:
        if setting and not Path(setting).is_absolute():
            _warn_once(
                f"DRAKE_QUAD_CACHE is {setting!r}, so machine code and results are not cached; set it to an"
                " absolute path"
            )
        return _absolute(setting)
    try:
        home = _absolute(str(Path.home()))
    except RuntimeError:
        home = None
    if sys.platform == "win32":
        return _inside(_absolute(os.environ.get("LOCALAPPDATA")), home, "AppData/Local", "drake_quad/cache")
    if sys.platform == "darwin":
        return _inside(None, home, "Library/Caches", "drake_quad")
    return _inside(_absolute(os.environ.get("XDG_CACHE_HOME")), home, ".cache", "drake_quad")


def _file_name(name: str) -> str:
    """Return the file name of a cached kernel or result."""
    return f"{name}.{'o' if name.startswith('kernel_') else 'pickle'}"


def _absolute(path: str | None) -> Path | None:
    return Path(path) if path and Path(path).is_absolute() else None


def _inside(cache_home: Path | None, home: Path | None, default: str, name: str) -> Path | None:
    """Return the folder `name` in the user's cache directory, which by default is in the home directory."""
    if cache_home is None and home is not None:
        cache_home = home / default
    return None if cache_home is None else cache_home / name


def _digest(name: str, payload: bytes) -> bytes:
    return hashlib.sha256(f"{name}\0".encode() + payload).digest()


def _is_trusted(folder: Path) -> bool:
    """Return whether a folder exists and is private; warn once if it exists but is not private."""
    try:
        status = folder.stat()
    except OSError:
        return False
    if not stat.S_ISDIR(status.st_mode):
        return False
    if not _is_private(status):
        _warn_once(
            f"{folder} belongs to another user or is writable by others, so machine code and results are not cached"
            " there; make the folder private, or set DRAKE_QUAD_CACHE to another folder"
        )
        return False
    return True


def _is_private(status: os.stat_result) -> bool:
    """Return whether a file or folder belongs to this user and nobody else can write to it.

    On Windows, a user's folders are private by default, and the file mode does not describe access by other users.
    """
    if sys.platform == "win32":
        return True
    return status.st_uid == os.geteuid() and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


@functools.cache
def _warn_once(sentence: str) -> None:
    """Log a warning once per process."""
    logging.getLogger("drake_quad").warning(sentence)
