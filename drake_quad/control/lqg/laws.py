"""Equations of a linear-quadratic-Gaussian controller: the filter, the regulator, and the commands to the vehicle.

The frame that is available at time t was taken at t - h. With the estimate x̂ at t - h, and the command u that has
acted since then,

    x̂(t) = A (x̂ + L (y - C x̂)) + B u

At every tick, e is the deviation of x̂ from the reference, and δu are the deviations of the commands in transit from
their feed-forward:

    u = u_ff - K [e; δu]        δu = u - u_ff

The gains of K on position, velocity and disturbances form an outer loop, which commands the acceleration
a_r - (K_p e_p + K_v e_v + K_d d̂) / k, with k from `axis_loop`.

A tilted vehicle has the horizontal specific thrust s = f tan θ along X, where f is the vertical specific thrust. Noise
and gusts change f faster than the attitude can follow. The chains along X and Y therefore use s̄ = f̄ tan θ with

    f̄ = g + a_r - d̂₁ - d̂₂    along Z.

f̄ is the vertical specific thrust that keeps the vehicle on the reference. It changes only as fast as the reference and
the estimated disturbance. The known difference s - s̄ = s̄ (f - f̄) / f̄ acts without delay and is added to the
velocity. With f instead of f̄, thrust variations of a tilted vehicle would appear as variations of its attitude.
"""

from collections.abc import Sequence
from typing import Annotated, Any, NamedTuple

from drake_quad.control.lqg.design import AxisLoop
from drake_quad.framework.elementary import dot, maximum, minimum, sin_cos, sqrt, where, wrap_angle
from drake_quad.geometry.flatness import (
    ThrustTilt,
    angular_accelerations,
    attitude_from_tilt,
    body_rates,
    in_heading,
    tilt_from_thrust,
)
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


class TorqueParameters(NamedTuple):
    """Parameters for torques that are sent over the radio link.

    Attributes:
        i_xx: moment of inertia of the nominal vehicle about x_B, kg m².
        i_yy: moment of inertia of the nominal vehicle about y_B, kg m².
        i_zz: moment of inertia of the nominal vehicle about z_B, kg m².
        yaw_k_p: gain of the yaw PD law on the yaw error, 1/s².
        yaw_k_d: gain of the yaw PD law on the rate of the yaw error, 1/s.
        max_snap: largest snap command along X and along Y, m/s⁴.
        lead: lead time of the snap feed-forward, s.
    """

    i_xx: Row
    i_yy: Row
    i_zz: Row
    yaw_k_p: Row
    yaw_k_d: Row
    max_snap: SnapW
    lead: Time


class TargetParameters(NamedTuple):
    """Feed-forward gains from jerk and snap to an attitude target.

    Attributes:
        jerk: gain on the jerk, s.
        snap: gain on the snap, s².
    """

    jerk: Row
    snap: Row


class ThrustParameters(NamedTuple):
    """Parameters of the nominal vehicle, and limits.

    Attributes:
        mass: mass, kg.
        gravity: gravitational acceleration g, m/s².
        tan_max_tilt: tangent of the largest angle between thrust and vertical.
        min_thrust: smallest vertical thrust, N.
        max_thrust: largest thrust, N.
        lead: lead time of the vertical jerk feed-forward, s.
    """

    mass: Annotated[Row, Quantity("kg")]
    gravity: Annotated[Row, Quantity("m/s²")]
    tan_max_tilt: Number
    min_thrust: ForceB
    max_thrust: ForceB
    lead: Time


class LqgParameters(NamedTuple):
    """Parameters of a `LinearQuadraticGaussian`.

    Attributes:
        lateral: loop along X and along Y.
        vertical: loop along Z.
        thrust: limits, and parameters of the nominal vehicle.
        torques: parameters of control by torques; None with an autopilot.
        target: feed-forward to an attitude target; None without an autopilot.
    """

    lateral: AxisLoop
    vertical: AxisLoop
    thrust: ThrustParameters
    torques: TorqueParameters | None
    target: TargetParameters | None


