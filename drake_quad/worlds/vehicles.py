"""Input ports of a system that reads all vehicles of a world."""

from typing import Any, cast

from drake_quad.framework.fleet_system import FleetSystem
from drake_quad.framework.records import layout_of
from drake_quad.signals import Crashed, Row, State


def vehicle_inputs(system: FleetSystem, count: int) -> list[Any]:
    """Declare the input ports `state_1`, ..., `state_n` and `crashed_1`, ..., `crashed_n` of a system.

    Args:
        system: system that is being declared.
        count: number n of vehicles in a world.

    Returns:
        inputs: the inputs, in the order that `states_and_crashed` expects.
    """
    states = [system.input(f"state_{k}", layout=layout_of(State)) for k in range(1, count + 1)]
    crashed = [system.input(f"crashed_{k}", layout=layout_of(Crashed)) for k in range(1, count + 1)]
    return states + crashed


def states_and_crashed(inputs: tuple[State | Crashed, ...]) -> tuple[list[State], list[Row]]:
    """Return the states of all vehicles, and whether each of them has crashed (1) or not (0).

    Args:
        inputs: values of the inputs that `vehicle_inputs` declared.
    """
    count = len(inputs) // 2
    return (
        [cast(State, state) for state in inputs[:count]],
        [cast(Crashed, crashed).crashed for crashed in inputs[count:]],
    )
