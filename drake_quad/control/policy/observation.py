"""Observations of a policy: values of named signals at the current tick and at earlier ticks.

Vectors are expressed in a frame of `drake_quad.control.policy.frames` or in B (`body`). Sensor readings are observed as
they are, in the axes of the sensor.
"""

from collections.abc import Callable
from typing import Any, Literal, NamedTuple

from drake_quad.control.policy.frames import LevelFrame, level_axes
from drake_quad.framework.elementary import sin_cos
from drake_quad.framework.records import layout_of
from drake_quad.geometry.axes import BodyAxes, Vector
from drake_quad.signals import (
    SIGNALS,
    Attitude,
    BodyRates,
    PositionW,
    Reference,
    RotorRate,
    RotorSpeed,
    Row,
    State,
    Wind,
)

Frame = Literal[LevelFrame, "body"]


class Observables(NamedTuple):
    """All quantities that an observation can contain.

    Attributes:
        state: measured or true state of the vehicle.
        reference: reference that the vehicle follows.
        ahead: future positions of the reference, m: X, Y and Z at the first future time, then at each later time.
        rotor_speed: rotor speeds; None if the observation does not contain them.
        wind: velocity of the air; None if the observation does not contain it.
        action: last action.
        clearance: distance to the nearest obstacle, m; None if the observation does not contain it.
        top_speed: largest rotor speed, rad/s.
        axes: axes of the frame in W; None for W itself.
        attitude: axes of B, rotated about z_B by the `turn` of the policy. They are expressed in the frame, or in W if
            the frame is `world` or `body`.
    """

    state: State
    reference: Reference
    ahead: tuple[PositionW, ...]
    rotor_speed: RotorSpeed | None
    wind: Wind | None
    action: tuple[Row, ...]
    clearance: Row | None
    top_speed: Row
    axes: BodyAxes | None
    attitude: BodyAxes

    def in_frame(self, x: Row, y: Row, z: Row) -> Vector:
        """Return the components, along the axes of the frame, of a vector in W."""
        return Vector(x, y, z) if self.axes is None else self.axes.in_body(Vector(x, y, z))


def _position(observables: Observables) -> tuple[Row, ...]:
    return observables.state.x, observables.state.y, observables.state.z


def _position_error(observables: Observables) -> tuple[Row, ...]:
    state, reference = observables.state, observables.reference
    return observables.in_frame(reference.x - state.x, reference.y - state.y, reference.z - state.z)


def _velocity(observables: Observables) -> tuple[Row, ...]:
    return observables.in_frame(observables.state.v_x, observables.state.v_y, observables.state.v_z)


def _velocity_error(observables: Observables) -> tuple[Row, ...]:
    state, reference = observables.state, observables.reference
    return observables.in_frame(reference.v_x - state.v_x, reference.v_y - state.v_y, reference.v_z - state.v_z)


def _reference_velocity(observables: Observables) -> tuple[Row, ...]:
    return observables.in_frame(observables.reference.v_x, observables.reference.v_y, observables.reference.v_z)


def _reference_acceleration(observables: Observables) -> tuple[Row, ...]:
    return observables.in_frame(observables.reference.a_x, observables.reference.a_y, observables.reference.a_z)


def _reference_ahead(observables: Observables) -> tuple[Row, ...]:
    rows: list[Row] = []
    coordinates = iter(observables.ahead)
    for x, y, z in zip(coordinates, coordinates, coordinates, strict=True):
        rows += observables.in_frame(x - observables.state.x, y - observables.state.y, z - observables.state.z)
    return tuple(rows)


def _rotation(observables: Observables) -> tuple[Row, ...]:
    x, y, z = observables.attitude
    return (x.x, y.x, z.x, x.y, y.y, z.y, x.z, y.z, z.z)


def _attitude(observables: Observables) -> tuple[Row, ...]:
    return Attitude(observables.state.roll, observables.state.pitch, observables.state.yaw)


def _yaw_error(observables: Observables) -> tuple[Row, ...]:
    return sin_cos(observables.reference.yaw - observables.state.yaw)


def _body_rates(observables: Observables) -> tuple[Row, ...]:
    return BodyRates(observables.state.p, observables.state.q, observables.state.r)


def _rotor_speed(observables: Observables) -> tuple[Row, ...]:
    assert observables.rotor_speed is not None
    return tuple([speed / observables.top_speed for speed in observables.rotor_speed])


def _wind(observables: Observables) -> tuple[Row, ...]:
    assert observables.wind is not None
    return observables.in_frame(*observables.wind)


def _clearance(observables: Observables) -> tuple[Row, ...]:
    assert observables.clearance is not None
    return (observables.clearance,)


def _action(observables: Observables) -> tuple[Row, ...]:
    return observables.action


class ObservableSignal(NamedTuple):
    """Signal that an observation can contain.

    Attributes:
        rows: number of components; None if it depends on the policy.
        components: function that returns the components of the signal, given all observable quantities.
        description: description with unit.
    """

    rows: int | None
    components: Callable[[Observables], tuple[Row, ...]]
    description: str


