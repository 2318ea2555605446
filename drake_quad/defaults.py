"""Other numbers for a system that is there: what its default context would hold, had it been constructed with them.

A diagram takes tenths of a second to build, and Drake 1.51 never gives one back that holds a system written in Python.
So a study builds one and writes the numbers of batch after batch into its context. Which parameters and which states
follow from a system's numbers is in its `declare`, and nowhere else: it is run again, and what it declares is kept.
"""

import functools
from collections.abc import Callable, Iterable
from typing import Any

from drake_quad.elementary import Row
from drake_quad.fleet import FleetSystem


def put_defaults(system: FleetSystem, context: Any, **options: Any) -> None:
    """Writes into a context of a system the parameters and the state that other arguments would have given it.

    Args:
        system: a FleetSystem for float.
        context: of the system.
        options: arguments of its constructor, beside the number of vehicles. What decides which ports, parameters and
            states the system has must be as it was, and what was a number for all vehicles must be one.

    Raises:
        ValueError: the arguments would have made a system of another structure.
    """
    kept = _kept_declaration(system.declared_by)(system.num_vehicles)
    kept.declare(**options)
    structure = len(kept.parameters), len(kept.groups), kept.continuous is not None
    if structure != (
        context.num_numeric_parameter_groups(),
        context.num_discrete_state_groups(),
        context.num_continuous_states() > 0,
    ):
        raise ValueError(f"{system.get_name()} would have another structure with these numbers")
    for index, rows in enumerate(kept.parameters):
        system.write_parameter(context, index, rows)
    for index, rows in enumerate(kept.groups):
        context.SetDiscreteState(index, system.packed(rows))
    if kept.continuous is not None:
        context.SetContinuousState(system.packed(kept.continuous))


class _Kept:
    """Takes a system's place while it declares, and keeps what it declares."""

    scalar = float

    def __init__(self, num_vehicles: int) -> None:
        self.num_vehicles = num_vehicles
        self.parameters: list[list[Row]] = []
        self.groups: list[list[Row]] = []
        self.continuous: list[Row] | None = None
        self.group_names: list[str] = []
        self.random_inputs: dict[str, Any] = {}

    def numeric_parameter(self, rows: Iterable[Row]) -> int:
        self.parameters.append(list(rows))
        return len(self.parameters) - 1

    def discrete_state(self, name: str, rows: Iterable[Row]) -> int:
        self.group_names.append(name)
        self.groups.append(list(rows))
        return len(self.groups) - 1

    def vector(self, rows: Iterable[Row]) -> list[Row]:
        return list(rows)

    def DeclareContinuousState(self, rows: list[Row]) -> None:
        self.continuous = rows

    def _nothing(self, *args: Any, **options: Any) -> None:
        """Ports, events and formulas are there already."""

    input = random_input = output = packed_output = state_output = mapped = interpreted = _nothing

    def __getattr__(self, name: str) -> Callable[..., None]:
        # Drake's own declarations and tickets.
        if name.startswith("Declare") or name.endswith("_ticket"):
            return self._nothing
        raise AttributeError(name)


@functools.cache
def _kept_declaration(declared_by: type[FleetSystem]) -> Any:
    return type(declared_by.__name__, (_Kept, declared_by), {})
