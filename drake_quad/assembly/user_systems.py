"""Systems that a user passes to replace parts of the closed loop, and checks of their ports."""

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

from drake_quad.errors import InputError, did_you_mean
from drake_quad.framework.records import layout_of
from drake_quad.signals import SIGNALS
from drake_quad.user_code import describe_callable, takes_one_argument

_PATH_SEPARATOR = "::"  # before each name in the path of a Drake system


class UserSystems(NamedTuple):
    """The user's Drake systems in the closed loop or, for studies, functions that build these systems for N vehicles.

    Attributes:
        position_controller: replaces the position controller of the scenario. Input ports: `measurement` and
            `reference`. Output port: `acceleration_command`.
        control: replaces the whole control of the scenario. Input ports: any of `measurement`, `reference`,
            `reference_jerk`, `reference_snap` and the sensors of the scenario; `state` if its attribute
            `reads_true_state` is true. Output port: `wrench` or, with an autopilot on board, `attitude_target`.
        wind: source of wind in addition to the sources of the scenario. Input port: optionally `state`. The single
            output port, with any name, is the velocity of the air. The output is sampled at the time step of the
            vehicle, unless the source is a `FleetSystem` with discrete updates, as in `drake_quad.laboratory`.
        policy: replaces the network of a control of kind `policy`. Input port: optionally `observation`. The single
            output port, with any name, is the action.
    """

    position_controller: Any = None
    control: Any = None
    wind: Any = None
    policy: Any = None

    @property
    def specified(self) -> dict[str, Any]:
        """Systems that the user passes, keyed by attribute name."""
        return {name: system for name, system in self._asdict().items() if system is not None}

    def build(self, num_vehicles: int) -> "UserSystems":
        """Call the user's functions, and return the systems that they build for N vehicles.

        Raises:
            InputError: if a function cannot be called with the number of vehicles as its only argument, or does not
                return a Drake system.
        """
        systems = {}
        for name, make in self.specified.items():
            takes_number = takes_one_argument(make)
            system = make(num_vehicles) if takes_number else None
            if not _is_system(system):  # reject None, which would later select the scenario's system
                name_of_function = describe_callable(make)
                result = _describe_result(system)
                flaw = f"{name_of_function} returns {result}" if takes_number else f"is {name_of_function}"
                raise InputError(
                    f"{name} must be a function of the number of vehicles that returns a Drake system for them, as in"
                    f" `def make(num_vehicles): return Mine(num_vehicles=num_vehicles)`, but {flaw}"
                )
            systems[name] = system
        return UserSystems(**systems)


class SystemPorts(NamedTuple):
    """Ports that a user's system may have or must have.

    Attributes:
        inputs: names of the input ports that the system may have.
        output: signal of the output port.
        named: True if the output port must have the name of the signal, and the system may have further output ports.
        all_inputs: True if the system must have all input ports.
    """

    inputs: tuple[str, ...]
    output: str
    named: bool
    all_inputs: bool


PORTS = {
    "position_controller": SystemPorts(
        ("measurement", "reference"), "acceleration_command", named=True, all_inputs=True
    ),
    "control": SystemPorts(
        ("measurement", "reference", "reference_jerk", "reference_snap"), "wrench", named=True, all_inputs=False
    ),
    "wind": SystemPorts(("state",), "wind", named=False, all_inputs=False),
    "policy": SystemPorts(("observation",), "action", named=False, all_inputs=False),
}
"""Drake ports of the systems that a user can pass, keyed by attribute name in `UserSystems`."""


def check_user_systems(
    systems: UserSystems,
    num_vehicles: int,
    *,
    command: str,
    rows: Mapping[str, int] = MappingProxyType({}),
    sensors: Iterable[str] = (),
) -> None:
    """Check the ports of a user's systems.

    Args:
        systems: systems to check.
        num_vehicles: number of vehicles N.
        command: signal that the command link carries, which a user's control must compute.
        rows: sizes of `observation` and `action` for one vehicle, if the scenario's control has a policy.
        sensors: names of the sensor ports that a user's control may read.

    Raises:
        InputError: if a system has unsuitable ports, or if two systems cannot be used together.
    """
    if systems.control is not None and systems.position_controller is not None:
        raise InputError(
            "pass either control or position_controller, not both: control also replaces the position controller"
        )
    if systems.policy is not None and (not rows or systems.control is not None):
        raise InputError(
            "a policy requires a scenario with control of kind policy, and must not be given together with a control"
        )
    for name, system in systems.specified.items():
        ports = PORTS[name]
        if name == "control":
            truth = ("state",) if getattr(system, "reads_true_state", False) else ()
            ports = ports._replace(inputs=(*ports.inputs, *sensors, *truth), output=command)
        sizes = {
            port: rows[port] if port in rows else layout_of(SIGNALS[port]).num_rows
            for port in (*ports.inputs, ports.output)
        }
        _check_ports(name, system, ports, sizes, num_vehicles)


def _check_ports(name: str, system: Any, ports: SystemPorts, sizes: Mapping[str, int], num_vehicles: int) -> None:
    if not _is_system(system):
        hint = ", an object and not its class or a function that returns it" if callable(system) else ""
        raise InputError(f"{name} must be a Drake system{hint}, but is {describe_callable(system)}")
    if system.GetSystemPathname().count(_PATH_SEPARATOR) > 1:
        raise InputError(f"{name} is already part of another diagram; create a new object for each simulation")
    inputs = {port.get_name(): port.size() for port in map(system.get_input_port, range(system.num_input_ports()))}
    outputs = {port.get_name(): port.size() for port in map(system.get_output_port, range(system.num_output_ports()))}
    if (ports.output not in outputs) if ports.named else (len(outputs) != 1):
        required = f"the output port `{ports.output}`" if ports.named else "a single output port"
        raise InputError(f"{name} must have {required}, but has {_listed(outputs)}")
    random = getattr(system, "random_inputs", {})
    allowed = {port: sizes[port] for port in ports.inputs}
    for port in inputs:
        if port not in allowed and port not in random:
            question = did_you_mean(port, allowed, 1)
            hint = f"; {question}" if question else ""
            raise InputError(f"{name} has the input port `{port}`, but may only have {_listed(allowed)}{hint}")
    for port in allowed:
        if ports.all_inputs and port not in inputs:
            raise InputError(f"{name} must have the input port `{port}`, but has {_listed(inputs)}")
    output = ports.output if ports.named else next(iter(outputs))
    connected = [(port, inputs[port], rows) for port, rows in allowed.items() if port in inputs]
    for port, size, rows in [*connected, (output, outputs[output], sizes[ports.output])]:
        if size != rows * num_vehicles:
            fleet = f" for each of {num_vehicles} vehicles" if num_vehicles > 1 else ""
            raise InputError(f"the port `{port}` of {name} must have {rows} elements{fleet}, but has {size}")


def _is_system(thing: Any) -> bool:
    """Return whether an object is a Drake system, as opposed to the class of a system."""
    return not isinstance(thing, type) and hasattr(thing, "num_output_ports")


def _describe_result(thing: Any) -> str:
    """Return a short description of what a function returned instead of a system."""
    if isinstance(thing, type):
        return f"the class {thing.__name__} and not an object of it"
    return "nothing" if thing is None else describe_callable(thing)


def _listed(names: Mapping[str, int]) -> str:
    return ", ".join(f"`{name}`" for name in names) or "none"
