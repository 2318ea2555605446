"""Motion capture: measurements of the vehicles' states at the ground station.

Equation numbers refer to Kayacan and Maslim (2016).

The cameras take a frame at an initialization event and at every multiple of the period. Other discrete updates at the
instant of a frame still use the previous frame. A simulator that continues a flight must suppress initialization
events, which reset the filters. In the diagram, ○ is the previous frame and ● is the new one:

    frame  ●━━━━━━━━━━○●━━━━━━━━━━○
           0          h            2h
"""

from typing import Annotated, NamedTuple

from pydrake.common import RandomDistribution

from drake_quad.framework.elementary import exp, identity, lazy_where, sqrt, where
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.framework.records import layout_of
from drake_quad.geometry.axes import BodyAxes, Tilt
from drake_quad.geometry.kinematics import small_rotation
from drake_quad.geometry.quaternion import Quaternion
from drake_quad.laboratory.delay_line import declare_delay_line, delay_line_step, latest_sample
from drake_quad.signals import Angle, Attitude, BodyRates, Number, PositionW, Quantity, Row, State, Valid

# Largest change of an angle over two frames for which eq (2) of the paper is used, rad; it corresponds to 2.5 rad/s at
# 100 Hz. The error of eq (2) is of third order in the changes. If the changes over the two frames are unequal, as near
# a pitch of 90°, the error is of second order.
_MAX_ANGLE_CHANGE = 0.05


class VelocityError(NamedTuple):
    """Relative scale error of the measured velocity along X, Y and Z of W; positive if the measurement is too large."""

    x: Number
    y: Number
    z: Number


class VelocityDrift(NamedTuple):
    """Slowly varying error of the measured velocity along X, Y and Z of W, or a standard normal sample for each."""

    x: Annotated[Row, Quantity("m/s", "W")]
    y: Annotated[Row, Quantity("m/s", "W")]
    z: Annotated[Row, Quantity("m/s", "W")]


class CameraParameters(NamedTuple):
    """Errors of the cameras.

    Attributes:
        position_noise: standard deviation of the position noise on each axis.
        attitude_noise: standard deviation of the noise on roll, pitch and yaw.
        dropout_rate: probability that a frame is lost.
        misalignment: roll, pitch and yaw of the markers' frame M relative to B.
        derivative_bandwidth: bandwidth ω of the filter that estimates velocity and body rates; None without a filter.
        latency_frames: latency, a whole number of frame periods.
        velocity_error: relative scale error of the measured velocity on each axis.
        velocity_drift: standard deviation of the velocity drift on each axis.
        drift_time: correlation time of the drift.
    """

    position_noise: Annotated[Row, Quantity("m")] = 0.0
    attitude_noise: Angle = 0.0
    dropout_rate: Number = 0.0
    misalignment: Attitude = Attitude(0.0, 0.0, 0.0)
    derivative_bandwidth: Annotated[Row, Quantity("rad/s")] | None = None
    latency_frames: Number = 0.0
    velocity_error: VelocityError = VelocityError(0.0, 0.0, 0.0)
    velocity_drift: VelocityDrift = VelocityDrift(0.0, 0.0, 0.0)
    drift_time: Annotated[Row, Quantity("s")] = 1.0


class Cameras(NamedTuple):
    """Parameters of the cameras, as they are stored in Drake's context.

    Attributes:
        errors: errors of the cameras.
        R_BM: orientation of the markers' frame in B, from the misalignment.
    """

    errors: CameraParameters
    R_BM: BodyAxes

    @classmethod
    def of(cls, parameters: CameraParameters) -> "Cameras":
        """Return the parameters of cameras with given errors."""
        return cls(parameters, BodyAxes.of(*parameters.misalignment))


class Pose(NamedTuple):
    """Position and attitude, or a standard normal sample for the noise of each."""

    x: PositionW
    y: PositionW
    z: PositionW
    roll: Angle
    pitch: Angle
    yaw: Angle

    @classmethod
    def of(cls, state: State) -> "Pose":
        """Return the pose of a state."""
        return cls(state.x, state.y, state.z, state.roll, state.pitch, state.yaw)


class Dropout(NamedTuple):
    """Uniform random number in [0, 1) for a frame, which is lost if the number is below the dropout rate."""

    frame: Number


def attitude_of_markers(attitude: Attitude, R_BM: BodyAxes) -> Attitude:
    """Return roll, pitch and yaw of the markers' frame M in W, the angles of the rotation R_WB R_BM.

    Args:
        attitude: roll, pitch and yaw of B in W.
        R_BM: orientation of the markers' frame in B.
    """
    tilt = Tilt.of(attitude.roll, attitude.pitch)
    angles = BodyAxes._make(tilt.in_heading(axis) for axis in R_BM).angles()
    return angles._replace(yaw=attitude.yaw + angles.yaw)


