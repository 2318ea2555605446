"""Reads a flight log of any known format, by its content."""

from pathlib import Path

from drake_quad.identification.logs import crazyflie, ulog
from drake_quad.identification.logs.conversion import record_of
from drake_quad.identification.logs.mapping import load_mapping
from drake_quad.identification.logs.record import FlightRecord
from drake_quad.identification.logs.source import read_file
from drake_quad.identification.logs.table import read_table_file


def read_log(path: str | Path, mapping: str | Path | None = None) -> FlightRecord:
    """Read a flight log of a Crazyflie, a PX4 ULog, or a CSV file, uncompressed or compressed with gzip or xz.

    Truncated or damaged parts of a log are skipped. The remarks of the record list them, and the columns that were
    read.

    Args:
        path: path of the file.
        mapping: mapping from columns to signals, given by a YAML file (`drake_quad.identification.logs.mapping`) or by
            the name of a shipped mapping. The default is `crazyflie` for a Crazyflie's log, `px4` for a ULog, and the
            shipped mapping that fits best for CSV.

    Raises:
        InputError: if the file does not exist, has another format, or contains no complete signal; or it is a PX4 log
            of a vehicle that is not a quadrotor, and no mapping is given.
    """
    given = None if mapping is None else load_mapping(mapping)
    log = read_file(Path(path))
    if log.data.startswith(bytes([crazyflie.FIRST_BYTE])):
        name, known = given or load_mapping("crazyflie")
        tables, remarks = crazyflie.crazyflie_tables(log)
    elif log.data.startswith(ulog.MAGIC):
        name, known = given or load_mapping("px4")
        tables, remarks, rotors = ulog.ulog_tables(log, known, any_vehicle=given is not None)
        if name == "px4":
            known = known if rotors is None else known.with_rotors(rotors)
            order = ", ".join(map(str, known.rotors or ()))
            source = (
                "assumed, those of its quad-x: the log has no CA_ROTOR0_PX and so on that say where they are"
                if rotors is None
                else "by the places in CA_ROTOR0_PX and so on"
            )
            remarks.append(f"PX4's rotors 1 to 4 are our {order}, {source}")
    else:
        found = read_table_file(log, given)
        return record_of(
            [found.table], found.mapping, name=log.name, mark=log.mark, remarks=found.remarks, names=found.names
        )
    remarks.append(f"the mapping is {name}: {known.description}".removesuffix(": "))
    return record_of(tables, known, name=log.name, mark=log.mark, remarks=remarks)
