"""Cascade of PIDs on position and velocity, as flight controllers have it, from a reference to an attitude target.

A loop of the position turns its error into a velocity, and a loop of the velocity turns the error of that into an
attitude and a thrust, in one of two ways:

    tilt            Along the axes of the heading, the output of the velocity loop is the pitch and, with the other sign,
                    the roll; along z it is an acceleration, which changes the thrust of hover. Each output has a limit
                    of its own. This is the Crazyflie's firmware (Bitcraze, crazyflie-firmware 2025.12,
                    `position_controller_pid.c`).
    acceleration    Along the axes of W, the output is an acceleration, to which that of the reference is added. Thrust
                    and attitude follow from the vector of the thrust, whose tilt and length are limited. Where they are
                    limited, integrals do not wind up. This is PX4 (`PositionControl.cpp` of version 1.15; PX4 User
                    Guide, "Controller diagrams: multicopter position controller", docs.px4.io; anti-windup by L.
                    Rundqwist, "Anti-reset windup for PID controllers", IFAC World Congress 1990).

The loops of attitude and body rates are on board, in `drake_quad.vehicle.autopilot`.
"""

from typing import Annotated, Any, NamedTuple

from pydrake.systems.framework import Diagram, DiagramBuilder

from drake_quad.framework.elementary import maximum, minimum, sin_cos, sqrt, where
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.framework.records import layout_of
from drake_quad.framework.wiring import build
from drake_quad.geometry.axes import TINY, BodyAxes, Vector, times
from drake_quad.geometry.flatness import attitude_of, in_heading, tilt_of
from drake_quad.geometry.per_axis import PerAxis
from drake_quad.pid.loop import Memory, Terms, differentiated, integrated, pid
from drake_quad.signals import (
    Acceleration,
    AttitudeTarget,
    ForceB,
    Number,
    Quantity,
    Reference,
    Row,
    State,
    Time,
    VelocityW,
)


class PidGains(NamedTuple):
    """Gains of a loop.

    Attributes:
        k_p: proportional gains.
        terms: further terms on each axis; None for a proportional loop.
    """

    k_p: PerAxis
    terms: tuple[Terms, Terms, Terms] | None = None


class TiltNumbers(NamedTuple):
    """Thrust of a cascade that commands roll and pitch.

    Attributes:
        hover_thrust: thrust without an error of the velocity.
        min_thrust: least thrust.
        max_thrust: largest thrust.
    """

    hover_thrust: ForceB
    min_thrust: ForceB
    max_thrust: ForceB


class AccelerationNumbers(NamedTuple):
    """Feed-forward and limits of a cascade that commands an acceleration.

    Attributes:
        feed_forward: share of the reference's acceleration that is added.
        max_speed: largest horizontal velocity that is commanded.
        max_ascent: largest velocity upwards.
        max_descent: largest velocity downwards.
        slope: tangent of the largest tilt.
        min_thrust: least thrust.
        max_thrust: largest thrust.
        horizontal_margin: horizontal thrust that is kept where the vertical thrust asks for all.
    """

    feed_forward: Number
    max_speed: VelocityW
    max_ascent: VelocityW
    max_descent: VelocityW
    slope: Number
    min_thrust: ForceB
    max_thrust: ForceB
    horizontal_margin: ForceB


class CascadeNumbers(NamedTuple):
    """Numbers of a cascade of PIDs.

    Attributes:
        position: gains of the position loop, from m to m/s.
        velocity: gains of the velocity loop, from m/s to m/s², or to rad along the two axes of a tilt.
        velocity_feed_forward: share of the reference's velocity that is added to the commanded one.
        mass: believed.
        gravity: believed g.
        command: numbers of what the velocity loop commands, whose type tells which law it is.
    """

    position: PidGains
    velocity: PidGains
    velocity_feed_forward: Number
    mass: Annotated[Row, Quantity("kg")]
    gravity: Annotated[Row, Quantity("m/s²")]
    command: TiltNumbers | AccelerationNumbers


class CascadeRules(NamedTuple):
    """Variants of the laws.

    Attributes:
        position_integrates_first: True if the integral of the position loop has the error of its own tick.
        velocity_integrates_first: the same for the velocity loop, if it commands a tilt.
        decouples_vertical: True if the commanded vertical acceleration does not change the tilt.
    """

    position_integrates_first: bool = False
    velocity_integrates_first: bool = False
    decouples_vertical: bool = True


_Memories = tuple[Memory, Memory, Memory]