class Estimate(NamedTuple):
    """Estimated state: a chain of `drake_quad.control.lqg.chains` for each axis."""

    x: Any
    y: Any
    z: Any


class KalmanState(NamedTuple):
    """State of the filter.

    Attributes:
        estimate: estimate at the last update.
        has_started: 0 before the first frame, 1 after it.
        last_x: last measured x. If a frame contains exactly this x, the frame was lost.
    """

    estimate: Estimate
    has_started: Number
    last_x: PositionW


class ChainCommands(NamedTuple):
    """Commands of the three chains: m/s⁴ along X and Y if torques are sent, m/s² otherwise."""

    x: Row
    y: Row
    z: Row


class SentCommands(NamedTuple):
    """Commands that the regulator has sent at earlier ticks, some of which may be in transit.

    Attributes:
        commands: commands, the oldest first; the oldest command acts until the next tick.
        deviations: deviations δu of the commands in transit, the oldest first.
        upward: vertical specific thrust f̄ at the last tick, m/s².
        snap: snap of the reference at the last tick; None with an autopilot.
    """

    commands: tuple[ChainCommands, ...]
    deviations: tuple[ChainCommands, ...]
    upward: Row
    snap: Snap | None

    @classmethod
    def hovering(cls, parameters: LqgParameters) -> "SentCommands":
        """Return the commands that have been sent to a hovering vehicle."""
        zero = ChainCommands(0.0, 0.0, 0.0)
        in_transit = (zero,) * len(parameters.lateral.K_pending)
        snap = None if parameters.torques is None else Snap(0.0, 0.0, 0.0, 0.0)
        return cls((*in_transit, zero), in_transit, parameters.thrust.gravity, snap)


class Deviations(NamedTuple):
    """Deviations that the regulator feeds back.

    Attributes:
        x: deviation of the chain along X from the reference, followed by δu of the commands in transit, oldest first.
        y: the same along Y.
        z: the same along Z.
        correction: acceleration that is subtracted from the acceleration of the reference.
    """

    x: tuple[Row, ...]
    y: tuple[Row, ...]
    z: tuple[Row, ...]
    correction: Acceleration


class RegulatorOutput(NamedTuple):
    """Output of the regulator at a tick.

    Attributes:
        command: command u.
        deviation: deviation δu of the command from its feed-forward.
        acceleration: commanded acceleration. If torques are sent, its horizontal part is that of the outer loop.
        upward: vertical specific thrust f̄, m/s².
    """

    command: ChainCommands
    deviation: ChainCommands
    acceleration: Acceleration
    upward: Row


def estimator_step(
    measurement: State,
    before: KalmanState,
    sent: SentCommands,
    known_disturbance: Acceleration | None,
    parameters: LqgParameters,
    period: float,
    loses_frames: bool,
) -> Estimate:
    """Return the current estimate, given the estimate at the previous frame.

    Args:
        measurement: last available frame, taken one period ago.
        before: state of the filter.
        sent: commands that were sent at earlier ticks.
        known_disturbance: known part of the disturbing acceleration; None if no part is known.
        parameters: parameters of the controller.
        period: frame period h, s.
        loses_frames: True if a frame whose x equals the previous x counts as lost.
    """
    last, (u_x, u_y, u_z) = before.estimate, next(iter(sent.commands))
    s_x, s_y = _level_thrust(measurement, sent.upward)
    is_new_frame = True if not loses_frames else measurement.x != before.last_x
    lateral, vertical = parameters.lateral, parameters.vertical
    x = _filtered(last.x, (measurement.x - last.x.position, s_x - last.x.thrust), is_new_frame, u_x, lateral)
    y = _filtered(last.y, (measurement.y - last.y.position, s_y - last.y.thrust), is_new_frame, u_y, lateral)
    z = _filtered(last.z, (measurement.z - last.z.position,), is_new_frame, u_z, vertical)
    # The chains along X and Y are based on f̄ instead of the vertical specific thrust. The horizontal acceleration due
    # to the difference is added here.
    excess = (parameters.thrust.gravity + last.z.thrust) / sent.upward - 1.0
    after = Estimate(
        _accelerated(x, excess * last.x.thrust, period), _accelerated(y, excess * last.y.thrust, period), z
    )
    if known_disturbance is not None:
        chains = zip(after, known_disturbance, strict=True)
        after = Estimate._make(_accelerated(chain, acceleration, period) for chain, acceleration in chains)
    return where(before.has_started != 0.0, after, _at_rest(measurement, after))


