"""Reader of the log that a Crazyflie wrote to its SD card before firmware 2021.03.

The file contains in this order:

    number of columns (uint8); for each column its name with the letter of its type, as in `tick(I),` and `gyro.x(f),`
    inverted CRC-32 of all preceding bytes (uint32)
    blocks: number of records (uint8), the records, packed, inverted CRC-32 of the block (uint32)

All numbers are little-endian, the first column is the time in ms, and the letters are those of Python's `struct`. The
format is that of `tools/usdlog/CF_functions.py` in github.com/bitcraze/crazyflie-firmware from May 2018 to March 2021.
Newer logs begin with the byte 0xBC; `crazyflie` reads them.
"""

import re
import zlib

import numpy as np

from drake_quad.errors import InputError
from drake_quad.logs.conversion import Table
from drake_quad.logs.formats.log_format import FORMATS, LogContent, LogFormat, NamedMapping
from drake_quad.logs.mapping import load_mapping
from drake_quad.logs.source import LogFile

_TIME_COLUMN = b"tick(I),"
_TICK_PERIOD = 1e-3  # s, period of the FreeRTOS tick in the firmware
_CHECKSUM_SIZE = 4  # bytes
_MAX_NAME_LENGTH = 64  # bytes
_COLUMN_PATTERN = re.compile(rb"([\w.]{1,%d})\(([BbHhIif])\)," % _MAX_NAME_LENGTH)


def _read(log: LogFile, user_mapping: NamedMapping | None) -> LogContent:
    """Read the blocks whose checksum is correct.

    Raises:
        InputError: if the list of columns is damaged, or no block is complete.
    """
    data, offset = log.data, 1
    names, formats = [], []
    for _ in range(data[0]):
        column = _COLUMN_PATTERN.match(data, offset)
        if column is None:
            raise InputError(f"{log.mark}: is a Crazyflie log whose list of columns is truncated or damaged")
        names.append(column[1].decode())
        formats.append(f"<{column[2].decode()}")
        offset = column.end()
    layout = np.dtype({"names": [str(i) for i in range(len(names))], "formats": formats})
    remarks = []
    if not _has_checksum(data, 0, offset):
        remarks.append("the checksum of the list of columns is wrong: the log is damaged")
    blocks, end, num_damaged = _blocks(data, offset + _CHECKSUM_SIZE, layout)
    if num_damaged:
        blocks_are = "blocks of records are" if num_damaged > 1 else "block of records is"
        remarks.append(f"{num_damaged:,} {blocks_are} left out because of a wrong checksum")
    if end < len(data):
        remarks.append(log.unread_remark(end, "no complete block of records, so the log is truncated or damaged"))
    if not blocks:
        raise InputError(f"{log.mark}: is a Crazyflie log without a complete block of records")
    records = np.concatenate(blocks)
    columns = {name: records[str(i)] for i, name in enumerate(names) if i}
    return LogContent(
        [Table("", records["0"] * _TICK_PERIOD, columns)], user_mapping or load_mapping("crazyflie"), remarks
    )


def _blocks(data: bytes, offset: int, layout: np.dtype) -> tuple[list[np.ndarray], int, int]:
    """Return the records of each intact block, the offset of the first unread byte and the number of damaged blocks."""
    blocks, num_damaged, end = [], 0, offset
    while offset < len(data) and data[offset]:
        checksum_offset = offset + 1 + data[offset] * layout.itemsize
        if checksum_offset + _CHECKSUM_SIZE > len(data):
            break
        if _has_checksum(data, offset, checksum_offset):
            blocks.append(np.frombuffer(data, layout, data[offset], offset + 1))
            end = checksum_offset + _CHECKSUM_SIZE
        else:
            num_damaged += 1
        offset = checksum_offset + _CHECKSUM_SIZE
    return blocks, end, num_damaged


def _has_checksum(data: bytes, start: int, end: int) -> bool:
    """Return whether the bytes from start to end are followed by their inverted CRC-32."""
    checksum = ~zlib.crc32(memoryview(data)[start:end]) & 0xFFFFFFFF
    return data[end : end + _CHECKSUM_SIZE] == checksum.to_bytes(_CHECKSUM_SIZE, "little")


FORMATS.append(
    LogFormat(
        "a Crazyflie's SD card log of before 2021",
        lambda log: log.data[1 : 1 + len(_TIME_COLUMN)] == _TIME_COLUMN,
        _read,
    )
)