class CascadeMemory(NamedTuple):
    """State of both loops."""

    position: _Memories
    velocity: _Memories


class Held(NamedTuple):
    """State of a cascade.

    Attributes:
        count: ticks since the target was computed; None if it is computed at every tick.
        target: target that is held until the next; None likewise.
        memory: state of the loops.
    """

    count: Number | None
    target: AttitudeTarget | None
    memory: CascadeMemory


def _loop(
    setpoint: Vector, measured: Vector, gains: PidGains, memories: _Memories, period: Time, integrates_first: bool
) -> tuple[Vector, _Memories]:
    terms = gains.terms or (None, None, None)
    axes = zip(setpoint, measured, gains.k_p, terms, memories, strict=True)
    (x, first), (y, second), (z, third) = (pid(*axis, period, integrates_first=integrates_first) for axis in axes)
    return Vector(x, y, z), (first, second, third)


def tilt_target(
    m: State, r: Reference, numbers: CascadeNumbers, memory: CascadeMemory, period: Time, rules: CascadeRules
) -> tuple[AttitudeTarget, CascadeMemory]:
    """Return the target of a velocity loop that commands roll and pitch, and the state of the loops.

    Args:
        m: measured state.
        r: reference.
        numbers: numbers of the cascade, with `TiltNumbers`.
        memory: state of the loops.
        period: of the loops, s.
        rules: variants of the laws.
    """
    command: Any = numbers.command
    sin_yaw, cos_yaw = sin_cos(m.yaw)

    def turned(x: Row, y: Row, z: Row) -> Vector:
        return Vector(*in_heading(Vector(x, y, z), sin_yaw, cos_yaw))

    wanted, position = _loop(
        turned(r.x, r.y, r.z),
        turned(m.x, m.y, m.z),
        numbers.position,
        memory.position,
        period,
        rules.position_integrates_first,
    )
    share = numbers.velocity_feed_forward
    fed = turned(r.v_x, r.v_y, r.v_z)
    wanted = Vector(*[own + share * velocity for own, velocity in zip(wanted, fed, strict=True)])
    moving = turned(m.v_x, m.v_y, m.v_z)
    out, velocity = _loop(
        wanted, moving, numbers.velocity, memory.velocity, period, rules.velocity_integrates_first
    )
    thrust = minimum(maximum(command.hover_thrust + numbers.mass * out.z, command.min_thrust), command.max_thrust)
    target = AttitudeTarget(thrust, -out.y, out.x, r.yaw, 0.0, 0.0, 0.0)
    return target, CascadeMemory(position, velocity)


def limited_velocity(first: tuple[Row, Row], second: tuple[Row, Row], largest: VelocityW) -> tuple[Row, Row]:
    """Return the sum of two horizontal velocities within a largest size, in which the first goes first.

    A first velocity that is too large is shortened, and the second left out. Otherwise the second is shortened until
    the sum is as large as it may be: |v₁ + s v₂ / |v₂|| = v_max.
    """
    (x_1, y_1), (x_2, y_2) = first, second
    size_1 = sqrt(x_1 * x_1 + y_1 * y_1 + TINY)
    size_2 = sqrt(x_2 * x_2 + y_2 * y_2 + TINY)
    along = (x_1 * x_2 + y_1 * y_2) / size_2
    room = maximum(largest * largest - size_1 * size_1, 0.0)
    share_2 = minimum((sqrt(along * along + room + TINY) - along) / size_2, 1.0)
    # Where the first leaves no room, the second may not lengthen or turn it.
    full = size_1 >= largest
    share_1 = where(full, largest / size_1, 1.0)
    share_2 = where(full, 0.0, share_2)
    total_x, total_y = x_1 + x_2, y_1 + y_2
    fits = total_x * total_x + total_y * total_y <= largest * largest
    return (
        where(fits, total_x, share_1 * x_1 + share_2 * x_2),
        where(fits, total_y, share_1 * y_1 + share_2 * y_2),
    )


