"""Reads a flight log of any known format, by its content."""

from pathlib import Path

from drake_quad.identification.logs import crazyflie, ulog
from drake_quad.identification.logs.conversion import record_of
from drake_quad.identification.logs.mapping import load_mapping
from drake_quad.identification.logs.record import FlightRecord
from drake_quad.identification.logs.source import read_file
from drake_quad.identification.logs.table import read_table_file


def read_log(path: str | Path, mapping: str | Path | None = None) -> FlightRecord:
    """Reads a flight log: a Crazyflie's, PX4's ULog, or CSV, as it is or compressed by gzip or xz.

    What of a log is cut or damaged is left out, and the record's remarks say so, and which columns were read.

    Args:
        path: of the file.
        mapping: which columns are which signals: a YAML file in the language of
            `drake_quad.identification.logs.mapping`, or the name of a shipped mapping. If it is not given, a
            Crazyflie's log is read by `crazyflie`, a ULog by `px4`, and CSV by the shipped one that fits.

    Raises:
        InputError: there is no such file, it is none of these logs, or it holds nothing that is whole and known; or it
            is PX4's of another vehicle than a quadrotor, and no mapping is given.
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
