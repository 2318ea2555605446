"""The formulas of a linear-quadratic-Gaussian controller: its filter, its regulator, and what the vehicle is told.

The frame that can be read at t was taken at t - h. So with x̂ of t - h, and u that acted since,

    x̂(t) = A (x̂ + L (y - C x̂)) + B u

and at every tick, with the deviation e of x̂ from the reference and the deviations δu of the commands under way from
what was fed forward,

    u = u_ff - K [e; δu]        δu = u - u_ff

Of K the gains of position, velocity and disturbances are those of an outer loop, which asks for the acceleration
a_r - (K_p e_p + K_v e_v + K_d d̂) / k; `axis_loop` has k.

The attitude makes a horizontal acceleration of the thrust: s = f tan θ along X, with the vertical specific thrust f.
Noise and gusts make f change faster than any attitude can follow. So the chains along X and Y are of s̄ = f̄ tan θ with

    f̄ = g + a_r - d̂₁ - d̂₂    along Z,

which keeps the vehicle on the reference and changes as slowly as that. The rest acts at once, and is known:
s - s̄ = s̄ (f - f̄) / f̄ goes straight into the velocity. Were f in the place of f̄, whatever shakes the thrust of a
leaning vehicle would seem to shake its attitude.
"""

from collections.abc import Sequence
from typing import Annotated, Any, NamedTuple

from drake_quad.control.lqg.design import AxisLoop
from drake_quad.framework.elementary import dot, maximum, minimum, sin_cos, sqrt, where, wrap_angle
from drake_quad.geometry.flatness import ThrustTilt, angular_accelerations, attitude_of, body_rates, in_heading, tilt_of
from drake_quad.signals import (
    Acceleration,
    AttitudeTarget,
    ForceB,
    Jerk,
    Number,
    PositionError,
    PositionErrorRate,
    PositionW,
    Quantity,
    Reference,
    Row,
    Snap,
    SnapW,
    State,
    Time,
    Wrench,
)


class TorqueNumbers(NamedTuple):
    """What torques over the link need.

    Attributes:
        i_xx: believed moment of inertia about x_B, kg m².
        i_yy: about y_B.
        i_zz: about z_B.
        yaw_k_p: of the yaw's PD, 1/s².
        yaw_k_d: on its rate, 1/s.
        max_snap: largest command along X and along Y.
        lead: time by which the snap is fed forward.
    """

    i_xx: Row
    i_yy: Row
    i_zz: Row
    yaw_k_p: Row
    yaw_k_d: Row
    max_snap: SnapW
    lead: Time


class TargetNumbers(NamedTuple):
    """How jerk and snap are fed forward into an attitude target.

    Attributes:
        jerk: s.
        snap: s².
    """

    jerk: Row
    snap: Row


class ThrustNumbers(NamedTuple):
    """What is believed of the vehicle, and limits.

    Attributes:
        mass: kg.
        gravity: g.
        slope: tangent of the largest angle between thrust and vertical.
        min_thrust: least vertical thrust.
        max_thrust: largest thrust.
        lead: time by which the vertical jerk is fed forward.
    """

    mass: Annotated[Row, Quantity("kg")]
    gravity: Annotated[Row, Quantity("m/s²")]
    slope: Number
    min_thrust: ForceB
    max_thrust: ForceB
    lead: Time


class LqgNumbers(NamedTuple):
    """Of a `LinearQuadraticGaussian`.

    Attributes:
        lateral: loop along X, and along Y.
        vertical: loop along Z.
        thrust: limits, and what is believed.
        torques: None with an autopilot.
        target: None without one.
    """

    lateral: AxisLoop
    vertical: AxisLoop
    thrust: ThrustNumbers
    torques: TorqueNumbers | None
    target: TargetNumbers | None


class Estimate(NamedTuple):
    """What the filter knows: a chain of `drake_quad.control.lqg.chains` for each axis."""

    x: Any
    y: Any
    z: Any


class KalmanState(NamedTuple):
    """State of the filter.

    Attributes:
        estimate: of the instant of the last update.
        begun: 0 before the first frame, then 1.
        seen: the last x that was measured: a frame in which it is the same to the bit was lost.
    """

    estimate: Estimate
    begun: Number
    seen: PositionW


