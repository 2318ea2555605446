"""Reader of Betaflight's blackbox log, based on betaflight-chirp-core, a port of the decoder of its log viewer.

Fields keep the names of the log, such as `gyroADC[0]`. Motor commands are converted to fractions of the range
`motorOutput` in the header, and specific forces are converted to g with `acc_1G` in the header. All other fields keep
their logged values.
"""

from typing import Any

import numpy as np

from drake_quad.errors import InputError, join_names
from drake_quad.logs.conversion import Table
from drake_quad.logs.formats.log_format import FORMATS, LogContent, LogFormat, NamedMapping
from drake_quad.logs.mapping import load_mapping
from drake_quad.logs.source import LogFile

_MAGIC = b"H Product:Blackbox flight data recorder"
_MICROSECOND = 1e-6  # s
# Largest number of frames between two logged frames. The decoder iterates over all frames that are not logged. Reading
# a log with a damaged interval could therefore take hours.
_MAX_INTERVAL = 10_000


def _read(log: LogFile, user_mapping: NamedMapping | None) -> LogContent:
    """Read the longest flight of a log. Each arming of the vehicle begins a flight.

    Raises:
        InputError: if the decoder is not installed, or no flight can be read.
    """
    decoder = log.library("betaflight_chirp_core.decoder", "blackbox")
    flights = decoder.split_sessions(log.data)
    if not flights:
        raise InputError(f"{log.mark}: is a Betaflight log whose first line is damaged")
    longest = max(range(len(flights)), key=lambda i: flights[i][1] - flights[i][0])
    flight = log.read_by_library("a Betaflight log", lambda: _decoded(decoder, log.data, *flights[longest]))
    remarks = []
    if len(flights) > 1:
        remarks.append(f"the log has {len(flights)} flights; only the longest is read, number {longest + 1}")
    damaged = sum(each["corrupt"] + each["desync"] for each in flight.stats["frame"].values())
    if damaged:
        remarks.append(f"{damaged:,} damaged frames are left out")
    if len(flight.main_frames) < 2:
        raise InputError(f"{log.mark}: is a Betaflight log with fewer than two complete frames")
    names = flight.main_field_names
    if "time" not in names:
        raise InputError(f"{log.mark}: is a Betaflight log without the field `time`")
    frames = np.array(flight.main_frames, dtype=float)
    fields = dict(zip(names, frames.T, strict=True))
    time = fields.pop("time") * _MICROSECOND
    fields.pop("loopIteration", None)
    low, high = flight.sys_config["motorOutput"]
    gravity = flight.sys_config["acc_1G"]
    for name in fields:
        if name.startswith("motor["):
            fields[name] = (fields[name] - low) / (high - low)
        elif name.startswith("accSmooth["):
            fields[name] = fields[name] / gravity
    return LogContent([Table("", time, fields)], user_mapping or load_mapping("betaflight"), remarks)


def _decoded(decoder: Any, data: bytes, start: int, end: int) -> Any:
    """Return a decoder that has read all frames of a flight."""
    flight = decoder.FlightLogParser(data, start, end)
    flight.parse_header()
    config = flight.sys_config
    for name in ("frameIntervalI", "frameIntervalPNum", "frameIntervalPDenom"):
        if not 1 <= config[name] <= _MAX_INTERVAL:
            raise ValueError(f"its header has an invalid {name}: {config[name]}")
    numbers = [*config["motorOutput"], config["acc_1G"]]
    if not all(isinstance(each, int) for each in numbers) or not numbers[0] < numbers[1] or not numbers[2] > 0:
        values = join_names([str(each) for each in numbers])
        raise ValueError(f"its header has invalid values of motorOutput and acc_1G: {values}")
    flight.parse_data()
    return flight


FORMATS.append(LogFormat("Betaflight's blackbox log", lambda log: log.data.startswith(_MAGIC), _read))