def filter_step(measurement: State, *remembered: Any) -> KalmanState:
    """Return the state of the filter after a frame; the arguments are as in `estimator_step`."""
    return KalmanState(estimator_step(measurement, *remembered), 1.0, measurement.x)


def regulator_output(
    estimate: Estimate,
    reference: Reference,
    jerk: Jerk,
    snap: Snap,
    sent: SentCommands,
    correction: Acceleration | None,
    perturbation: ChainCommands | None,
    parameters: LqgParameters,
    tick: float,
) -> RegulatorOutput:
    """Return the output of the regulator at a tick.

    Args:
        estimate: current estimate.
        reference: reference.
        jerk: jerk of the reference.
        snap: snap of the reference.
        sent: commands that were sent at earlier ticks.
        correction: acceleration that is subtracted; None without a correction.
        perturbation: addition to the commands, which keeps the tilt within its limit; None to saturate the commands at
            this limit instead.
        parameters: parameters of the controller. If `torques` is None, the horizontal command is an acceleration.
        tick: control period, s.
    """
    acceleration = corrected_acceleration(reference, correction)
    e = deviations(estimate, reference, acceleration, jerk, snap)
    lateral, vertical, limits = parameters.lateral, parameters.vertical, parameters.thrust
    feed_forward = feed_forward_commands(acceleration, jerk, snap, sent.snap, parameters, tick)
    loops = lateral, lateral, vertical
    feedback = [_feedback(*axis) for axis in zip(e, pending_deviations(sent), loops, strict=True)]
    commands = [
        forward_command - feedback_command
        for forward_command, feedback_command in zip(feed_forward, feedback, strict=True)
    ]
    if perturbation is not None:
        commands = [command + addition for command, addition in zip(commands, perturbation, strict=True)]
    u_x, u_y, u_z = commands
    u_z = _limited_vertical(u_z, limits)
    if parameters.torques is not None:
        max_snap = parameters.torques.max_snap
        total_x, total_y = (
            acceleration.x - _outer_feedback(e.x, lateral),
            acceleration.y - _outer_feedback(e.y, lateral),
        )
        if perturbation is None:
            a_x, a_y = _limited_horizontal(total_x, total_y, limits)
            u_x, u_y = u_x - lateral.outer_divisor * (total_x - a_x), u_y - lateral.outer_divisor * (total_y - a_y)
        else:
            a_x, a_y = (
                total_x + perturbation.x / lateral.outer_divisor,
                total_y + perturbation.y / lateral.outer_divisor,
            )
        u_x, u_y = minimum(maximum(u_x, -max_snap), max_snap), minimum(maximum(u_y, -max_snap), max_snap)
    else:
        a_x, a_y = u_x, u_y = _limited_horizontal(u_x, u_y, limits)
    return RegulatorOutput(
        ChainCommands(u_x, u_y, u_z),
        ChainCommands(u_x - feed_forward.x, u_y - feed_forward.y, u_z - feed_forward.z),
        Acceleration(a_x, a_y, u_z),
        limits.gravity + _limited_vertical(acceleration.z - total_disturbance(estimate).z, limits),
    )


