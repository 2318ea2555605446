"""Scalar signals that are computed from the signals of a diagram at one tick.

A scalar signal is a component of a signal, such as `state.z`, or a derived signal, which is a registered formula:

    @derived_signal("m/s", value_range="nonnegative")
    def speed(state):
        '''Speed of the vehicle over the ground.'''
        return sqrt(state.v_x * state.v_x + state.v_y * state.v_y + state.v_z * state.v_z)

Metrics and requirements of a scenario refer to scalar signals by name.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar, cast

from drake_quad.errors import InputError, join_names, short_repr
from drake_quad.framework.elementary import arctan2, sin_cos, sqrt, wrap_angle
from drake_quad.laboratory.metrics import ValueRange, argument_names
from drake_quad.signals import SIGNALS, Reference, Row, State, Wind, field_quantities

_Function = TypeVar("_Function", bound=Callable[..., Any])


class RowSelector(NamedTuple):
    """Formula that returns a component of a signal, given the name of the component."""

    name: str

    def __call__(self, record: Any) -> Row:
        """Return the component `name` of the signal `record`."""
        row: Row = getattr(record, self.name)
        return row


class ScalarSignal(NamedTuple):
    """Signal with a single value per tick, and the formula that computes it.

    Attributes:
        name: name of the signal, such as `tilt` or `state.z`.
        unit: unit.
        formula: formula that computes the signal.
        arguments: names of the signals that the formula takes, or of `time` and `period`.
        value_range: range of the signal.
    """

    name: str
    unit: str
    formula: Callable[..., Row]
    arguments: tuple[str, ...]
    value_range: ValueRange = "real"


DERIVED_SIGNALS: dict[str, ScalarSignal] = {}
"""Derived signals by name."""


def derived_signal(unit: str, *, value_range: ValueRange = "real") -> Callable[[_Function], _Function]:
    """Return a decorator that registers a formula as a derived signal; the signal has the name of the function.

    The arguments of the formula are signals by the names of their ports, `time` (s) or `period` (s).

    Args:
        unit: unit of the derived signal.
        value_range: range of the derived signal.
    """

    def register(function: _Function) -> _Function:
        name = function.__name__
        known = DERIVED_SIGNALS.get(name)
        if name in SIGNALS or (known is not None and known.formula.__module__ != function.__module__):
            raise ValueError(f"the name {name} is taken by another signal; rename the function")
        DERIVED_SIGNALS[name] = ScalarSignal(name, unit, function, argument_names(function), value_range)
        return function

    return register


def scalar_signal(name: str) -> ScalarSignal:
    """Return the scalar signal with a name: a derived signal, or a component such as `state.z`.

    Raises:
        InputError: if there is no such signal.
    """
    if name in DERIVED_SIGNALS:
        return DERIVED_SIGNALS[name]
    signal, _, row = name.partition(".")
    if signal in SIGNALS:
        rows = field_quantities(SIGNALS[signal]) if hasattr(SIGNALS[signal], "_fields") else {}
        if row in rows:
            return ScalarSignal(name, rows[row].unit, cast(Callable[..., Row], RowSelector(row)), (signal,))
        rows_text = join_names([f"{signal}.{each}" for each in rows]) if rows else "none that have names"
        raise InputError(
            f"{short_repr(name)} is not a component of the signal {signal}; its components are {rows_text}"
        )
    raise InputError(
        f"{short_repr(name)} is neither a component of a signal, such as state.z, nor a derived signal; derived"
        f" signals are {join_names([*DERIVED_SIGNALS])}"
    )


@derived_signal("m", value_range="nonnegative")
def position_error(state: State, reference: Reference) -> Row:
    """Distance of the vehicle from the reference."""
    x, y, z = reference.x - state.x, reference.y - state.y, reference.z - state.z
    return sqrt(x * x + y * y + z * z)


@derived_signal("rad")
def yaw_error(state: State, reference: Reference) -> Row:
    """Yaw of the reference minus yaw of the vehicle, between -π and π."""
    return wrap_angle(reference.yaw - state.yaw)


@derived_signal("m/s", value_range="nonnegative")
def speed(state: State) -> Row:
    """Speed of the vehicle over the ground."""
    return sqrt(state.v_x * state.v_x + state.v_y * state.v_y + state.v_z * state.v_z)


@derived_signal("m/s", value_range="nonnegative")
def airspeed(state: State, wind: Wind) -> Row:
    """Speed of the vehicle relative to the air."""
    x, y, z = state.v_x - wind.x, state.v_y - wind.y, state.v_z - wind.z
    return sqrt(x * x + y * y + z * z)


@derived_signal("rad/s", value_range="nonnegative")
def body_rate(state: State) -> Row:
    """Magnitude of the angular velocity of the vehicle."""
    return sqrt(state.p * state.p + state.q * state.q + state.r * state.r)


@derived_signal("rad", value_range="nonnegative")
def tilt(state: State) -> Row:
    """Angle between the thrust axis and the vertical; π for a vehicle that is upside down."""
    (sin_roll, cos_roll), (sin_pitch, cos_pitch) = sin_cos(state.roll), sin_cos(state.pitch)
    x, y = sin_pitch, cos_pitch * sin_roll
    return arctan2(sqrt(x * x + y * y), cos_roll * cos_pitch)
