"""Whether a system of one's own fits into the loop."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from drake_quad.errors import InputError


class Place(NamedTuple):
    """What a system in some place of the loop must be like.

    Attributes:
        inputs: rows of the input ports that it may have.
        output: name of the output port that it must have; any name if empty.
        rows: of that.
        all_inputs: whether it must have all of the inputs.
    """

    inputs: Mapping[str, int]
    output: str
    rows: int
    all_inputs: bool


_SEEN = {"measurement": 12, "reference": 11}
PLACES = {
    "position_controller": Place(_SEEN, "acceleration_command", 3, all_inputs=True),
    "control": Place({**_SEEN, "reference_jerk": 3, "reference_snap": 4}, "wrench", 4, all_inputs=False),
    "wind": Place({"state": 12}, "", 3, all_inputs=False),
}


def check_substitutes(substitutes: Mapping[str, Any], num_vehicles: int) -> None:
    """Checks the systems that are given for places of the loop.

    Args:
        substitutes: by the name of the place; None where none is given.
        num_vehicles: N.

    Raises:
        InputError: one of them does not fit.
    """
    if substitutes["control"] is not None and substitutes["position_controller"] is not None:
        raise InputError("control stands in for the whole cascade, so there is no place for a position_controller")
    for name, system in substitutes.items():
        if system is not None:
            _check(name, system, PLACES[name], num_vehicles)


def _check(name: str, system: Any, place: Place, num_vehicles: int) -> None:
    if isinstance(system, type) or not hasattr(system, "num_output_ports"):
        raise InputError(f"{name} must be a Drake system, an object and not its class, but is {system!r}")
    inputs = {port.get_name(): port.size() for port in map(system.get_input_port, range(system.num_input_ports()))}
    outputs = {port.get_name(): port.size() for port in map(system.get_output_port, range(system.num_output_ports()))}
    if (place.output not in outputs) if place.output else (len(outputs) != 1):
        wanted = f"the output port `{place.output}`" if place.output else "a single output port"
        raise InputError(f"{name} needs {wanted}, but has {_listed(outputs)}")
    # Random numbers come from elsewhere.
    random = getattr(system, "random_inputs", {})
    for port in inputs:
        if port not in place.inputs and port not in random:
            raise InputError(f"{name} has the input port `{port}`, but may have {_listed(place.inputs)}")
    for port in place.inputs:
        if place.all_inputs and port not in inputs:
            raise InputError(f"{name} needs the input port `{port}`, but has {_listed(inputs)}")
    output = place.output or next(iter(outputs))
    sizes = [(port, inputs[port], rows) for port, rows in place.inputs.items() if port in inputs]
    for port, size, rows in [*sizes, (output, outputs[output], place.rows)]:
        if size != rows * num_vehicles:
            fleet = f" for each of {num_vehicles} vehicles" if num_vehicles > 1 else ""
            raise InputError(f"the port `{port}` of {name} must have {rows} rows{fleet}, but has {size}")


def _listed(names: Mapping[str, int]) -> str:
    return ", ".join(f"`{name}`" for name in names) or "none"