def feed_forward_commands(
    acceleration: Acceleration, jerk: Jerk, snap: Snap, before: Snap | None, parameters: LqgParameters, tick: float
) -> ChainCommands:
    """Return the feed-forward commands u_ff, which depend only on the reference and the correction.

    Args:
        acceleration: acceleration of the reference minus the correction.
        jerk: jerk of the reference.
        snap: snap of the reference.
        before: snap of the reference at the last tick; None with an autopilot.
        parameters: parameters of the controller.
        tick: control period, s.
    """
    z = acceleration.z + parameters.thrust.lead * jerk.z
    if parameters.torques is not None and before is not None:
        ticks = parameters.torques.lead / tick
        return ChainCommands(snap.x + ticks * (snap.x - before.x), snap.y + ticks * (snap.y - before.y), z)
    assert parameters.target is not None
    lead = parameters.target
    return ChainCommands(
        acceleration.x + lead.jerk * jerk.x + lead.snap * snap.x,
        acceleration.y + lead.jerk * jerk.y + lead.snap * snap.y,
        z,
    )


def wrench_from_snap(
    output: RegulatorOutput,
    estimate: Estimate,
    measurement: State,
    reference: Reference,
    jerk: Jerk,
    snap: Snap,
    parameters: LqgParameters,
) -> Wrench:
    """Return thrust and torques that produce a commanded snap, by differential flatness at the measured attitude.

    A separate PD controls the yaw, which is therefore not affected by the noise of the estimated jerk.

    Args:
        output: output of the regulator.
        estimate: current estimate.
        measurement: measured state of the vehicle, with the attitude.
        reference: reference, with the yaw.
        jerk: jerk of the reference; along X and Y the estimate is used instead.
        snap: snap of the reference; along X and Y the command is used instead.
        parameters: parameters of the controller.
    """
    torques = parameters.torques
    assert torques is not None
    sin_yaw, cos_yaw = sin_cos(measurement.yaw)
    (sin_roll, cos_roll), (sin_pitch, cos_pitch) = sin_cos(measurement.roll), sin_cos(measurement.pitch)
    tilt = ThrustTilt(_length(estimate, output.upward), sin_roll, cos_roll, sin_pitch, cos_pitch)
    heading_jerk = in_heading(Jerk(estimate.x.jerk, estimate.y.jerk, jerk.z), sin_yaw, cos_yaw)
    heading_snap = in_heading(Jerk(output.command.x, output.command.y, snap.z), sin_yaw, cos_yaw)
    rates = body_rates(tilt, heading_jerk, reference.yaw_rate)
    angular_acceleration = angular_accelerations(tilt, rates, heading_jerk, heading_snap, reference.yaw_rate, snap.yaw)
    yaw = torques.yaw_k_p * wrap_angle(reference.yaw - measurement.yaw)
    yaw = yaw + torques.yaw_k_d * (reference.yaw_rate - measurement.r)
    return Wrench(
        _thrust(output, estimate, parameters.thrust),
        torques.i_xx * angular_acceleration.p,
        torques.i_yy * angular_acceleration.q,
        torques.i_zz * (yaw + snap.yaw),
    )


def target_from_acceleration(
    output: RegulatorOutput, estimate: Estimate, measurement: State, reference: Reference, parameters: LqgParameters
) -> AttitudeTarget:
    """Return thrust and attitude that produce a commanded acceleration; the arguments are as in `wrench_from_snap`.

    Roll and pitch rates are zero, because the command already contains their feed-forward.
    """
    sin_yaw, cos_yaw = sin_cos(measurement.yaw)
    level = in_heading(Acceleration(output.command.x, output.command.y, 0.0), sin_yaw, cos_yaw)
    roll, pitch = attitude_from_tilt(tilt_from_thrust(level._replace(up=output.upward)))
    thrust = _thrust(output, estimate, parameters.thrust)
    return AttitudeTarget(thrust, roll, pitch, reference.yaw, 0.0, 0.0, reference.yaw_rate)


