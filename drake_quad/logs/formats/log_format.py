"""Registry of flight log formats, which `read_log` recognizes by the content of a file."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from drake_quad.errors import InputError, join_names, short_repr
from drake_quad.logs.conversion import Table
from drake_quad.logs.mapping import Mapping, load_mapping, shipped_mappings
from drake_quad.logs.source import LogFile

NamedMapping = tuple[str, Mapping]


class LogContent(NamedTuple):
    """Content of a log, before a mapping turns its columns into signals.

    Attributes:
        tables: tables of the log.
        mapping: name of the mapping, and the mapping from columns to signals.
        remarks: remarks on the log, other than `LogFile.remarks`.
        names: names of columns in the log that are not in the tables.
    """

    tables: Sequence[Table]
    mapping: NamedMapping
    remarks: Sequence[str]
    names: Sequence[str] = ()


class LogFormat(NamedTuple):
    """Format of flight logs.

    Attributes:
        name: noun phrase that names the format, for messages.
        recognizes: function that returns whether the content of a file has this format.
        read: function that reads a file, with the mapping that the user selected, if any.
    """

    name: str
    recognizes: Callable[[LogFile], bool]
    read: Callable[[LogFile, NamedMapping | None], LogContent]


FORMATS: list[LogFormat] = []
"""Registered formats. A format is a module in this folder that appends itself to the list."""


def other_vehicle_remarks(log: LogFile, other_type: str, user_mapping: NamedMapping | None) -> list[str]:
    """Return a remark if the logged vehicle is not a quadrotor; `other_type` is empty for a quadrotor.

    Raises:
        InputError: if the vehicle is not a quadrotor, and the user selected no mapping.
    """
    if other_type and user_mapping is None:
        raise InputError(
            f"{log.mark}: is a log of {other_type}, not of a quadrotor; to read it, give a mapping from columns to"
            " signals"
        )
    return [f"the log is of {other_type}"] if other_type else []


def best_mapping(
    log: LogFile, user_mapping: NamedMapping | None, columns_of: Callable[[Mapping], Sequence[str]]
) -> tuple[NamedMapping, Sequence[str]]:
    """Return the mapping for a log with one table, and the columns of the log, which depend on its delimiter.

    Args:
        log: content of the file.
        user_mapping: name and mapping that the user selected; if None, the shipped mapping that uses most of the
            columns.
        columns_of: function that returns the names of the columns, given a mapping.

    Raises:
        InputError: if no mapping fits.
    """
    candidates = [user_mapping] if user_mapping else [load_mapping(name) for name in shipped_mappings()]
    best: tuple[NamedMapping, Sequence[str]] | None = None
    max_known = 0
    for name, mapping in candidates:
        if mapping.time is None or (user_mapping is None and mapping.by_name):
            continue
        columns = columns_of(mapping)
        if mapping.fits(set(columns)):
            known_columns = {
                each for source in mapping.available_sources(set(columns)).values() for each in source.names
            }
            if len(known_columns) > max_known:
                best, max_known = ((name, mapping), columns), len(known_columns)
    if best is not None:
        return best
    columns = [short_repr(each) for each in columns_of(candidates[0][1])]
    if user_mapping is None:
        raise InputError(
            f"{log.mark}: none of the shipped mappings ({', '.join(shipped_mappings())}) fits its columns,"
            f" {join_names(columns, 12)}; write a mapping as shown in the how-to guide on identification"
        )
    name, mapping = user_mapping
    if mapping.time is None:
        raise InputError(f"{log.mark}: the mapping {name} must state the time column to read a log with one table")
    missing = [short_repr(each) for each in sorted(mapping.names - set(columns_of(mapping)))]
    raise InputError(
        f"{log.mark}: does not fit the mapping {name}:"
        f" {f'the log lacks {join_names(missing, 4)}' if missing else 'the mapping has no signals'}; the columns of the"
        f" log are {join_names(columns, 12)}"
    )
