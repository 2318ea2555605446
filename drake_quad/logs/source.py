"""Reading of log files, which may be compressed."""

import gzip
import io
import lzma
import os
import re
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import IO, Any, NamedTuple

import numpy as np

from drake_quad.errors import InputError, shorten_text
from drake_quad.extras import import_extra
from drake_quad.scenario.files.marked_tree import Mark
from drake_quad.scenario.files.reading import open_source

# Largest size of a decompressed log. One hour of samples of 50 bytes at 1 kHz takes 180 million bytes.
MAX_BYTES = 200_000_000
_CHUNK_SIZE = 1 << 20  # bytes that are decompressed at once
# Suffixes of the files in the folder of a ROS 2 bag.
_BAG_SUFFIXES = (".db3", ".mcap")
_COMPRESSION_SUFFIXES = (".gz", ".xz")
# Suffix of a log format, such as .csv or .db3.
_LOG_SUFFIX = re.compile(r"\.[a-z]\w{2,3}", re.IGNORECASE)


class LogFile(NamedTuple):
    """Content of a log file.

    Attributes:
        path: path of the file.
        data: decompressed bytes of the file.
        remarks: remarks on lost data.
    """

    path: Path
    data: bytes
    remarks: tuple[str, ...]

    @property
    def mark(self) -> Mark:
        """Name of the log file, as error messages write it."""
        return Mark(str(self.path), 0)

    @property
    def written_size(self) -> int:
        """Number of bytes before the trailing zeros or trailing bytes 0xff.

        A file may end with these bytes after a loss of power, because its length is set before its content is written.
        """
        last = self.data[-1:]
        return len(self.data.rstrip(last)) if last in (b"\0", b"\xff") else len(self.data)

    def unread_remark(self, end: int, reason: str) -> str:
        """Return a remark on the unread bytes at the end of the file.

        Args:
            end: number of bytes that are read.
            reason: reason why the other bytes are not read. Another reason is used if they are all zeros or all 0xff.
        """
        rest = set(self.data[end:])
        if rest in ({0}, {255}):
            reason = f"all {'0xff' if rest == {255} else 'zeros'}, as after a loss of power"
        count = len(self.data) - end
        return f"the last {f'{count:,} bytes are' if count > 1 else 'byte is'} not read: {reason}"

    @property
    def name(self) -> str:
        """Name of the log file without the suffixes of its compression and format."""
        path = self.path.with_suffix("") if self.path.suffix in _COMPRESSION_SUFFIXES else self.path
        return path.stem if _LOG_SUFFIX.fullmatch(path.suffix) else path.name

    def records(self, layout: np.dtype, offsets: Sequence[int] | np.ndarray) -> np.ndarray:
        """Return the packed records (n,) at the given offsets, as a structured array."""
        windows = np.lib.stride_tricks.sliding_window_view(np.frombuffer(self.data, np.uint8), layout.itemsize)
        return np.ascontiguousarray(windows[offsets]).view(layout)[:, 0]

    def library(self, module: str, extra: str) -> Any:
        """Return a module of an optional library that reads the file.

        Raises:
            InputError: if the library is not installed.
        """
        try:
            return import_extra(module, extra)
        except ImportError as error:
            raise InputError(f"{self.mark}: cannot be read: {error}") from None

    def read_by_library(self, format_name: str, read: Callable[[], Any]) -> Any:
        """Read the file with a library, and convert its exceptions to one sentence.

        Args:
            format_name: name of the format with an article.
            read: function that calls the library.

        Raises:
            InputError: if the library fails.
        """
        try:
            return read()
        except InputError:
            raise
        except Exception as error:  # libraries raise any exception on a damaged log
            raise InputError(f"{self.mark}: is {format_name} that cannot be read: {exception_clause(error)}") from None

    def read_from_disk(self, suffix: str, read: Callable[[Path], Any]) -> Any:
        """Write the log to a temporary file, and return the result of `read` for its path.

        Some libraries read only from disk.
        """
        with NamedTemporaryFile(suffix=suffix) as file:
            file.write(self.data)
            file.flush()
            return read(Path(file.name))


def exception_clause(error: Exception) -> str:
    """Return the message of a library's exception in one line, for the end of a sentence."""
    return shorten_text(" ".join(str(error).split()) or type(error).__name__)


def read_file(path: Path) -> LogFile:
    """Read a log file, and decompress it. A compressed file that is truncated is read as far as possible.

    Raises:
        InputError: if the path is not a file, or the file cannot be read, is empty, or is too large.
    """
    path = _bag_in(path)
    mark = Mark(str(path), 0)
    if os.path.isdir(path):  # noqa: PTH112 - Path.is_dir raises where a name is too long
        raise InputError(f"{mark}: is a folder, not a log" + _flight_hint(path))
    with open_source(path) as file:
        data, is_complete = _decompressed(file)
    if len(data) > MAX_BYTES:
        raise InputError(f"{mark}: is too large: a log may have at most {MAX_BYTES:,} bytes after decompression")
    if not data:
        raise InputError(
            f"{mark}: is empty" if is_complete else f"{mark}: is a compressed file that cannot be decompressed"
        )
    return LogFile(
        path,
        data,
        ()
        if is_complete
        else ("the compressed file is truncated or damaged; only the part before the damage is read",),
    )


def _decompressed(file: IO[bytes]) -> tuple[bytes, bool]:
    """Return the decompressed bytes, at most `MAX_BYTES` + 1, and whether decompression succeeded."""
    start = file.read(6)
    file.seek(0)
    result = io.BytesIO()
    try:
        with _decompressing(file, start) as unpacked:
            while result.tell() <= MAX_BYTES and (chunk := unpacked.read1(_CHUNK_SIZE)):
                result.write(chunk)
    except (EOFError, gzip.BadGzipFile, lzma.LZMAError, zlib.error):
        return result.getvalue(), False
    return result.getvalue()[: MAX_BYTES + 1], True


def _decompressing(file: IO[bytes], start: bytes) -> Any:
    """Return a file that decompresses `file`. The first bytes of the log, `start`, identify the compression."""
    if start.startswith(b"\x1f\x8b"):
        return gzip.GzipFile(fileobj=file)
    if start == b"\xfd7zXZ\0":
        return lzma.LZMAFile(file)
    return file


def _bag_in(path: Path) -> Path:
    """Return the only file in the folder of a ROS 2 bag; any other path is returned unchanged."""
    if not os.path.isfile(path / "metadata.yaml"):  # noqa: PTH113 - Path.is_file raises where a name is too long
        return path
    files = [each for each in path.iterdir() if each.suffix in _BAG_SUFFIXES]
    if len(files) != 1:
        raise InputError(f"{path}: is a ROS 2 bag of {len(files)} files; give the path of the file to read")
    return files[0]


def _flight_hint(path: Path) -> str:
    return f"; use {path.name}/flight.csv, the log of a flight" if (path / "flight.csv").is_file() else ""
