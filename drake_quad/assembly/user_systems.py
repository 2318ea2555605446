"""Systems of the user's own, which stand in for parts of the loop."""

import inspect
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

from drake_quad.errors import InputError
from drake_quad.framework.records import layout_of
from drake_quad.signals import SIGNALS


class UserSystems(NamedTuple):
    """Systems that a user puts into the loop; or, for studies, functions that make them for N vehicles.

    Attributes:
        position_controller: stands in for the scenario's: from `measurement` and `reference` to
            `acceleration_command`.
        control: stands in for the whole cascade: from `measurement` and `reference`, and perhaps `reference_jerk` and
            `reference_snap`, to `wrench` or, with an autopilot on board, to `attitude_target`. It may also read the
            sensors of the scenario, at input ports with their names.
        wind: a source of wind beside the scenario's: one output port with the velocity of the air, and perhaps the
            input port `state`. It is sampled at the vehicle's time step, unless it is a FleetSystem that updates
            itself, as those of `drake_quad.laboratory` do.
        policy: stands in for the network of a control of kind `policy`: from `observation`, if it looks at it, to
            `action`.
    """

    position_controller: Any = None
    control: Any = None
    wind: Any = None
    policy: Any = None

    @property
    def given(self) -> dict[str, Any]:
        """Systems that the user gives, by their place."""
        return {name: system for name, system in self._asdict().items() if system is not None}

    def made(self, num_vehicles: int) -> "UserSystems":
        """Return the systems that these functions make for N vehicles.

        Raises:
            InputError: a function cannot be called with only the number of vehicles, or it returns no Drake system.
        """
        systems = {}
        for name, make in self.given.items():
            takes_a_number = _takes_a_number(make)
            system = make(num_vehicles) if takes_a_number else None
            if not _is_system(system):  # for None, the scenario's own system would silently be used
                found = (
                    f"{_described(make)} returns {_returned(system)}" if takes_a_number else f"is {_described(make)}"
                )
                raise InputError(
                    f"{name} must be a function of the number of vehicles that returns a Drake system for them, as in"
                    f" `def make(num_vehicles): return Mine(num_vehicles=num_vehicles)`, but {found}"
                )
            systems[name] = system
        return UserSystems(**systems)


class SystemPlace(NamedTuple):
    """Ports that a system in a place of the loop must have.

    Attributes:
        inputs: the input ports that it may have.
        output: the signal of its output port.
        named: whether that port must have the signal's name, and others may stand beside it.
        all_inputs: whether it must have all of the inputs.
    """

    inputs: tuple[str, ...]
    output: str
    named: bool
    all_inputs: bool


PLACES = {
    "position_controller": SystemPlace(
        ("measurement", "reference"), "acceleration_command", named=True, all_inputs=True
    ),
    "control": SystemPlace(
        ("measurement", "reference", "reference_jerk", "reference_snap"), "wrench", named=True, all_inputs=False
    ),
    "wind": SystemPlace(("state",), "wind", named=False, all_inputs=False),
    "policy": SystemPlace(("observation",), "action", named=False, all_inputs=False),
}


def check_user_systems(
    systems: UserSystems,
    num_vehicles: int,
    *,
    command: str,
    rows: Mapping[str, int] = MappingProxyType({}),
    sensors: Iterable[str] = (),
) -> None:
    """Check that a user's systems have the ports that their places in the loop need.

    Args:
        systems: to check.
        num_vehicles: N.
        command: signal that the command link carries, which a control must have.
        rows: of the signals of a policy, if the control has a place for one.
        sensors: signals of sensors, which a control may read.

    Raises:
        InputError: one of them does not fit.
    """
    if systems.control is not None and systems.position_controller is not None:
        raise InputError("control stands in for the whole cascade, so there is no place for a position_controller")
    if systems.policy is not None and (not rows or systems.control is not None):
        raise InputError("there is no place for a policy but in a control of kind policy")
    for name, system in systems.given.items():
        place = PLACES[name]
        if name == "control":
            place = place._replace(inputs=(*place.inputs, *sensors), output=command)
        sizes = {
            port: rows[port] if port in rows else layout_of(SIGNALS[port]).num_rows
            for port in (*place.inputs, place.output)
        }
        _check(name, system, place, sizes, num_vehicles)


def _check(name: str, system: Any, place: SystemPlace, sizes: Mapping[str, int], num_vehicles: int) -> None:
    if not _is_system(system):
        alone = ", an object and not its class or a function that returns it" if callable(system) else ""
        raise InputError(f"{name} must be a Drake system{alone}, but is {_described(system)}")
    inputs = {port.get_name(): port.size() for port in map(system.get_input_port, range(system.num_input_ports()))}
    outputs = {port.get_name(): port.size() for port in map(system.get_output_port, range(system.num_output_ports()))}
    if (place.output not in outputs) if place.named else (len(outputs) != 1):
        wanted = f"the output port `{place.output}`" if place.named else "a single output port"
        raise InputError(f"{name} needs {wanted}, but has {_listed(outputs)}")
    # Random numbers come from elsewhere.
    random = getattr(system, "random_inputs", {})
    allowed = {port: sizes[port] for port in place.inputs}
    for port in inputs:
        if port not in allowed and port not in random:
            raise InputError(f"{name} has the input port `{port}`, but may have {_listed(allowed)}")
    for port in allowed:
        if place.all_inputs and port not in inputs:
            raise InputError(f"{name} needs the input port `{port}`, but has {_listed(inputs)}")
    output = place.output if place.named else next(iter(outputs))
    there = [(port, inputs[port], rows) for port, rows in allowed.items() if port in inputs]
    for port, size, rows in [*there, (output, outputs[output], sizes[place.output])]:
        if size != rows * num_vehicles:
            fleet = f" for each of {num_vehicles} vehicles" if num_vehicles > 1 else ""
            raise InputError(f"the port `{port}` of {name} must have {rows} rows{fleet}, but has {size}")


def _is_system(thing: Any) -> bool:
    """Return whether a thing is a Drake system, and not the class of one."""
    return not isinstance(thing, type) and hasattr(thing, "num_output_ports")


def _takes_a_number(make: Any) -> bool:
    """Return whether the signature of a function, if it has one, permits a call with one argument."""
    try:
        inspect.signature(make).bind(1)
    except TypeError:  # raised for objects that are not callable, too
        return False
    except ValueError:  # functions implemented in C++ may have no signature
        return True
    return True


def _described(thing: Any) -> str:
    """Return a short description of an object that should be a system, without its memory address."""
    if not callable(thing):
        return "None" if thing is None else f"an object of type {type(thing).__name__}"
    name = getattr(thing, "__name__", type(thing).__name__)
    try:
        return f"{name}{inspect.signature(thing)}"
    except (TypeError, ValueError):
        return str(name)


def _returned(thing: Any) -> str:
    """Return a short description of what a function returned instead of a system."""
    if isinstance(thing, type):
        return f"the class {thing.__name__} and not an object of it"
    return "nothing" if thing is None else _described(thing)


def _listed(names: Mapping[str, int]) -> str:
    return ", ".join(f"`{name}`" for name in names) or "none"