class ChainCommands(NamedTuple):
    """Commands of the three chains: m/s⁴ along X and Y with torques over the link, m/s² otherwise."""

    x: Row
    y: Row
    z: Row


class Sent(NamedTuple):
    """What has been sent.

    Attributes:
        commands: the oldest, which acts until the next tick, first.
        deviations: of those that are still under way, the oldest first.
        upward: f̄ at the last tick, m/s².
        snap: of the reference at the last tick; None with an autopilot.
    """

    commands: tuple[ChainCommands, ...]
    deviations: tuple[ChainCommands, ...]
    upward: Row
    snap: Snap | None

    @classmethod
    def hovering(cls, numbers: LqgNumbers) -> "Sent":
        """What has been sent to a vehicle that hovers."""
        nothing = ChainCommands(0.0, 0.0, 0.0)
        under_way = (nothing,) * len(numbers.lateral.K_pending)
        snap = None if numbers.torques is None else Snap(0.0, 0.0, 0.0, 0.0)
        return cls((*under_way, nothing), under_way, numbers.thrust.gravity, snap)


class Deviations(NamedTuple):
    """What the regulator feeds back.

    Attributes:
        x: deviation of the chain along X from the reference, then those of the commands under way, the oldest first.
        y: the same along Y.
        z: along Z.
        correction: acceleration that is subtracted from the reference's.
    """

    x: tuple[Row, ...]
    y: tuple[Row, ...]
    z: tuple[Row, ...]
    correction: Acceleration


class Regulated(NamedTuple):
    """What the regulator asks for.

    Attributes:
        command: u.
        deviation: δu.
        acceleration: the same, as an outer loop would.
        upward: f̄, m/s².
    """

    command: ChainCommands
    deviation: ChainCommands
    acceleration: Acceleration
    upward: Row


def estimated(
    measurement: State,
    before: KalmanState,
    sent: Sent,
    known: Acceleration | None,
    numbers: LqgNumbers,
    period: float,
    loses_frames: bool,
) -> Estimate:
    """The estimate of now, from that of a frame before.

    Args:
        measurement: the frame that can be read, taken a period before.
        before: state of the filter.
        sent: commands.
        known: part of the disturbing acceleration, which the filter need not find; None if there is none.
        numbers: of the controller.
        period: h of the frames, s.
        loses_frames: whether a frame that is like the last one is lost.
    """
    last, (u_x, u_y, u_z) = before.estimate, next(iter(sent.commands))
    s_x, s_y = _level_thrust(measurement, sent.upward)
    fresh = True if not loses_frames else measurement.x != before.seen
    lateral, vertical = numbers.lateral, numbers.vertical
    x = _filtered(last.x, (measurement.x - last.x.position, s_x - last.x.thrust), fresh, u_x, lateral)
    y = _filtered(last.y, (measurement.y - last.y.position, s_y - last.y.thrust), fresh, u_y, lateral)
    z = _filtered(last.z, (measurement.z - last.z.position,), fresh, u_z, vertical)
    # What the thrust of the frame before has more than f̄ acted since, along the attitude.
    rest = (numbers.thrust.gravity + last.z.thrust) / sent.upward - 1.0
    after = Estimate(_pushed(x, rest * last.x.thrust, period), _pushed(y, rest * last.y.thrust, period), z)
    if known is not None:
        pushed = zip(after, known, strict=True)
        after = Estimate._make(_pushed(chain, acceleration, period) for chain, acceleration in pushed)
    return where(before.begun != 0.0, after, _at_rest(measurement, after))


def filter_after(measurement: State, *remembered: Any) -> KalmanState:
    """Return the state of the filter after a frame; arguments are those of `estimated`."""
    return KalmanState(estimated(measurement, *remembered), 1.0, measurement.x)