def deviations(
    estimate: Estimate, reference: Reference, acceleration: Acceleration, jerk: Jerk, snap: Snap
) -> Estimate:
    """Return the deviations of the chains from the reference.

    Disturbances have no reference, so their deviations are the estimated disturbances.

    Args:
        estimate: current estimate.
        reference: reference.
        acceleration: acceleration of the reference minus the correction.
        jerk: jerk of the reference.
        snap: snap of the reference.
    """
    return Estimate(
        _deviation(estimate.x, reference.x, reference.v_x, acceleration.x, jerk.x, snap.x),
        _deviation(estimate.y, reference.y, reference.v_y, acceleration.y, jerk.y, snap.y),
        _deviation(estimate.z, reference.z, reference.v_z, acceleration.z, jerk.z, snap.z),
    )


def pending_deviations(sent: SentCommands) -> list[tuple[Row, ...]]:
    """Return the deviations of the commands in transit along X, Y and Z, the oldest first."""
    return [tuple([getattr(du, axis) for du in sent.deviations]) for axis in ChainCommands._fields]


def feedback_deviations(
    estimate: Estimate,
    reference: Reference,
    jerk: Jerk,
    snap: Snap,
    sent: SentCommands,
    correction: Acceleration | None,
) -> Deviations:
    """Return the deviations that the regulator feeds back; the arguments are as in `regulator_output`."""
    e = deviations(estimate, reference, corrected_acceleration(reference, correction), jerk, snap)
    x, y, z = ((*chain, *pending) for chain, pending in zip(e, pending_deviations(sent), strict=True))
    return Deviations(x, y, z, Acceleration(0.0, 0.0, 0.0) if correction is None else correction)


def next_sent(output: RegulatorOutput, snap: Snap, sent: SentCommands) -> SentCommands:
    """Return the sent commands as of the next tick, including the output of this tick."""
    _, *commands = (*sent.commands, output.command)
    _, *in_transit = (*sent.deviations, output.deviation)
    return SentCommands(tuple(commands), tuple(in_transit), output.upward, None if sent.snap is None else snap)


def position_error(estimate: Estimate, reference: Reference) -> PositionError:
    """Return the position error in m: reference position minus estimated position."""
    x, y, z = estimate
    return PositionError(reference.x - x.position, reference.y - y.position, reference.z - z.position)


def position_error_rate(estimate: Estimate, reference: Reference) -> PositionErrorRate:
    """Return the rate of the position error: reference velocity minus estimated velocity."""
    x, y, z = estimate
    return PositionErrorRate(reference.v_x - x.velocity, reference.v_y - y.velocity, reference.v_z - z.velocity)


def outer_feedback(error: PositionError, rate: PositionErrorRate, parameters: LqgParameters) -> Acceleration:
    """Return the acceleration that the regulator commands for position and velocity errors.

    It is (K_p e + K_v ė) / k, where k is the gain of the loop on the acceleration, `outer_divisor`.
    """
    loops = parameters.lateral, parameters.lateral, parameters.vertical
    return Acceleration._make(
        (loop.K.position * e + loop.K.velocity * v) / loop.outer_divisor
        for loop, e, v in zip(loops, error, rate, strict=True)
    )


def total_disturbance(estimate: Estimate) -> Acceleration:
    """Return the estimated disturbing acceleration d̂₁ + d̂₂ along X, Y and Z, m/s²."""
    return Acceleration._make(chain.first + chain.second for chain in estimate)


def corrected_acceleration(reference: Reference, correction: Acceleration | None) -> Acceleration:
    """Return the reference acceleration minus a network's correction, if there is one."""
    a_x, a_y, a_z = reference.a_x, reference.a_y, reference.a_z
    if correction is None:
        return Acceleration(a_x, a_y, a_z)
    return Acceleration(a_x - correction.x, a_y - correction.y, a_z - correction.z)


def _deviation(chain: Any, *motion: Row) -> Any:
    """Subtract the reference's position, velocity, acceleration, jerk and snap from the states of a chain."""
    target = dict(zip(("position", "velocity", "thrust", "jerk", "snap"), motion, strict=True))
    return chain._replace(**{name: row - target[name] for name, row in chain._asdict().items() if name in target})


