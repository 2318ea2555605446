"""Available memory of the machine, and a check that a fleet fits into it."""

import os
import re
from pathlib import Path

from drake_quad.errors import InputError

# Smallest memory that a fleet needs per vehicle, bytes. With 20,000 vehicles, a learning environment needed 8 kB
# (figure_eight) to 19 kB (robustness) per vehicle; the fleet of a study needed 15 to 37 kB.
_MIN_BYTES_PER_VEHICLE = 8_000
# File in which Linux reports the available memory, in kB.
_MEMORY_INFO = Path("/proc/meminfo")
# File in which Linux reports the memory limit of a container, in bytes.
_CONTAINER_LIMIT = Path("/sys/fs/cgroup/memory.max")


def check_fleet_fits(num_vehicles: int, name: str) -> None:
    """Raise an error if a fleet certainly does not fit into memory.

    Args:
        num_vehicles: number of vehicles in the fleet.
        name: name of the argument `num_vehicles` in the error message.

    Raises:
        InputError: if the fleet needs more memory than is available.
    """
    needed, available = num_vehicles * _MIN_BYTES_PER_VEHICLE, available_memory()
    if available is not None and needed > available:
        raise InputError(
            f"{name} is {num_vehicles:,}, but a fleet of this size needs at least {1e-9 * needed:,.0f} GB of memory,"
            f" and only {1e-9 * available:,.1f} GB are available"
        )


def available_memory() -> int | None:
    """Return the memory that is available to a new process, bytes; None if the system does not report it."""
    limits = []
    if _MEMORY_INFO.is_file():
        kilobytes = re.search(r"^MemAvailable:\s*(\d+) kB", _MEMORY_INFO.read_text(), re.MULTILINE)
        limits += [1024 * int(kilobytes[1])] if kilobytes else []
    elif {"SC_PHYS_PAGES", "SC_PAGE_SIZE"} <= {*getattr(os, "sysconf_names", ())}:
        limits.append(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    if _CONTAINER_LIMIT.is_file():
        limit = _CONTAINER_LIMIT.read_text().strip()
        limits += [int(limit)] if limit.isdecimal() else []  # "max" means no limit
    return min(limits, default=None)
