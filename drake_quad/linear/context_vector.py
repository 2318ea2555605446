"""State and numeric parameters in a diagram's context, as a single vector with named elements."""

from collections.abc import Iterator, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from pydrake.systems.framework import Context, Diagram

from drake_quad.errors import InputError
from drake_quad.framework.fleet_system import FleetSystem
from drake_quad.framework.wiring import subsystem
from drake_quad.signals import SIGNALS, row_names


class _Group(NamedTuple):
    """Vector in the context of a leaf system, and the names of its elements."""

    path: tuple[str, ...]
    kind: Literal["discrete", "continuous", "parameter"]
    number: int
    names: tuple[str, ...]


def leaf_paths(diagram: Diagram, *, excluded_systems: Sequence[str] = ()) -> Iterator[tuple[str, ...]]:
    """Yield the path of each leaf system in a diagram, as a tuple of names, except for `excluded_systems`."""
    for part in diagram.GetSystems():
        name = part.get_name()
        if name in excluded_systems:
            continue
        if isinstance(part, Diagram):
            yield from ((name, *rest) for rest in leaf_paths(part, excluded_systems=excluded_systems))
        else:
            yield (name,)


class ContextVector:
    """Vector of a diagram's state, leaf system by leaf system, and optionally of its numeric parameters.

    An element's name consists of the path of its system and the names of the state group (or parameter) and of the
    component, as in `laboratory.vehicle.state.pitch`. The layout is the same for all scalar types of the diagram. State
    groups that are declared with `is_scheduled` are left out (see `StateGroup`).

    Args:
        diagram: diagram to which the contexts belong.
        excluded_systems: names of subsystems that are left out.
        parameters: True if numeric parameters are included.

    Raises:
        InputError: if a system has an abstract state.
    """

    def __init__(self, diagram: Diagram, *, excluded_systems: Sequence[str] = (), parameters: bool = False) -> None:
        self._groups = list(_groups(diagram, diagram.CreateDefaultContext(), excluded_systems, parameters))
        self.names = tuple(name for group in self._groups for name in group.names)

    def read(self, diagram: Diagram, root: Context) -> np.ndarray:
        """Return the vector (n,) of the values in a diagram's context."""
        parts = [self._vector(diagram, root, group).CopyToVector() for group in self._groups]
        return np.concatenate([np.empty(0), *parts])

    def write(self, diagram: Diagram, root: Context, numbers: np.ndarray) -> None:
        """Write a vector (n,) of values to a diagram's context."""
        numbers, first = np.ascontiguousarray(numbers), 0  # Drake 1.51 accepts only contiguous arrays
        for group in self._groups:
            end = first + len(group.names)
            self._vector(diagram, root, group).SetFromVector(numbers[first:end])
            first = end

    def vehicle_rows(self, num_vehicles: int) -> np.ndarray:
        """Return the indices (n, N) of the elements of each vehicle, for the diagram of a fleet of N vehicles."""
        rows, first = [], 0
        for group in self._groups:
            size = len(group.names)
            rows.append(np.arange(first, first + size).reshape(-1, num_vehicles))
            first += size
        return np.concatenate(rows)

    @staticmethod
    def _vector(diagram: Diagram, root: Context, group: _Group) -> Any:
        context = subsystem(diagram, group.path).GetMyMutableContextFromRoot(root)
        match group.kind:
            case "discrete":
                return context.get_mutable_discrete_state(group.number)
            case "continuous":
                return context.get_mutable_continuous_state_vector()
            case "parameter":
                return context.get_mutable_numeric_parameter(group.number)


def port_rows(port: str, size: int) -> tuple[str, ...]:
    """Return the component names of a port for one vehicle: names of known signals, such as `state.x`, or indices."""
    names = row_names(port, size) if port in SIGNALS else map(str, range(size))
    return tuple(f"{port}.{name}" for name in names)


def without_dots(names: Sequence[str]) -> list[str]:
    """Return names without dots, as python-control requires, with underscores in their place."""
    return [name.replace(".", "_") for name in names]


def _groups(diagram: Diagram, root: Context, without: Sequence[str], parameters: bool) -> Iterator[_Group]:
    for path in sorted(leaf_paths(diagram, excluded_systems=without)):
        system = subsystem(diagram, path)
        context = system.GetMyContextFromRoot(root)
        if context.num_abstract_states():
            raise InputError(f"{'.'.join(path)} has an abstract state, so it cannot be linearised")
        scheduled = scheduled_groups(system)
        for number in range(context.num_discrete_state_groups()):
            if number in scheduled:
                continue
            size = context.get_discrete_state(number).size()
            yield _Group(path, "discrete", number, _names(path, system, "states", number, f"group_{number}", size))
        if size := context.num_continuous_states():
            yield _Group(path, "continuous", 0, _names(path, system, "states", None, "continuous", size))
        for number in range(context.num_numeric_parameter_groups() if parameters else 0):
            size = context.get_numeric_parameter(number).size()
            names = _names(path, system, "parameters", number, f"parameter_{number}", size)
            yield _Group(path, "parameter", number, names)


def scheduled_groups(system: Any) -> list[int]:
    """Return the indices of the discrete state groups with `is_scheduled`, which linear models leave out."""
    states = system.states.values() if isinstance(system, FleetSystem) else ()
    return [int(group.index) for group in states if group.index is not None and group.is_scheduled]


def _names(
    path: Sequence[str], system: Any, kind: Literal["states", "parameters"], number: int | None, name: str, size: int
) -> tuple[str, ...]:
    """Return the names of a vector's elements, which end with a component name (FleetSystem) or an index."""
    if isinstance(system, FleetSystem):
        (part,) = [part for part in getattr(system, kind).values() if part.index == number]
        rows = [".".join((*path, part.name, row)).rstrip(".") for row in part.layout.names]
        if system.num_vehicles == 1:
            return tuple(rows)
        return tuple(f"{row}.{vehicle}" for row in rows for vehicle in range(system.num_vehicles))
    return tuple(".".join((*path, name, str(i))) for i in range(size))
