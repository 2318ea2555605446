"""Observations of a policy: rows of named signals at the present tick and at earlier ticks.

Vectors are expressed along the axes of a frame of `drake_quad.control.policy.frames`, or along those of B (`body`).
"""

from collections.abc import Callable
from typing import Literal, NamedTuple

from drake_quad.control.policy.frames import LevelFrame, level_axes
from drake_quad.framework.elementary import sin_cos
from drake_quad.geometry.axes import BodyAxes, Vector
from drake_quad.signals import Attitude, BodyRates, PositionW, Reference, RotorRate, RotorSpeed, Row, State, Wind

Frame = Literal[LevelFrame, "body"]


class Seen(NamedTuple):
    """All that an observation may be made of.

    Attributes:
        state: of the vehicle, measured or true.
        reference: to follow.
        ahead: where the reference will be, X, Y and Z of one time after another, m.
        rotor_speed: None if nothing looks at it.
        wind: None if nothing looks at it.
        action: the last one.
        clearance: from obstacles, m; None if nothing looks at it.
        top_speed: of the rotors, rad/s.
        axes: of the frame; None for W.
        attitude: of the vehicle, in which rotations are seen.
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

    def turned(self, x: Row, y: Row, z: Row) -> Vector:
        """A vector in W along the axes of the frame."""
        return Vector(x, y, z) if self.axes is None else self.axes.in_body(Vector(x, y, z))


def _position(seen: Seen) -> tuple[Row, ...]:
    return seen.state.x, seen.state.y, seen.state.z


def _position_error(seen: Seen) -> tuple[Row, ...]:
    state, reference = seen.state, seen.reference
    return seen.turned(reference.x - state.x, reference.y - state.y, reference.z - state.z)


def _velocity(seen: Seen) -> tuple[Row, ...]:
    return seen.turned(seen.state.v_x, seen.state.v_y, seen.state.v_z)


def _velocity_error(seen: Seen) -> tuple[Row, ...]:
    state, reference = seen.state, seen.reference
    return seen.turned(reference.v_x - state.v_x, reference.v_y - state.v_y, reference.v_z - state.v_z)


def _reference_velocity(seen: Seen) -> tuple[Row, ...]:
    return seen.turned(seen.reference.v_x, seen.reference.v_y, seen.reference.v_z)


def _reference_acceleration(seen: Seen) -> tuple[Row, ...]:
    return seen.turned(seen.reference.a_x, seen.reference.a_y, seen.reference.a_z)


def _reference_ahead(seen: Seen) -> tuple[Row, ...]:
    rows: list[Row] = []
    coordinates = iter(seen.ahead)
    for x, y, z in zip(coordinates, coordinates, coordinates, strict=True):
        rows += seen.turned(x - seen.state.x, y - seen.state.y, z - seen.state.z)
    return tuple(rows)


def _rotation(seen: Seen) -> tuple[Row, ...]:
    x, y, z = seen.attitude
    return (x.x, y.x, z.x, x.y, y.y, z.y, x.z, y.z, z.z)


def _attitude(seen: Seen) -> tuple[Row, ...]:
    return Attitude(seen.state.roll, seen.state.pitch, seen.state.yaw)


def _yaw_error(seen: Seen) -> tuple[Row, ...]:
    return sin_cos(seen.reference.yaw - seen.state.yaw)


def _body_rates(seen: Seen) -> tuple[Row, ...]:
    return BodyRates(seen.state.p, seen.state.q, seen.state.r)


def _rotor_speed(seen: Seen) -> tuple[Row, ...]:
    assert seen.rotor_speed is not None
    return tuple([speed / seen.top_speed for speed in seen.rotor_speed])


def _wind(seen: Seen) -> tuple[Row, ...]:
    assert seen.wind is not None
    return seen.turned(*seen.wind)


def _clearance(seen: Seen) -> tuple[Row, ...]:
    assert seen.clearance is not None
    return (seen.clearance,)


def _action(seen: Seen) -> tuple[Row, ...]:
    return seen.action


class SignalSeen(NamedTuple):
    """Something that a policy can see.

    Attributes:
        rows: that it has; None if others say how many.
        of: an observation's rows, from all that it may be made of.
        meaning: with its unit.
    """

    rows: int | None
    of: Callable[[Seen], tuple[Row, ...]]
    meaning: str


SIGNALS_SEEN = {
    "position": SignalSeen(3, _position, "of the vehicle along X, Y, Z, whatever the frame (m)"),
    "position_error": SignalSeen(3, _position_error, "from the vehicle to the reference (m)"),
    "velocity": SignalSeen(3, _velocity, "of the vehicle (m/s)"),
    "velocity_error": SignalSeen(3, _velocity_error, "the reference's velocity minus the vehicle's (m/s)"),
    "reference_velocity": SignalSeen(3, _reference_velocity, "of the reference (m/s)"),
    "reference_acceleration": SignalSeen(3, _reference_acceleration, "of the reference (m/s²)"),
    "reference_ahead": SignalSeen(
        None, _reference_ahead, "from the vehicle to where the reference will be, 3 for each time of `ahead` (m)"
    ),
    "attitude": SignalSeen(3, _attitude, "roll, pitch and yaw in W, whatever the frame (rad)"),
    "rotation": SignalSeen(
        9,
        _rotation,
        "the matrix from B to W row by row; from B to the turned W with `heading` and `reference_heading` (1)",
    ),
    "yaw_error": SignalSeen(2, _yaw_error, "sine and cosine of the reference's yaw minus the vehicle's (1)"),
    "body_rates": SignalSeen(3, _body_rates, "p, q, r along the axes of B (rad/s)"),
    "rotor_speed": SignalSeen(
        4, _rotor_speed, "the rotors' own, which no sensor tells, over the top speed in `nominal` (1)"
    ),
    "wind": SignalSeen(3, _wind, "as it is where the vehicle is, which no sensor tells (m/s)"),
    "clearance": SignalSeen(1, _clearance, "between the vehicle's sphere and the nearest obstacle (m)"),
    "action": SignalSeen(None, _action, "the last one as the policy gave it, also beyond -1 and 1 (1)"),
}
"""What can be seen, by name; vectors are along the axes of the frame unless something else is said."""


class ObservationSpec(NamedTuple):
    """Specification of an observation.

    Attributes:
        signals: names from `SIGNALS_SEEN`, in the order of the rows.
        frame: frame along whose axes vectors are expressed.
        history: number of ticks in the observation, including the present one.
        turn: rotation about z from x_B to the front of the policy, rad; it also rotates all frames except W.
    """

    signals: tuple[str, ...]
    frame: Frame = "world"
    history: int = 1
    turn: float = 0.0


def num_observed(spec: ObservationSpec, *, num_actions: int, num_ahead: int) -> int:
    """Rows that are seen at a tick."""
    sizes = {name: signal.rows for name, signal in SIGNALS_SEEN.items()}
    sizes |= {"action": num_actions, "reference_ahead": 3 * num_ahead}
    return sum(sizes[name] or 0 for name in spec.signals)


class ObservationNumbers(NamedTuple):
    """What an observation knows of the vehicle.

    Attributes:
        top_speed: of the rotors, by which their speeds are divided.
        initial_action: that stands for the last one at the beginning.
    """

    top_speed: RotorRate
    initial_action: tuple[Row, ...]


def observed(
    state: State,
    reference: Reference,
    ahead: tuple[PositionW, ...],
    rotor_speed: RotorSpeed | None,
    wind: Wind | None,
    action: tuple[Row, ...],
    numbers: ObservationNumbers,
    clearance: Callable[[Row, Row, Row], Row] | None,
    spec: ObservationSpec,
) -> tuple[Row, ...]:
    """Return the rows of an observation at one tick.

    Args:
        state: measured or true state of the vehicle.
        reference: reference that the vehicle follows.
        ahead: future positions of the reference, X, Y and Z of one time after another.
        rotor_speed: rotor speeds; None if the observation does not contain them.
        wind: velocity of the air; None if the observation does not contain it.
        action: last action.
        numbers: parameters of the vehicle.
        clearance: function of X, Y and Z that returns the distance to the nearest obstacle, m; None if the observation
            does not contain it.
        spec: specification of the observation.
    """
    state, attitude = _with_own_axes(state, spec)
    if spec.frame == "body":
        axes: BodyAxes | None = attitude
    else:
        axes = level_axes(spec.frame, state.yaw, reference.yaw, spec.turn)
        if axes is not None:
            attitude = BodyAxes._make(map(axes.in_body, attitude))
    distance = None if clearance is None else clearance(state.x, state.y, state.z)
    seen = Seen(state, reference, ahead, rotor_speed, wind, action, distance, numbers.top_speed, axes, attitude)
    return tuple([row for name in spec.signals for row in SIGNALS_SEEN[name].of(seen)])


def _with_own_axes(state: State, spec: ObservationSpec) -> tuple[State, BodyAxes]:
    """The state and the axes of a body that the policy takes for the vehicle's."""
    body = BodyAxes.of(state.roll, state.pitch, state.yaw)
    if spec.turn == 0.0:
        return state, body
    sine, cosine = sin_cos(spec.turn)
    x = Vector._make(cosine * a + sine * b for a, b in zip(body.x, body.y, strict=True))
    y = Vector._make(cosine * b - sine * a for a, b in zip(body.x, body.y, strict=True))
    rates = {"p": cosine * state.p + sine * state.q, "q": cosine * state.q - sine * state.p}
    return state._replace(**rates), BodyAxes(x, y, body.z)