def measured_pose(state: State, noise: Pose | None, cameras: Cameras, misaligned: bool) -> Pose:
    """Return the position and attitude that the cameras measure, with misalignment and noise."""
    x, y, z, roll, pitch, yaw = Pose.of(state)
    if misaligned:
        roll, pitch, yaw = attitude_of_markers(Attitude(roll, pitch, yaw), cameras.R_BM)
    if noise is None:
        return Pose(x, y, z, roll, pitch, yaw)
    deviations = *[cameras.errors.position_noise] * 3, *[cameras.errors.attitude_noise] * 3
    true = x, y, z, roll, pitch, yaw
    return Pose._make(
        value + deviation * number for value, deviation, number in zip(true, deviations, noise, strict=True)
    )


def first_frame(
    state: State,
    noise: Pose | None,
    cameras: Cameras,
    misaligned: bool,
    velocity_scaled: bool,
    filtered: bool,
    max_delay_frames: int,
) -> tuple[State, tuple[State, ...], Pose, VelocityDrift]:
    """Return the initial states of a `MotionCapture`; the initial output of a filter is zero.

    Args:
        state: true state of the vehicle.
        noise: standard normal samples; None if there is no noise.
        cameras: parameters of the cameras.
        misaligned: True if the markers' frame differs from B.
        velocity_scaled: True if the velocity has a scale error.
        filtered: True if filters estimate velocity and body rates.
        max_delay_frames: largest possible latency, in frames.
    """
    pose = measured_pose(state, noise, cameras, misaligned)
    frame = (
        State(*pose, *(0.0,) * 6)
        if filtered
        else _unfiltered_frame(pose, state, _velocity_factors(cameras, velocity_scaled))
    )
    return frame, (frame,) * max_delay_frames, pose, VelocityDrift(0.0, 0.0, 0.0)


def next_frame(
    state: State,
    out: State,
    in_transit: tuple[State, ...],
    before: Pose | None,
    drift: VelocityDrift | None,
    noise: Pose | None,
    random: Dropout | None,
    drift_noise: VelocityDrift | None,
    cameras: Cameras,
    misaligned: bool,
    velocity_scaled: bool,
    period: float,
) -> tuple[State, tuple[State, ...], Pose, VelocityDrift | None]:
    """Return the states of a `MotionCapture` after a frame.

    Args:
        state: true state of the vehicle.
        out: frame that the output contained before the update.
        in_transit: earlier frames that are not yet available, latest frame first.
        before: pose two frames before this one; None without a filter.
        drift: velocity drift in the previous frame; None if there is no drift.
        noise: standard normal samples; None if there is no noise.
        random: random number of the frame; None if no frame can be lost.
        drift_noise: standard normal samples for the drift; None if there is no drift.
        cameras: parameters of the cameras.
        misaligned: True if the markers' frame differs from B.
        velocity_scaled: True if the velocity has a scale error.
        period: frame period h, s.
    """
    factors = _velocity_factors(cameras, velocity_scaled)
    last, pose = latest_sample(out, in_transit), measured_pose(state, noise, cameras, misaligned)
    is_lost = False if random is None else random.frame < cameras.errors.dropout_rate
    after = None if drift is None or drift_noise is None else _next_drift(drift, drift_noise, cameras, period)
    bandwidth = cameras.errors.derivative_bandwidth
    if before is None or bandwidth is None:
        frame = where(is_lost, last, _with_drift(_unfiltered_frame(pose, state, factors), after, 1.0))
    else:
        # The filter uses its previous output without the drift, so the drift is subtracted before the filter step and
        # added afterwards.
        without_drift = _with_drift(last, drift, -1.0)
        frame = _filtered_frame(where(is_lost, Pose.of(last), pose), without_drift, before, bandwidth, factors, period)
        frame = _with_drift(frame, after, 1.0)
    return *delay_line_step(frame, in_transit, cameras.errors.latency_frames), Pose.of(last), after


def frame_validity(in_transit: tuple[Valid, ...], random: Dropout, cameras: Cameras) -> tuple[Valid, tuple[Valid, ...]]:
    """Return the states of the delay line that holds the validity of the frames, after a frame."""
    valid = where(random.frame < cameras.errors.dropout_rate, 0.0, 1.0)
    return delay_line_step(Valid(valid), in_transit, cameras.errors.latency_frames)


def _all_valid(_: CameraParameters) -> Valid:
    return Valid(1.0)


