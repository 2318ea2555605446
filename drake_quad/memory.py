"""Check that a fleet fits into the memory of this machine."""

import os
import re
from pathlib import Path

from drake_quad.errors import InputError

# Memory of one vehicle of a fleet at least, bytes. With 20,000 vehicles, an environment took 8 kB (figure_eight) to
# 19 kB (robustness) a vehicle, and a fleet of a study 15 to 37 kB.
_BYTES_PER_VEHICLE = 8_000
_MEMORY_INFO = Path("/proc/meminfo")  # of Linux, in kB
_CONTAINER_LIMIT = Path("/sys/fs/cgroup/memory.max")  # of control groups, in bytes


def check_fleet_fits(num_vehicles: int, name: str) -> None:
    """Refuse a fleet that certainly does not fit into memory.

    Args:
        num_vehicles: of the fleet.
        name: of the argument that says so, for the message.

    Raises:
        InputError: the fleet needs more memory than is available.
    """
    needed, available = num_vehicles * _BYTES_PER_VEHICLE, available_memory()
    if available is not None and needed > available:
        raise InputError(
            f"{name} is {num_vehicles:,}, but so many vehicles need at least {1e-9 * needed:,.0f} GB of memory, and"
            f" {1e-9 * available:,.1f} GB are available"
        )


def available_memory() -> int | None:
    """Return how much memory a new process could take, bytes; None if this system does not tell."""
    found = []
    if _MEMORY_INFO.is_file():
        kilobytes = re.search(r"^MemAvailable:\s*(\d+) kB", _MEMORY_INFO.read_text(), re.MULTILINE)
        found += [1024 * int(kilobytes[1])] if kilobytes else []
    elif {"SC_PHYS_PAGES", "SC_PAGE_SIZE"} <= {*getattr(os, "sysconf_names", ())}:
        found.append(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    if _CONTAINER_LIMIT.is_file():
        limit = _CONTAINER_LIMIT.read_text().strip()
        found += [int(limit)] if limit.isdecimal() else []  # "max" stands for none
    return min(found, default=None)