def acceleration_target(
    m: State, r: Reference, numbers: CascadeNumbers, memory: CascadeMemory, period: Time, rules: CascadeRules
) -> tuple[AttitudeTarget, CascadeMemory]:
    """Return the target of a velocity loop that commands an acceleration; arguments are those of `tilt_target`."""
    command: Any = numbers.command
    wanted, position = _loop(
        Vector(r.x, r.y, r.z),
        Vector(m.x, m.y, m.z),
        numbers.position,
        memory.position,
        period,
        rules.position_integrates_first,
    )
    share = numbers.velocity_feed_forward
    v_x, v_y = limited_velocity((wanted.x, wanted.y), (share * r.v_x, share * r.v_y), command.max_speed)
    v_z = maximum(minimum(wanted.z + share * r.v_z, command.max_ascent), -command.max_descent)
    setpoint, moving = Vector(v_x, v_y, v_z), Vector(m.v_x, m.v_y, m.v_z)
    error = Vector(v_x - m.v_x, v_y - m.v_y, v_z - m.v_z)
    fed = Vector(r.a_x, r.a_y, r.a_z)
    accelerations, rated = [], []
    for axis, before in enumerate(memory.velocity):
        terms = Terms() if numbers.velocity.terms is None else numbers.velocity.terms[axis]
        acceleration = command.feed_forward * fed[axis] + numbers.velocity.k_p[axis] * error[axis]
        after = before
        if terms.integral is not None:
            acceleration = acceleration + before.integral
        if terms.derivative is not None:
            rate, after = differentiated(moving[axis], terms.derivative, before, period)
            acceleration = acceleration - terms.derivative.k_d * rate
        if terms.k_ff is not None:
            acceleration = acceleration + terms.k_ff * setpoint[axis]
        accelerations.append(acceleration)
        rated.append(after)
    force, unsaturated = _limited_force(Vector(*accelerations), error, numbers, rules)
    terms_of = numbers.velocity.terms or (Terms(), Terms(), Terms())
    velocity = tuple(
        [
            after
            if terms.integral is None or after.integral is None
            else after._replace(integral=integrated(after.integral, left, terms.integral, period))
            for after, left, terms in zip(rated, unsaturated, terms_of, strict=True)
        ]
    )
    tilt = tilt_of(in_heading(force, *sin_cos(r.yaw)))
    roll, pitch = attitude_of(tilt)
    (sin_roll, cos_roll), (sin_pitch, cos_pitch) = sin_cos(m.roll), sin_cos(m.pitch)
    # The rate of the yaw about Z, along the axes of the body as it is measured.
    level = r.yaw_rate * cos_pitch
    rates = -r.yaw_rate * sin_pitch, level * sin_roll, level * cos_roll
    return AttitudeTarget(tilt.thrust, roll, pitch, r.yaw, *rates), CascadeMemory(position, velocity)  # type: ignore[arg-type]


def _limited_force(
    acceleration: Vector, error: Vector, numbers: CascadeNumbers, rules: CascadeRules
) -> tuple[Vector, Vector]:
    """Return the commanded thrust in W, N, and the error of the velocity that integrals shall see, m/s."""
    command: Any = numbers.command
    mass, gravity = numbers.mass, numbers.gravity
    a_x, a_y, a_z = acceleration
    up = gravity if rules.decouples_vertical else maximum(gravity + a_z, TINY)
    level_squared = a_x * a_x + a_y * a_y
    # Horizontal over vertical thrust, per acceleration.
    slope = minimum(1.0 / up, command.slope / sqrt(level_squared + TINY))
    length = sqrt(1.0 + slope * slope * level_squared)
    f_z = maximum(mass * (gravity + a_z) * length, command.min_thrust) / length
    f_x, f_y = f_z * slope * a_x, f_z * slope * a_y
    stalled = where(
        f_z <= command.min_thrust,
        maximum(error.z, 0.0),
        where(f_z >= command.max_thrust, minimum(error.z, 0.0), error.z),
    )
    most_squared = command.max_thrust * command.max_thrust
    sideways = sqrt(f_x * f_x + f_y * f_y + TINY)
    margin = minimum(sideways, command.horizontal_margin)
    f_z = minimum(f_z, sqrt(most_squared - margin * margin))
    kept = minimum(sqrt(maximum(most_squared - f_z * f_z, TINY)) / sideways, 1.0)
    f_x, f_y = kept * f_x, kept * f_y
    produced_x, produced_y = f_x / mass, f_y / mass
    saturated = level_squared > produced_x * produced_x + produced_y * produced_y
    gain = 2.0 / numbers.velocity.k_p.x
    left_x = error.x - where(saturated, gain * (a_x - produced_x), 0.0)
    left_y = error.y - where(saturated, gain * (a_y - produced_y), 0.0)
    return Vector(f_x, f_y, f_z), Vector(left_x, left_y, stalled)