def _with_drift(frame: State, drift: VelocityDrift | None, sign: float) -> State:
    """Return a frame with `sign` times the drift added to its velocity."""
    if drift is None:
        return frame
    x, y, z = (sign * each for each in drift)
    return frame._replace(v_x=frame.v_x + x, v_y=frame.v_y + y, v_z=frame.v_z + z)


def _velocity_factors(cameras: Cameras, velocity_scaled: bool) -> VelocityError | None:
    """Return the factors by which the velocity is multiplied; None if the velocity has no scale error."""
    return VelocityError._make(1.0 + error for error in cameras.errors.velocity_error) if velocity_scaled else None


def _next_drift(drift: VelocityDrift, drift_noise: VelocityDrift, cameras: Cameras, period: float) -> VelocityDrift:
    """Return the velocity drift one frame later, by one step of a first-order Gauss-Markov process."""
    decay = exp(-period / cameras.errors.drift_time)
    noise_gain = sqrt(1.0 - decay * decay)
    return VelocityDrift._make(
        decay * each + noise_gain * deviation * number
        for each, deviation, number in zip(drift, cameras.errors.velocity_drift, drift_noise, strict=True)
    )


def _unfiltered_frame(pose: Pose, state: State, factors: VelocityError | None) -> State:
    """Return a frame with the true velocity times the factors, and with the true body rates."""
    velocity = state.v_x, state.v_y, state.v_z
    if factors is not None:
        velocity = factors.x * state.v_x, factors.y * state.v_y, factors.z * state.v_z
    return State(*pose, *velocity, state.p, state.q, state.r)


def _filtered_frame(
    pose: Pose, last: State, before: Pose, bandwidth: Row, factors: VelocityError | None, period: float
) -> State:
    """Return a frame whose velocity and body rates are filtered differences; see `MotionCapture`."""
    p, q, r = _rotation(before, Attitude(last.roll, last.pitch, last.yaw), pose)
    decay = exp(-bandwidth * period)
    gain = (1.0 - decay) / (2.0 * period)
    x, y, z = (gain, gain, gain) if factors is None else (gain * factor for factor in factors)
    return State(
        *pose,
        decay * last.v_x + x * (pose.x - before.x),
        decay * last.v_y + y * (pose.y - before.y),
        decay * last.v_z + z * (pose.z - before.z),
        decay * last.p + gain * p,
        decay * last.q + gain * q,
        decay * last.r + gain * r,
    )


def _rotation(before: Pose, middle: Attitude, after: Pose) -> BodyRates:
    """Return the rotation between two poses that are two frames apart, along the axes of B, rad.

    For small changes of the angles, eq (2) is applied at the attitude of the frame in the middle. Near a pitch of 90°,
    and where an angle wraps at 180°, a small rotation can change the angles by large amounts. The rotation vector of
    the two attitudes is then returned.
    """
    steps = Attitude(after.roll - before.roll, after.pitch - before.pitch, after.yaw - before.yaw)
    limit = _MAX_ANGLE_CHANGE
    large = (abs(steps.roll) > limit) | (abs(steps.pitch) > limit) | (abs(steps.yaw) > limit)
    angles = before.roll, before.pitch, before.yaw, after.roll, after.pitch, after.yaw
    return lazy_where(large, _rotation_vector, angles, small_rotation(steps, middle))


def _rotation_vector(roll: Row, pitch: Row, yaw: Row, roll_after: Row, pitch_after: Row, yaw_after: Row) -> BodyRates:
    """Return the rotation vector from one attitude to another along the axes of B, rad."""
    before, after = Quaternion.of(roll, pitch, yaw), Quaternion.of(roll_after, pitch_after, yaw_after)
    return BodyRates(*before.relative_rotation_vector(after))


def _zero_state(_: CameraParameters) -> State:
    """Return an initial state whose values are all zero; the first frame replaces it."""
    return State(*(0.0,) * len(State._fields))


