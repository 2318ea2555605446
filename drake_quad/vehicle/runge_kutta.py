"""Classical fourth-order Runge–Kutta method."""

from collections.abc import Callable
from typing import Any, NamedTuple

from drake_quad.signals import Row


class Step(NamedTuple):
    """Step of the Runge–Kutta method.

    Attributes:
        stages: state at each of the four stages.
        end: state at the end of the step.
    """

    stages: tuple[Any, Any, Any, Any]
    end: Any


def runge_kutta_step(start: Any, derivative: Callable[[int, Any, Any], Any], time_step: float) -> Step:
    """Integrate a value, or a record of values, over a step.

    Args:
        start: state at the start of the step.
        derivative: function that returns the time derivative, which may differ in type from the state. Its arguments
            are the number of the stage (0 to 3), the state at this stage, and the state at the previous stage; for
            stage 0, both are `start`.
        time_step: time step h, s.
    """
    half = 0.5 * time_step
    derivative_1 = derivative(0, start, start)
    second = euler_step(start, derivative_1, half)
    derivative_2 = derivative(1, second, start)
    third = euler_step(start, derivative_2, half)
    derivative_3 = derivative(2, third, second)
    fourth = euler_step(start, derivative_3, time_step)
    derivative_4 = derivative(3, fourth, third)
    sixth, third_part = time_step / 6.0, time_step / 3.0
    end = euler_step(
        euler_step(
            euler_step(euler_step(start, derivative_1, sixth), derivative_2, third_part), derivative_3, third_part
        ),
        derivative_4,
        sixth,
    )
    return Step((start, second, third, fourth), end)


def euler_step(state: Any, derivative: Any, time: Row) -> Any:
    """Advance a value or a record by a time (s) with a constant derivative; a field that is None stays None."""
    if state is None:
        return None
    if not isinstance(state, tuple):
        return state + time * derivative
    record: Any = type(state)
    return record._make(euler_step(part, rate, time) for part, rate in zip(state, derivative, strict=True))
