"""Motion capture: what the ground station sees of the vehicles.

A frame is taken at the beginning, by an initialization event, and at every multiple of the period; it can be read from
then on, but by the other discrete updates of that instant only at the next. A simulator that goes on with a flight must
suppress initialization events, or filters begin anew:

    frame  ●━━━━━━━━━━○●━━━━━━━━━━○
           0          h            2h
"""

from typing import Annotated, NamedTuple

from pydrake.common import RandomDistribution

from drake_quad.framework.elementary import exp, sqrt, where, where_needed
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.geometry.axes import BodyAxes, Tilt
from drake_quad.geometry.kinematics import small_rotation
from drake_quad.geometry.quaternion import Quaternion
from drake_quad.laboratory.delay_line import carried, declare_delay_line, newest
from drake_quad.signals import Angle, Attitude, BodyRates, Number, PositionW, Quantity, Row, State

# Largest change of an angle over two frames for which eq (2) is used, rad; it corresponds to 2.5 rad/s at 100 Hz. The
# error of eq (2) is of third order in the changes, and of second order if they are uneven, as near a pitch of 90°.
_MAX_ANGLE_CHANGE = 0.05


class VelocityError(NamedTuple):
    """By how much velocity along X, Y, Z is seen too large, as a share of it."""

    x: Number
    y: Number
    z: Number


class VelocityDrift(NamedTuple):
    """A slowly changing error of velocity along X, Y, Z; or a normal number for each."""

    x: Annotated[Row, Quantity("m/s", "W")]
    y: Annotated[Row, Quantity("m/s", "W")]
    z: Annotated[Row, Quantity("m/s", "W")]