OBSERVABLE_SIGNALS = {
    "position": ObservableSignal(
        3, _position, "position of the vehicle along X, Y, Z of W, independent of the `frame` (m)"
    ),
    "position_error": ObservableSignal(3, _position_error, "vector from the vehicle to the reference (m)"),
    "velocity": ObservableSignal(3, _velocity, "velocity of the vehicle (m/s)"),
    "velocity_error": ObservableSignal(3, _velocity_error, "velocity of the reference relative to the vehicle (m/s)"),
    "reference_velocity": ObservableSignal(3, _reference_velocity, "velocity of the reference (m/s)"),
    "reference_acceleration": ObservableSignal(3, _reference_acceleration, "acceleration of the reference (m/s²)"),
    "reference_ahead": ObservableSignal(
        None,
        _reference_ahead,
        "vectors from the vehicle to future positions of the reference, 3 components for each time of `ahead` (m)",
    ),
    "attitude": ObservableSignal(
        3, _attitude, "roll, pitch and yaw with respect to W, independent of the `frame` (rad)"
    ),
    "rotation": ObservableSignal(
        9,
        _rotation,
        "rotation matrix, row by row: from B to W, or to the `frame` if it is `heading` or `reference_heading` (1)",
    ),
    "yaw_error": ObservableSignal(
        2, _yaw_error, "sine and cosine of the yaw of the reference minus the yaw of the vehicle (1)"
    ),
    "body_rates": ObservableSignal(3, _body_rates, "body rates p, q, r along the axes of B (rad/s)"),
    "rotor_speed": ObservableSignal(
        4, _rotor_speed, "true rotor speeds, relative to the largest speed in `nominal`; not measurable (1)"
    ),
    "wind": ObservableSignal(3, _wind, "true wind at the vehicle; not measurable (m/s)"),
    "clearance": ObservableSignal(1, _clearance, "distance between the vehicle's sphere and the nearest obstacle (m)"),
    "action": ObservableSignal(None, _action, "last output of the policy, not saturated at -1 and 1 (1)"),
}
"""Signals that an observation can contain, by name. Vectors are expressed in the frame unless stated otherwise."""


class ObservationSpec(NamedTuple):
    """Specification of an observation.

    Attributes:
        signals: names from `OBSERVABLE_SIGNALS` and names of sensor signals, in the order in which the observation
            contains them.
        frame: frame in which vectors are expressed.
        history: number of ticks in the observation, including the current tick.
        turn: angle about z from x_B to the forward direction of the policy, rad; it also rotates all frames except W.
    """

    signals: tuple[str, ...]
    frame: Frame = "world"
    history: int = 1
    turn: float = 0.0

    @property
    def sensor_signals(self) -> tuple[str, ...]:
        """Names of the observed sensor signals: readings, and validities of readings."""
        return tuple([name for name in self.signals if name not in OBSERVABLE_SIGNALS])


def num_observed(spec: ObservationSpec, *, num_actions: int, num_ahead: int) -> int:
    """Return the number of values in an observation at one tick."""
    sizes = {name: signal.rows for name, signal in OBSERVABLE_SIGNALS.items()}
    sizes |= {"action": num_actions, "reference_ahead": 3 * num_ahead}
    sizes |= {name: layout_of(SIGNALS[name]).num_rows for name in spec.sensor_signals}
    return sum(sizes[name] or 0 for name in spec.signals)


class ObservationParameters(NamedTuple):
    """Parameters of an observation.

    Attributes:
        top_speed: largest rotor speed, by which observed rotor speeds are divided.
        initial_action: value of the last action at the first tick.
    """

    top_speed: RotorRate
    initial_action: tuple[Row, ...]


def observation_rows(
    state: State,
    reference: Reference,
    ahead: tuple[PositionW, ...],
    rotor_speed: RotorSpeed | None,
    wind: Wind | None,
    action: tuple[Row, ...],
    parameters: ObservationParameters,
    clearance: Callable[[Row, Row, Row], Row] | None,
    spec: ObservationSpec,
    *sensor_signals: Any,
) -> tuple[Row, ...]:
    """Return the values of an observation at one tick.

    Args:
        state: measured or true state of the vehicle.
        reference: reference that the vehicle follows.
        ahead: future positions of the reference: X, Y and Z at the first future time, then at each later time.
        rotor_speed: rotor speeds; None if the observation does not contain them.
        wind: velocity of the air; None if the observation does not contain it.
        action: last action.
        parameters: parameters of the observation.
        clearance: function of X, Y and Z that returns the distance to the nearest obstacle, m; None if the observation
            does not contain it.
        spec: specification of the observation.
        sensor_signals: records of the sensor signals, in the order of `spec.sensor_signals`.
    """
    state, attitude = _with_policy_axes(state, spec)
    if spec.frame == "body":
        axes: BodyAxes | None = attitude
    else:
        axes = level_axes(spec.frame, state.yaw, reference.yaw, spec.turn)
        if axes is not None:
            attitude = BodyAxes._make(map(axes.in_body, attitude))
    distance = None if clearance is None else clearance(state.x, state.y, state.z)
    observables = Observables(
        state, reference, ahead, rotor_speed, wind, action, distance, parameters.top_speed, axes, attitude
    )
    rows = {
        name: layout_of(SIGNALS[name]).flatten(record)
        for name, record in zip(spec.sensor_signals, sensor_signals, strict=True)
    }
    for name in spec.signals:
        if name not in rows:
            rows[name] = [*OBSERVABLE_SIGNALS[name].components(observables)]
    return tuple([row for name in spec.signals for row in rows[name]])


def _with_policy_axes(state: State, spec: ObservationSpec) -> tuple[State, BodyAxes]:
    """Return the state with body rates along the axes of the policy, and these axes in W.

    The axes of the policy are those of B, rotated about z_B by `spec.turn`.
    """
    body = BodyAxes.of(state.roll, state.pitch, state.yaw)
    if spec.turn == 0.0:
        return state, body
    sine, cosine = sin_cos(spec.turn)
    x = Vector._make(cosine * a + sine * b for a, b in zip(body.x, body.y, strict=True))
    y = Vector._make(cosine * b - sine * a for a, b in zip(body.x, body.y, strict=True))
    rates = {"p": cosine * state.p + sine * state.q, "q": cosine * state.q - sine * state.p}
    return state._replace(**rates), BodyAxes(x, y, body.z)
