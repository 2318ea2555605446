"""Registry of the formats of flight logs that `read_log` knows by their content."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from drake_quad.errors import InputError, listed, shown
from drake_quad.identification.logs.conversion import Table
from drake_quad.identification.logs.mapping import Mapping, load_mapping, shipped_mappings
from drake_quad.identification.logs.source import LogFile

NamedMapping = tuple[str, Mapping]


class LogContent(NamedTuple):
    """Content of a log, before a mapping turns its columns into signals.

    Attributes:
        tables: tables of the log.
        mapping: name and mapping of the columns to signals.
        remarks: sentences on the log.
        names: names of further columns, which no table contains.
    """

    tables: Sequence[Table]
    mapping: NamedMapping
    remarks: Sequence[str]
    names: Sequence[str] = ()


class LogFormat(NamedTuple):
    """Format of flight logs.

    Attributes:
        name: name of the format with an article, for messages.
        recognizes: function that returns whether the content of a file has this format.
        read: function that reads a file with the mapping that the user named, if any.
    """

    name: str
    recognizes: Callable[[LogFile], bool]
    read: Callable[[LogFile, NamedMapping | None], LogContent]


FORMATS: list[LogFormat] = []
"""Registered formats. A format is a module in this folder that appends itself to the list."""


def best_mapping(
    log: LogFile, given: NamedMapping | None, columns_of: Callable[[Mapping], Sequence[str]]
) -> tuple[NamedMapping, Sequence[str]]:
    """Return the mapping of a log of one table, and the columns of the log as the mapping separates them.

    Args:
        log: content of the file.
        given: name and mapping that the user named; if None, the shipped mapping that knows most of the columns.
        columns_of: function that returns the names of the columns.

    Raises:
        InputError: if no mapping fits.
    """
    candidates = [given] if given else [load_mapping(name) for name in shipped_mappings()]
    best: tuple[NamedMapping, Sequence[str]] | None = None
    max_known = 0
    for name, mapping in candidates:
        if mapping.time is None or (given is None and mapping.by_name):
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
    columns = [shown(each) for each in columns_of(candidates[0][1])]
    if given is None:
        raise InputError(
            f"{log.mark}: none of the shipped mappings ({', '.join(shipped_mappings())}) fits its columns,"
            f" {listed(columns, 12)}; the how-to guide on identification shows how to write one"
        )
    name, mapping = given
    if mapping.time is None:
        raise InputError(f"{log.mark}: the mapping {name} needs the column of the time to read a log of one table")
    missing = sorted(mapping.names - set(columns_of(mapping)))
    raise InputError(
        f"{log.mark}: does not fit the mapping {name}: there is no {listed([shown(each) for each in missing], 4)}; it"
        f" has {listed(columns, 12)}"
    )