def regulated(
    estimate: Estimate,
    reference: Reference,
    jerk: Jerk,
    snap: Snap,
    sent: Sent,
    correction: Acceleration | None,
    perturbation: ChainCommands | None,
    numbers: LqgNumbers,
    tick: float,
) -> Regulated:
    """What the regulator asks for.

    Args:
        estimate: of now.
        reference: to follow.
        jerk: of the reference.
        snap: of the reference.
        sent: commands.
        correction: acceleration that is subtracted; None for none.
        perturbation: added to the commands so that they keep to the tilt; None if they are shortened to it.
        numbers: of the controller; without `torques` the horizontal command is an acceleration.
        tick: period of the control, s.
    """
    wanted = wanted_of(reference, correction)
    e = deviations(estimate, reference, wanted, jerk, snap)
    lateral, vertical, limits = numbers.lateral, numbers.vertical, numbers.thrust
    forward = fed_forward(wanted, jerk, snap, sent.snap, numbers, tick)
    loops = lateral, lateral, vertical
    fed_back = [_fed_back(*axis) for axis in zip(e, pending_of(sent), loops, strict=True)]
    asked = [ahead - back for ahead, back in zip(forward, fed_back, strict=True)]
    if perturbation is not None:
        asked = [command + more for command, more in zip(asked, perturbation, strict=True)]
    u_x, u_y, u_z = asked
    u_z = _held_up(u_z, limits)
    if numbers.torques is not None:
        most = numbers.torques.max_snap
        asked_x, asked_y = wanted.x - _outer(e.x, lateral), wanted.y - _outer(e.y, lateral)
        if perturbation is None:
            a_x, a_y = _shortened(asked_x, asked_y, limits)
            u_x, u_y = u_x - lateral.outer * (asked_x - a_x), u_y - lateral.outer * (asked_y - a_y)
        else:
            a_x, a_y = asked_x + perturbation.x / lateral.outer, asked_y + perturbation.y / lateral.outer
        u_x, u_y = minimum(maximum(u_x, -most), most), minimum(maximum(u_y, -most), most)
    else:
        a_x, a_y = u_x, u_y = _shortened(u_x, u_y, limits)
    return Regulated(
        ChainCommands(u_x, u_y, u_z),
        ChainCommands(u_x - forward.x, u_y - forward.y, u_z - forward.z),
        Acceleration(a_x, a_y, u_z),
        limits.gravity + _held_up(wanted.z - disturbance_of(estimate).z, limits),
    )


def fed_forward(
    wanted: Acceleration, jerk: Jerk, snap: Snap, before: Snap | None, numbers: LqgNumbers, tick: float
) -> ChainCommands:
    """The commands u_ff that follow from the reference alone.

    Args:
        wanted: its acceleration, less what is subtracted from it.
        jerk: of the reference.
        snap: of the reference.
        before: the same at the last tick; None with an autopilot.
        numbers: of the controller.
        tick: period of the control, s.
    """
    z = wanted.z + numbers.thrust.lead * jerk.z
    if numbers.torques is not None and before is not None:
        ticks = numbers.torques.lead / tick
        return ChainCommands(snap.x + ticks * (snap.x - before.x), snap.y + ticks * (snap.y - before.y), z)
    assert numbers.target is not None
    lead = numbers.target
    return ChainCommands(
        wanted.x + lead.jerk * jerk.x + lead.snap * snap.x, wanted.y + lead.jerk * jerk.y + lead.snap * snap.y, z
    )


def wrench_for(
    asked: Regulated,
    estimate: Estimate,
    measurement: State,
    reference: Reference,
    jerk: Jerk,
    snap: Snap,
    numbers: LqgNumbers,
) -> Wrench:
    """Thrust and torques that give the vehicle a commanded snap, by flatness at the attitude that it has.

    The yaw has a PD of its own, which the noise of the estimated jerk does not reach.

    Args:
        asked: of the chains.
        estimate: of now.
        measurement: which has the attitude.
        reference: which has the yaw.
        jerk: of the reference; along X and Y the estimate's counts.
        snap: of the reference; along X and Y the command counts.
        numbers: of the controller.
    """
    torques = numbers.torques
    assert torques is not None
    sin_yaw, cos_yaw = sin_cos(measurement.yaw)
    (sin_roll, cos_roll), (sin_pitch, cos_pitch) = sin_cos(measurement.roll), sin_cos(measurement.pitch)
    tilt = ThrustTilt(_length(estimate, asked.upward), sin_roll, cos_roll, sin_pitch, cos_pitch)
    turned_jerk = in_heading(Jerk(estimate.x.jerk, estimate.y.jerk, jerk.z), sin_yaw, cos_yaw)
    turned_snap = in_heading(Jerk(asked.command.x, asked.command.y, snap.z), sin_yaw, cos_yaw)
    rates = body_rates(tilt, turned_jerk, reference.yaw_rate)
    turning = angular_accelerations(tilt, rates, turned_jerk, turned_snap, reference.yaw_rate, snap.yaw)
    yaw = torques.yaw_k_p * wrap_angle(reference.yaw - measurement.yaw)
    yaw = yaw + torques.yaw_k_d * (reference.yaw_rate - measurement.r)
    return Wrench(
        _thrust(asked, estimate, numbers.thrust),
        torques.i_xx * turning.p,
        torques.i_yy * turning.q,
        torques.i_zz * (yaw + snap.yaw),
    )