class CameraNumbers(NamedTuple):
    """By how much cameras are wrong.

    Attributes:
        position_noise: standard deviation on each axis.
        attitude_noise: standard deviation of roll, pitch and yaw.
        dropout_rate: share of the frames that are lost.
        misalignment: roll, pitch and yaw of the frame of the markers in B.
        derivative_bandwidth: ω of the filter that makes velocity and body rates; None without a filter.
        latency_frames: whole number of frames after which one can be read.
        velocity_error: of the velocity on each axis, as a share of it.
        velocity_drift: standard deviation of a slowly changing error of the velocity on each axis.
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
    """Parameter of the cameras.

    Attributes:
        errors: numbers of their errors.
        R_BM: orientation of the markers' frame in B, from the misalignment.
    """

    errors: CameraNumbers
    R_BM: BodyAxes

    @classmethod
    def of(cls, numbers: CameraNumbers) -> "Cameras":
        """Return the parameter of cameras with some numbers."""
        return cls(numbers, BodyAxes.of(*numbers.misalignment))


class Pose(NamedTuple):
    """Position and attitude; or a normal number for the noise of each."""

    x: PositionW
    y: PositionW
    z: PositionW
    roll: Angle
    pitch: Angle
    yaw: Angle

    @classmethod
    def of(cls, state: State) -> "Pose":
        """The pose of a state."""
        return cls(state.x, state.y, state.z, state.roll, state.pitch, state.yaw)


class Dropout(NamedTuple):
    """A random number between 0 and 1 for each frame, which is lost if it is below the dropout rate."""

    frame: Number


def attitude_of_markers(attitude: Attitude, R_BM: BodyAxes) -> Attitude:
    """Return roll, pitch and yaw of the markers' frame M in W, which are those of R_WB R_BM.

    Args:
        attitude: roll, pitch and yaw of B in W.
        R_BM: orientation of the markers' frame in B.
    """
    tilt = Tilt.of(attitude.roll, attitude.pitch)
    angles = BodyAxes._make(tilt.in_heading(axis) for axis in R_BM).angles()
    return angles._replace(yaw=attitude.yaw + angles.yaw)


def seen_pose(state: State, noise: Pose | None, cameras: Cameras, misaligned: bool) -> Pose:
    """Position and attitude of a vehicle, with misalignment and noise."""
    x, y, z, roll, pitch, yaw = Pose.of(state)
    if misaligned:
        roll, pitch, yaw = attitude_of_markers(Attitude(roll, pitch, yaw), cameras.R_BM)
    if noise is None:
        return Pose(x, y, z, roll, pitch, yaw)
    deviations = *[cameras.errors.position_noise] * 3, *[cameras.errors.attitude_noise] * 3
    true = x, y, z, roll, pitch, yaw
    return Pose._make(seen + size * number for seen, size, number in zip(true, deviations, noise, strict=True))


def first_frame(
    state: State,
    noise: Pose | None,
    cameras: Cameras,
    misaligned: bool,
    mistaken: bool,
    filtered: bool,
    num_under_way: int,
) -> tuple[State, tuple[State, ...], Pose, VelocityDrift]:
    """What the states of a `MotionCapture` hold at the beginning; a filter begins at rest."""
    pose = seen_pose(state, noise, cameras, misaligned)
    frame = State(*pose, *(0.0,) * 6) if filtered else _exact(pose, state, _factors(cameras, mistaken))
    return frame, (frame,) * num_under_way, pose, VelocityDrift(0.0, 0.0, 0.0)


def next_frame(
    state: State,
    out: State,
    under_way: tuple[State, ...],
    before: Pose | None,
    drift: VelocityDrift | None,
    noise: Pose | None,
    random: Dropout | None,
    drift_noise: VelocityDrift | None,
    cameras: Cameras,
    misaligned: bool,
    mistaken: bool,
    period: float,
) -> tuple[State, tuple[State, ...], Pose, VelocityDrift | None]:
    """What the states of a `MotionCapture` hold after a frame.

    Args:
        state: of the vehicle.
        out: the frame that can be read.
        under_way: the last frames, the newest first.
        before: the pose in the frame before the last one; None without a filter.
        drift: of the velocity in the frame before; None if there is none.
        noise: normal numbers; None if there is no noise.
        random: None if no frame can be lost.
        drift_noise: normal numbers; None if there is no drift.
        cameras: their errors.
        misaligned: whether the frame of the markers is not B.
        mistaken: whether velocity is seen too large or too small.
        period: h, s.
    """
    factors = _factors(cameras, mistaken)
    last, pose = newest(out, under_way), seen_pose(state, noise, cameras, misaligned)
    lost = False if random is None else random.frame < cameras.errors.dropout_rate
    after = None if drift is None or drift_noise is None else _drifted(drift, drift_noise, cameras, period)
    bandwidth = cameras.errors.derivative_bandwidth
    if before is None or bandwidth is None:
        frame = where(lost, last, _drifting(_exact(pose, state, factors), after, 1.0))
    else:
        # The filter goes on without the drift.
        true = _drifting(last, drift, -1.0)
        frame = _filtered(where(lost, Pose.of(last), pose), true, before, bandwidth, factors, period)
        frame = _drifting(frame, after, 1.0)
    return *carried(frame, under_way, cameras.errors.latency_frames), Pose.of(last), after


def _drifting(frame: State, drift: VelocityDrift | None, sign: float) -> State:
    """A frame with the drift added to its velocity, or taken from it."""
    if drift is None:
        return frame
    x, y, z = (sign * each for each in drift)
    return frame._replace(v_x=frame.v_x + x, v_y=frame.v_y + y, v_z=frame.v_z + z)


def _factors(cameras: Cameras, mistaken: bool) -> VelocityError | None:
    """What velocity is multiplied by; None if it is seen as it is."""
    return VelocityError._make(1.0 + error for error in cameras.errors.velocity_error) if mistaken else None


def _drifted(drift: VelocityDrift, drift_noise: VelocityDrift, cameras: Cameras, period: float) -> VelocityDrift:
    """The drift of the velocity, a frame later: a Gauss-Markov process."""
    decay = exp(-period / cameras.errors.drift_time)
    fresh = sqrt(1.0 - decay * decay)
    return VelocityDrift._make(
        decay * each + fresh * deviation * number
        for each, deviation, number in zip(drift, cameras.errors.velocity_drift, drift_noise, strict=True)
    )


def _exact(pose: Pose, state: State, factors: VelocityError | None) -> State:
    """A frame with the true velocity, or a multiple of it, and the true body rates."""
    velocity = state.v_x, state.v_y, state.v_z
    if factors is not None:
        velocity = factors.x * state.v_x, factors.y * state.v_y, factors.z * state.v_z
    return State(*pose, *velocity, state.p, state.q, state.r)


def _filtered(
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

    For small changes of the angles, eq (2) is applied at the attitude of the frame between them. Near a pitch of 90°,
    and where an angle wraps at 180°, small rotations are large changes of the angles. The result is then the rotation
    vector.
    """
    steps = Attitude(after.roll - before.roll, after.pitch - before.pitch, after.yaw - before.yaw)
    limit = _MAX_ANGLE_CHANGE
    large = (abs(steps.roll) > limit) | (abs(steps.pitch) > limit) | (abs(steps.yaw) > limit)
    angles = before.roll, before.pitch, before.yaw, after.roll, after.pitch, after.yaw
    return where_needed(large, _rotation_vector, angles, small_rotation(steps, middle))