@fleet_system(float, AutoDiffXd)
class MotionCapture(FleetSystem):
    """Motion-capture cameras that measure position and attitude, with filters that estimate velocity and body rates.

    .. pydrake_system::

        name: MotionCapture
        input_ports:
        - state
        - camera_noise
        - dropout
        - velocity_drift
        output_ports:
        - measurement

    A frame contains the position and attitude of the markers' frame M at an instant, with noise. If a frame is lost,
    the previous one is repeated. The filter ω s / (s + ω) estimates the derivative of each coordinate x from
    differences over two frames:

        v⁺ = a v + (1 - a) (x⁺ - x⁻) / 2h,    a = exp(-ω h)

    where x⁻, x and x⁺ are successive samples. White noise of standard deviation σ in x causes noise of standard
    deviation σ (1 - a) / (√2 h) in v. If differences were taken over a single frame, most of their noise would have a
    frequency that is aliased to zero by a controller that uses every second frame, and the vehicle would drift.
    Differences over two frames contain no noise at this frequency, at the cost of half a frame of additional delay.
    Body rates are estimated in the same way from the rotation over two frames. For small changes of roll, pitch and
    yaw, this rotation follows from eq (2) with the differences of these angles and the attitude in the middle frame.
    Without a filter, velocity and body rates are measured exactly. A frame is available `latency_frames` periods after
    it was taken.

    Two further velocity errors represent on-board estimators that use an accelerometer. `velocity_error` is a
    relative scale error on each axis of W, as observed in some flights of the Crazyflie. `velocity_drift` is the
    standard deviation σ of a slowly varying error d on each axis,

        d⁺ = a d + √(1 - a²) σ n,    a = exp(-h / T)

    with the `drift_time` T and standard normal n. The initial drift is zero. The drift is added to the output of a
    filter.

    By default the cameras are ideal: they sample the state and hold the sample until the next frame.

    The random input ports exist only if they are needed. `camera_noise` contains standard normal samples for position
    and attitude. `dropout` is a uniform number in [0, 1) for each frame, which is lost if the number is below the
    dropout rate. `velocity_drift` contains standard normal samples for the velocity drift.

    The states are `measurement` and `measurement_in_transit`, the two states of a `DelayLine`. A filter adds the state
    `pose_before`, the pose in the frame before the latest one. A drift adds the state `drift`, the drift in the latest
    frame. The only parameter of the context is `cameras`. Cameras that report lost frames have the output port
    `measurement_valid`, which is 1 for a new frame and 0 for a repeated one, and a `DelayLine` for it.

    Args:
        num_vehicles: number N of vehicles.
        period: frame period h, s; 0.01 s in Kayacan and Maslim (2016).
        noisy: True for measurements with noise.
        loses_frames: True if frames can be lost.
        reports_losses: True for the output port `measurement_valid`; only used if frames can be lost.
        misaligned: True if the markers' frame differs from B.
        velocity_scaled: True if the velocity has a scale error.
        filtered: True if filters estimate velocity and body rates.
        drifts: True if the measured velocity drifts.
        longest_latency: largest possible latency, in frames.
        parameters: parameters of the errors.

    Raises:
        ValueError: if `filtered` is True and the bandwidth is None.
    """

    def declare(
        self,
        *,
        period: float = 0.01,
        noisy: bool = False,
        loses_frames: bool = False,
        reports_losses: bool = False,
        misaligned: bool = False,
        velocity_scaled: bool = False,
        filtered: bool = False,
        drifts: bool = False,
        longest_latency: int = 0,
        parameters: CameraParameters = CameraParameters(),
    ) -> None:
        """Declare the ports, states and parameters of this system."""
        if filtered and parameters.derivative_bandwidth is None:
            raise ValueError("derivative_bandwidth is None, but filters need a bandwidth")
        state, cameras = self.input("state"), self.parameter("cameras", Cameras.of)
        noise = random = before = drift = drift_noise = None
        gaussian, uniform = RandomDistribution.kGaussian, RandomDistribution.kUniform
        if noisy:
            noise = self.random_input("camera_noise", Pose, gaussian, period=period)
        if loses_frames:
            random = self.random_input("dropout", Dropout, uniform, period=period)
        line = declare_delay_line(self, "measurement", _zero_state, longest_latency)
        if filtered:
            before = self.state("pose_before", lambda parameters: Pose.of(_zero_state(parameters)))
        if drifts:
            drift_noise = self.random_input("velocity_drift", VelocityDrift, gaussian, period=period)
            drift = self.state("drift", lambda parameters: VelocityDrift(0.0, 0.0, 0.0))
        writes = *line, before, drift
        first_arguments = state, noise, cameras, misaligned, velocity_scaled, filtered, longest_latency
        self.initialize(first_frame, *first_arguments, writes=writes)
        sources = noise, random, drift_noise
        next_arguments = (
            state,
            line.out,
            line.in_transit,
            before,
            drift,
            *sources,
            cameras,
            misaligned,
            velocity_scaled,
            period,
        )
        self.update(period, next_frame, *next_arguments, writes=writes)
        self.state_output(line.out)
        if random is not None and reports_losses:
            validity = declare_delay_line(self, "valid", _all_valid, longest_latency)
            self.update(period, frame_validity, validity.in_transit, random, cameras, writes=tuple(validity))
            self.output("measurement_valid", identity, validity.out, layout=layout_of(Valid))