def _memories(gains: PidGains) -> _Memories:
    first, second, third = (Memory.of(terms) for terms in gains.terms or (None, None, None))
    return first, second, third


def _first_memory(numbers: CascadeNumbers) -> CascadeMemory:
    return CascadeMemory(_memories(numbers.position), _memories(numbers.velocity))


def first_held(numbers: CascadeNumbers, num_ticks: int) -> Held:
    """Return the state before the first tick."""
    if num_ticks == 1:
        return Held(None, None, _first_memory(numbers))
    target = AttitudeTarget(numbers.mass * numbers.gravity, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    return Held(0.0, target, _first_memory(numbers))


def cascade_after(
    m: State,
    r: Reference,
    numbers: CascadeNumbers,
    held: Held | None,
    tick: Time,
    num_ticks: int,
    rules: CascadeRules,
) -> tuple[AttitudeTarget, Held]:
    """Return the target of a tick, and the state after it.

    Args:
        m: measured state.
        r: reference.
        numbers: numbers of the cascade.
        held: state before the tick; None if there is nothing to remember.
        tick: period of the control, s.
        num_ticks: ticks from one computation of the loops to the next.
        rules: variants of the laws.
    """
    memory = _first_memory(numbers) if held is None else held.memory
    tilts = isinstance(numbers.command, TiltNumbers)
    law = tilt_target if tilts else acceleration_target
    target, after = law(m, r, numbers, memory, num_ticks * tick, rules)
    if held is None or held.count is None or held.target is None:
        return target, Held(None, None, after)
    due = held.count < 0.5
    target, after = where(due, (target, after), (held.target, memory))
    if tilts:
        target = target._replace(yaw=r.yaw)
    count = where(held.count > num_ticks - 1.5, 0.0, held.count + 1.0)
    return target, Held(count, target, after)


def _target(*reads: Any) -> AttitudeTarget:
    return cascade_after(*reads)[0]


def _acceleration(*reads: Any) -> Acceleration:
    _, _, numbers, *_ = reads
    thrust, roll, pitch, yaw, *_ = cascade_after(*reads)[0]
    x, y, z = times(thrust / numbers.mass, BodyAxes.of(roll, pitch, yaw).z)
    return Acceleration(x, y, z - numbers.gravity)


def _after(*reads: Any) -> Held:
    return cascade_after(*reads)[1]


@fleet_system(float, AutoDiffXd)
class PidCascade(FleetSystem):
    """PIDs on position and velocity, which command an attitude on board.

    .. pydrake_system::

        name: PidCascade
        input_ports:
        - measurement
        - reference
        output_ports:
        - attitude_target
        - acceleration_command

    The laws are in `drake_quad.control.pid_cascade`. The `acceleration_command` is the acceleration of the believed
    vehicle that has the commanded attitude and thrust. The loops are computed at every `num_ticks`-th tick of the control;
    between these ticks the `attitude_target` is held, but for the yaw beside a commanded tilt, which is the reference's.

    The state `held` is there if anything is remembered. The only parameter of the context is `numbers`.

    Args:
        num_vehicles: N.
        tick: period of the control, s.
        num_ticks: ticks from one computation of the loops to the next.
        rules: variants of the laws.
        numbers: gains, limits, and what is believed of the vehicle.
    """

    def declare(
        self, *, tick: float = 0.02, num_ticks: int = 1, rules: CascadeRules = CascadeRules(), numbers: CascadeNumbers
    ) -> None:
        """Declare ports, state and parameters."""
        parameter = self.parameter("numbers", lambda numbers: numbers)
        held = None
        if layout_of(Held, first_held(numbers, num_ticks)).num_rows:
            held = self.state("held", lambda numbers: first_held(numbers, num_ticks))
        reads = self.input("measurement"), self.input("reference"), parameter, held, tick, num_ticks, rules
        if held is not None:
            self.update(tick, _after, *reads, writes=[held])
        self.output("attitude_target", _target, *reads)
        self.output("acceleration_command", _acceleration, *reads)


def build_pid_cascade(cascade: Any) -> Diagram:
    """Return the diagram `control` with a `PidCascade`."""
    builder = DiagramBuilder()
    builder.AddNamedSystem("cascade", cascade)
    for name in ("measurement", "reference"):
        builder.ExportInput(cascade.GetInputPort(name), name)
    for name in ("attitude_target", "acceleration_command"):
        builder.ExportOutput(cascade.GetOutputPort(name), name)
    return build(builder, "control")
