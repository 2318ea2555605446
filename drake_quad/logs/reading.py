"""Reader of flight logs in any known format."""

from pathlib import Path

import drake_quad.logs.formats  # noqa: F401 - registers the formats
from drake_quad.errors import InputError
from drake_quad.logs.conversion import record_of
from drake_quad.logs.formats.log_format import FORMATS
from drake_quad.logs.formats.table import is_text, read_table
from drake_quad.logs.mapping import load_mapping
from drake_quad.logs.record import FlightRecord
from drake_quad.logs.source import read_file


def read_log(path: str | Path, mapping: str | Path | None = None) -> FlightRecord:
    """Read a flight log, uncompressed or compressed with gzip or xz.

    The format follows from the content: a Crazyflie's SD card log, PX4's ULog, ArduPilot's DataFlash log, Betaflight's
    blackbox log, a ROS bag of version 1 or 2, MCAP, MATLAB's MAT-file, or CSV.

    Truncated or damaged parts of a log are skipped. The remarks of the record list the skipped parts, and signals that
    contradict each other; its `origins` list the columns that were read.

    Args:
        path: path of the file, or of the folder of a ROS 2 bag.
        mapping: mapping from columns to signals, given by a YAML file (`drake_quad.logs.mapping`) or by
            the name of a shipped mapping. The default is the mapping of the format; for CSV and MAT-files, it is the
            shipped mapping that fits best.

    Raises:
        InputError: if the file does not exist, has another format, or contains no complete signal; if the format needs
            a library that is not installed; or if the logged vehicle is not a quadrotor, and no mapping is given.
    """
    user_mapping = None if mapping is None else load_mapping(mapping)
    log = read_file(Path(path))
    read = next((each.read for each in FORMATS if each.recognizes(log)), None)
    if read is None:
        # Text that has no other format is read as CSV.
        if not is_text(log):
            raise InputError(
                f"{log.mark}: is not a log in a known format: {', '.join(each.name for each in FORMATS)}, or CSV"
            )
        read = read_table
    content = read(log, user_mapping)
    name, columns_mapping = content.mapping
    remarks = [
        *log.remarks,
        *content.remarks,
        f"the mapping is {name}: {columns_mapping.description}".removesuffix(": "),
    ]
    return record_of(
        content.tables, columns_mapping, name=log.name, mark=log.mark, remarks=remarks, names=content.names
    )