def target_for(
    asked: Regulated, estimate: Estimate, measurement: State, reference: Reference, numbers: LqgNumbers
) -> AttitudeTarget:
    """Thrust and attitude that give the vehicle a commanded acceleration; arguments as of `wrench_for`.

    Roll and pitch rates are none: what they would feed forward is in the command.
    """
    sin_yaw, cos_yaw = sin_cos(measurement.yaw)
    level = in_heading(Acceleration(asked.command.x, asked.command.y, 0.0), sin_yaw, cos_yaw)
    roll, pitch = attitude_of(tilt_of(level._replace(up=asked.upward)))
    thrust = _thrust(asked, estimate, numbers.thrust)
    return AttitudeTarget(thrust, roll, pitch, reference.yaw, 0.0, 0.0, reference.yaw_rate)


def deviations(estimate: Estimate, reference: Reference, wanted: Acceleration, jerk: Jerk, snap: Snap) -> Estimate:
    """The chains' deviations from the reference; of disturbances there is none.

    Args:
        estimate: of now.
        reference: to follow.
        wanted: its acceleration, less what is subtracted from it.
        jerk: of the reference.
        snap: of the reference.
    """
    return Estimate(
        _deviation(estimate.x, reference.x, reference.v_x, wanted.x, jerk.x, snap.x),
        _deviation(estimate.y, reference.y, reference.v_y, wanted.y, jerk.y, snap.y),
        _deviation(estimate.z, reference.z, reference.v_z, wanted.z, jerk.z, snap.z),
    )


def pending_of(sent: Sent) -> list[tuple[Row, ...]]:
    """The deviations of the commands that are under way along X, Y and Z, the oldest first."""
    return [tuple([getattr(du, axis) for du in sent.deviations]) for axis in ChainCommands._fields]


def fed_back_of(
    estimate: Estimate, reference: Reference, jerk: Jerk, snap: Snap, sent: Sent, correction: Acceleration | None
) -> Deviations:
    """What the regulator feeds back; arguments as of `regulated`."""
    e = deviations(estimate, reference, wanted_of(reference, correction), jerk, snap)
    x, y, z = ((*chain, *pending) for chain, pending in zip(e, pending_of(sent), strict=True))
    return Deviations(x, y, z, Acceleration(0.0, 0.0, 0.0) if correction is None else correction)


def sent_after(asked: Regulated, snap: Snap, sent: Sent) -> Sent:
    """What has been sent after a tick."""
    _, *commands = (*sent.commands, asked.command)
    _, *under_way = (*sent.deviations, asked.deviation)
    return Sent(tuple(commands), tuple(under_way), asked.upward, None if sent.snap is None else snap)


def error_of(estimate: Estimate, reference: Reference) -> PositionError:
    """Reference minus estimated position."""
    x, y, z = estimate
    return PositionError(reference.x - x.position, reference.y - y.position, reference.z - z.position)


def error_rate_of(estimate: Estimate, reference: Reference) -> PositionErrorRate:
    """Reference minus estimated velocity."""
    x, y, z = estimate
    return PositionErrorRate(reference.v_x - x.velocity, reference.v_y - y.velocity, reference.v_z - z.velocity)


def outer_feedback(error: PositionError, rate: PositionErrorRate, numbers: LqgNumbers) -> Acceleration:
    """What the regulator makes of position and velocity, as an outer loop would: (K_p e + K_v ė) / k."""
    loops = numbers.lateral, numbers.lateral, numbers.vertical
    return Acceleration._make(
        (loop.K.position * e + loop.K.velocity * v) / loop.outer for loop, e, v in zip(loops, error, rate, strict=True)
    )


