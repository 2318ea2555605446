"""Machine code on the disk, in a folder that only this user can write to.

Each file holds an object file, and behind it a digest of the file's name and of the object file. So a file that is
damaged, or that was moved to the name of another one, is noticed. The digest is no protection from other users: it is
the folder and the files that must belong to this user and must not be writable by anybody else.
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

from drake_quad.files import write_whole

# A kernel takes 5 to 200 kB, so thousands of them are kept.
MAX_BYTES = 256 * 2**20
_DIGEST_SIZE = 32
# What this module writes, also while it is not whole yet.
_OUR_NAMES = re.compile(r"\.?kernel_[0-9a-f]{32}(\.\d+)*\.o")
# A symbolic link is not followed, and a FIFO is not waited for. Windows has neither, but tells text from bytes.
_READ = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
_WRITE = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | getattr(os, "O_BINARY", 0)


def read(name: str) -> bytes | None:
    """Return the object file of that name; None if there is none, or none that can be trusted."""
    folder = cache_folder()
    if folder is None or not _is_ours(folder):
        return None
    path = folder / f"{name}.o"
    try:
        with os.fdopen(os.open(path, _READ), "rb") as file:
            status = os.fstat(file.fileno())
            if not stat.S_ISREG(status.st_mode) or not _is_private(status) or status.st_size > MAX_BYTES:
                return None
            content = file.read()
    except OSError:
        return None
    code, digest = content[:-_DIGEST_SIZE], content[-_DIGEST_SIZE:]
    if not code or digest != _digest(name, code):
        return None
    with suppress(OSError):
        os.utime(path)  # the files that were used longest ago are deleted first
    return code


def write(name: str, code: bytes) -> None:
    """Write an object file; where that is not possible, the next process compiles again.

    One write in sixteen, chosen by the name, looks through the folder and keeps it below `MAX_BYTES`.
    """
    folder = cache_folder()
    if folder is None:
        return

    def fill(path: Path) -> None:
        with os.fdopen(os.open(path, _WRITE, 0o600), "wb") as file:
            file.write(code + _digest(name, code))

    with suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        if _is_ours(folder):
            write_whole(folder / f"{name}.o", fill)
            if name.endswith("0"):
                prune(folder, MAX_BYTES)


def prune(folder: Path, max_bytes: int) -> None:
    """Delete the files of this module that were used longest ago, until the others take no more than `max_bytes`.

    Other processes may read, write and prune meanwhile: a file that is gone is compiled again.
    """
    files = []
    with os.scandir(folder) as entries:
        for entry in entries:
            if _OUR_NAMES.fullmatch(entry.name):
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
    """Return the folder that DRAKE_QUAD_CACHE names, or else a folder among the user's caches.

    Returns:
        None, so that nothing is kept, if that variable is empty or not an absolute path, or the user has no home.
        Other variables that hold a relative path count as not set, as the XDG Base Directory Specification has it.
    """
    named = os.environ.get("DRAKE_QUAD_CACHE")
    if named is not None:
        if named and not Path(named).is_absolute():
            _remark(f"DRAKE_QUAD_CACHE is {named!r}, which is not an absolute path, so machine code is not kept")
        return _absolute(named)
    try:
        home = _absolute(str(Path.home()))
    except RuntimeError:
        home = None
    if sys.platform == "win32":
        return _inside(_absolute(os.environ.get("LOCALAPPDATA")), home, "AppData/Local", "drake_quad/cache")
    if sys.platform == "darwin":
        return _inside(None, home, "Library/Caches", "drake_quad")
    return _inside(_absolute(os.environ.get("XDG_CACHE_HOME")), home, ".cache", "drake_quad")


def _absolute(path: str | None) -> Path | None:
    return Path(path) if path and Path(path).is_absolute() else None


def _inside(caches: Path | None, home: Path | None, default: str, name: str) -> Path | None:
    """Return our folder among the user's caches, which by default are in their home."""
    if caches is None and home is not None:
        caches = home / default
    return None if caches is None else caches / name


def _digest(name: str, code: bytes) -> bytes:
    return hashlib.sha256(f"{name}\0".encode() + code).digest()


def _is_ours(folder: Path) -> bool:
    """Return whether a folder is there and private; says so once if it is there and not private."""
    try:
        status = folder.stat()
    except OSError:
        return False
    if not stat.S_ISDIR(status.st_mode):
        return False
    if not _is_private(status):
        _remark(
            f"{folder} belongs to another user or can be written by others, so no machine code is read from it or kept"
            " in it; make it yours alone, or name another folder by DRAKE_QUAD_CACHE"
        )
        return False
    return True


def _is_private(status: os.stat_result) -> bool:
    """Return whether a file or folder belongs to this user and nobody else can write to it.

    On Windows a user's folders are private, and the mode does not say more.
    """
    if sys.platform == "win32":
        return True
    return status.st_uid == os.geteuid() and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


@functools.cache
def _remark(sentence: str) -> None:
    """Log a sentence, once in a process."""
    logging.getLogger("drake_quad").warning(sentence)