def _rotation_vector(roll: Row, pitch: Row, yaw: Row, roll_after: Row, pitch_after: Row, yaw_after: Row) -> BodyRates:
    """Return the rotation vector from one attitude to another along the axes of B, rad."""
    before, after = Quaternion.of(roll, pitch, yaw), Quaternion.of(roll_after, pitch_after, yaw_after)
    return BodyRates(*before.rotation_to(after))


def _nothing(_: CameraNumbers) -> State:
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

    A frame is position and attitude of the frame of the markers at an instant, with noise; a frame that is lost is the
    one before it once more. Of each coordinate x the filter ω s / (s + ω) makes the derivative, from differences over
    two frames:

        v⁺ = a v + (1 - a) (x⁺ - x⁻) / 2h,    a = exp(-ω h)

    where x⁻, x, x⁺ follow each other, so that white noise of standard deviation σ in x is one of σ (1 - a) / (√2 h) in
    v. Differences over a single frame would have most of their noise at a frequency that control with every second
    frame aliases to zero, which makes a vehicle drift. Differences over two frames have no noise there, at the cost of
    half a frame of additional delay. Body rates follow from the rotation over two frames. For small changes of roll,
    pitch and yaw they follow from eq (2) with the differences of these angles and the attitude between them. Without a
    filter, velocity and body rates are measured exactly. A frame is available `latency_frames` periods after it was
    taken.

    Estimators on board of a vehicle, which make velocity with an accelerometer, may see it too large by a share, as
    those of the Crazyflie do in some flights; `velocity_error` is this share on each axis of W. What else they
    are off by stays on for a while: `velocity_drift` is its standard deviation on each axis, of the process

        d⁺ = a d + √(1 - a²) σ n,    a = exp(-h / T)

    with the `drift_time` T and normal n; it begins at zero, and beside a filter it is added to what that makes.

    By default cameras are ideal: they sample the state and hold it until the next frame.

    The random ports are there if there is need for them: `camera_noise` has normal numbers for position and attitude,
    `dropout` a number between 0 and 1 for each frame, which is lost if it is below the dropout rate, `velocity_drift`
    normal numbers for the drift of the velocity.

    The states are those of a `DelayLine`, `measurement` and `measurement_under_way`; with a filter, `pose_before` is
    that in the frame before the newest; with a drift, `drift` is that of the newest. The only parameter of the context
    is `cameras`.

    Args:
        num_vehicles: N.
        period: frame period h, s; the paper's cameras run at 100 Hz.
        noisy: True for measurements with noise.
        loses_frames: True if frames can be lost.
        misaligned: True if the frame of the markers differs from B.
        mistaken: True if the velocity has a scale error.
        filtered: True if filters estimate velocity and body rates.
        drifts: True if the velocity has a drift.
        longest_latency: largest possible latency, in frames.
        numbers: parameters of the errors.

    Raises:
        ValueError: there are filters, but no bandwidth.
    """

    def declare(
        self,
        *,
        period: float = 0.01,
        noisy: bool = False,
        loses_frames: bool = False,
        misaligned: bool = False,
        mistaken: bool = False,
        filtered: bool = False,
        drifts: bool = False,
        longest_latency: int = 0,
        numbers: CameraNumbers = CameraNumbers(),
    ) -> None:
        """Declares the system."""
        if filtered and numbers.derivative_bandwidth is None:
            raise ValueError("cameras with filters need a derivative_bandwidth")
        state, cameras = self.input("state"), self.parameter("cameras", Cameras.of)
        noise = random = before = drift = drift_noise = None
        gaussian, uniform = RandomDistribution.kGaussian, RandomDistribution.kUniform
        if noisy:
            noise = self.random_input("camera_noise", Pose, gaussian, period=period)
        if loses_frames:
            random = self.random_input("dropout", Dropout, uniform, period=period)
        line = declare_delay_line(self, "measurement", _nothing, longest_latency)
        if filtered:
            before = self.state("pose_before", lambda numbers: Pose.of(_nothing(numbers)))
        if drifts:
            drift_noise = self.random_input("velocity_drift", VelocityDrift, gaussian, period=period)
            drift = self.state("drift", lambda numbers: VelocityDrift(0.0, 0.0, 0.0))
        writes = *line, before, drift
        first = state, noise, cameras, misaligned, mistaken, filtered, longest_latency
        self.initialize(first_frame, *first, writes=writes)
        sources = noise, random, drift_noise
        later = state, line.out, line.under_way, before, drift, *sources, cameras, misaligned, mistaken, period
        self.update(period, next_frame, *later, writes=writes)
        self.state_output(line.out)