def disturbance_of(estimate: Estimate) -> Acceleration:
    """The disturbing acceleration d̂₁ + d̂₂."""
    return Acceleration._make(chain.first + chain.second for chain in estimate)


def wanted_of(reference: Reference, correction: Acceleration | None) -> Acceleration:
    """The reference's acceleration, less a correction."""
    a_x, a_y, a_z = reference.a_x, reference.a_y, reference.a_z
    if correction is None:
        return Acceleration(a_x, a_y, a_z)
    return Acceleration(a_x - correction.x, a_y - correction.y, a_z - correction.z)


def _deviation(chain: Any, *motion: Row) -> Any:
    """A chain less position, velocity, acceleration, jerk and snap, as far as it has them."""
    target = dict(zip(("position", "velocity", "thrust", "jerk", "snap"), motion, strict=True))
    return chain._replace(**{name: row - target[name] for name, row in chain._asdict().items() if name in target})


def _filtered(chain: Any, innovation: Sequence[Row], fresh: bool, u: Row, loop: AxisLoop) -> Any:
    """A chain a frame later, given how far what is measured is from it."""
    told = [where(fresh, row, 0.0) for row in innovation]
    corrected = [row + dot(gains, told) for row, *gains in zip(chain, *loop.L, strict=True)]
    return chain._make(dot(row, corrected) + gain * u for row, gain in zip(loop.A, loop.B, strict=True))


def _pushed(chain: Any, acceleration: Row, period: float) -> Any:
    """A chain with what an acceleration has done to it during a period (s)."""
    velocity = period * acceleration
    return chain._replace(position=chain.position + 0.5 * period * velocity, velocity=chain.velocity + velocity)


def _at_rest(measurement: State, like: Estimate) -> Estimate:
    """Chains at rest where the vehicle is seen."""
    places = measurement.x, measurement.y, measurement.z
    chains = (chain._make([0.0] * len(chain)) for chain in like)
    return Estimate._make(chain._replace(position=place) for chain, place in zip(chains, places, strict=True))


def _level_thrust(measurement: State, upward: Row) -> tuple[Row, Row]:
    """The specific thrust along X and Y of a body that has its attitude, given that along Z (m/s²)."""
    (sin_roll, cos_roll), (sin_pitch, cos_pitch) = sin_cos(measurement.roll), sin_cos(measurement.pitch)
    sin_yaw, cos_yaw = sin_cos(measurement.yaw)
    forward = upward * sin_pitch / cos_pitch
    left = -upward * sin_roll / (cos_roll * cos_pitch)
    return forward * cos_yaw - left * sin_yaw, forward * sin_yaw + left * cos_yaw


def _fed_back(e: Any, pending: Sequence[Row], loop: AxisLoop) -> Row:
    """K [e; δu]."""
    return dot((*loop.K, *loop.K_pending), (*e, *pending))


def _outer(e: Any, loop: AxisLoop) -> Row:
    """The outer part of K e, as an acceleration."""
    names = "position", "velocity", "first", "second", "second_rate"
    return dot([getattr(loop.K, name) for name in names], [getattr(e, name) for name in names]) / loop.outer


def _shortened(x: Row, y: Row, limits: ThrustNumbers) -> tuple[Row, Row]:
    """A horizontal acceleration, shortened in its direction to what the tilt allows."""
    most = limits.gravity * limits.slope
    reach = most * most
    share = sqrt(reach / maximum(x * x + y * y, reach))
    return share * x, share * y


def _length(estimate: Estimate, upward: Row) -> Row:
    s_x, s_y = estimate.x.thrust, estimate.y.thrust
    return sqrt(s_x * s_x + s_y * s_y + upward * upward)


def _held_up(acceleration: Row, numbers: ThrustNumbers) -> Row:
    """A vertical acceleration within what the limits of the thrust allow."""
    low, high = (thrust / numbers.mass - numbers.gravity for thrust in (numbers.min_thrust, numbers.max_thrust))
    return minimum(maximum(acceleration, low), high)


def _thrust(asked: Regulated, estimate: Estimate, numbers: ThrustNumbers) -> Row:
    """The thrust (N) whose vertical part is what is commanded at the tilt that the vehicle has."""
    share = (numbers.gravity + asked.command.z) / asked.upward
    return minimum(numbers.mass * share * _length(estimate, asked.upward), numbers.max_thrust)