def _filtered(chain: Any, innovation: Sequence[Row], is_new_frame: bool, u: Row, loop: AxisLoop) -> Any:
    """Return the chain one frame later; the innovation is ignored if the frame was lost."""
    used_innovation = [where(is_new_frame, row, 0.0) for row in innovation]
    corrected = [row + dot(gains, used_innovation) for row, *gains in zip(chain, *loop.L, strict=True)]
    return chain._make(dot(row, corrected) + gain * u for row, gain in zip(loop.A, loop.B, strict=True))


def _accelerated(chain: Any, acceleration: Row, period: float) -> Any:
    """Return the state of a chain after an additional constant acceleration (m/s²) has acted for a period (s)."""
    velocity = period * acceleration
    return chain._replace(position=chain.position + 0.5 * period * velocity, velocity=chain.velocity + velocity)


def _at_rest(measurement: State, template: Estimate) -> Estimate:
    """Return the state of chains at rest at the measured position."""
    positions = measurement.x, measurement.y, measurement.z
    chains = (chain._make([0.0] * len(chain)) for chain in template)
    return Estimate._make(chain._replace(position=position) for chain, position in zip(chains, positions, strict=True))


def _level_thrust(measurement: State, upward: Row) -> tuple[Row, Row]:
    """Return the specific thrust along X and Y for the measured attitude and a specific thrust along Z (m/s²)."""
    (sin_roll, cos_roll), (sin_pitch, cos_pitch) = sin_cos(measurement.roll), sin_cos(measurement.pitch)
    sin_yaw, cos_yaw = sin_cos(measurement.yaw)
    forward = upward * sin_pitch / cos_pitch
    left = -upward * sin_roll / (cos_roll * cos_pitch)
    return forward * cos_yaw - left * sin_yaw, forward * sin_yaw + left * cos_yaw


def _feedback(e: Any, pending: Sequence[Row], loop: AxisLoop) -> Row:
    """Return the feedback K [e; δu] of a chain, given its deviation e and the deviations δu of its pending commands."""
    return dot((*loop.K, *loop.K_pending), (*e, *pending))


def _outer_feedback(e: Any, loop: AxisLoop) -> Row:
    """Return the outer loop's acceleration: the part of K e for position, velocity and disturbances, divided by k."""
    names = "position", "velocity", "first", "second", "second_rate"
    return dot([getattr(loop.K, name) for name in names], [getattr(e, name) for name in names]) / loop.outer_divisor


def _limited_horizontal(x: Row, y: Row, limits: ThrustParameters) -> tuple[Row, Row]:
    """Return a horizontal acceleration, saturated at the tilt limit without changing its direction."""
    max_horizontal = limits.gravity * limits.tan_max_tilt
    max_squared = max_horizontal * max_horizontal
    fraction = sqrt(max_squared / maximum(x * x + y * y, max_squared))
    return fraction * x, fraction * y


def _length(estimate: Estimate, upward: Row) -> Row:
    s_x, s_y = estimate.x.thrust, estimate.y.thrust
    return sqrt(s_x * s_x + s_y * s_y + upward * upward)


def _limited_vertical(acceleration: Row, parameters: ThrustParameters) -> Row:
    """Return a vertical acceleration, saturated at the limits of the thrust."""
    low, high = (
        thrust / parameters.mass - parameters.gravity for thrust in (parameters.min_thrust, parameters.max_thrust)
    )
    return minimum(maximum(acceleration, low), high)


def _thrust(output: RegulatorOutput, estimate: Estimate, parameters: ThrustParameters) -> Row:
    """Return the thrust (N) whose vertical component at the estimated tilt is the commanded vertical thrust."""
    fraction = (parameters.gravity + output.command.z) / output.upward
    return minimum(parameters.mass * fraction * _length(estimate, output.upward), parameters.max_thrust)
