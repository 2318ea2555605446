"""Motion capture: what the ground station sees of the vehicles.

A frame is taken at the beginning, by an initialization event, and at every multiple of the period; it can be read from
then on, but by the other discrete updates of that instant only at the next. A simulator that goes on with a flight must
suppress initialization events, or filters begin anew:

    frame  ●━━━━━━━━━━○●━━━━━━━━━━○
           0          h            2h
"""

from typing import Any, NamedTuple

import numpy as np
from pydrake.common import RandomDistribution

from drake_quad.compiled import formula
from drake_quad.elementary import Row, Rows, arcsin, arctan2, exp, is_zero, sin_cos, where
from drake_quad.fleet import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.laboratory.delay_line import DelayLine


@fleet_system(float, AutoDiffXd)
class IdealMotionCapture(FleetSystem):
    """Samples the state and holds it until the next frame.

    .. pydrake_system::

        name: IdealMotionCapture
        input_ports:
        - state
        output_ports:
        - measurement

    Both ports have the 12 rows of the vehicle's `state`. The only discrete-state group is the frame.

    Args:
        num_vehicles: N.
        period: of the frames, s; the paper's cameras run at 100 Hz.
    """

    def declare(self, *, num_vehicles: int = 1, period: float = 0.01) -> None:
        """Declares the system; see the class for the arguments."""
        self._state = self.input("state", 12)
        self._frame = self.discrete_state("measurement", [0.0] * 12)
        self.DeclareInitializationDiscreteUpdateEvent(self._take_frame)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._take_frame)
        self.state_output(12, self._frame)

    def _take_frame(self, context: Any, discrete_state: Any) -> None:
        self.copy(discrete_state.get_mutable_vector(self._frame), self.EvalVectorInput(context, self._state))


class CameraErrors(NamedTuple):
    """By how much cameras are wrong.

    Attributes:
        position_noise: standard deviation on each axis, m.
        attitude_noise: standard deviation of roll, pitch and yaw, rad.
        dropout_rate: share of the frames that are lost, 1.
        misalignment: roll, pitch and yaw of the frame of the markers in B, 3 rows, rad.
    """

    position_noise: Row = 0.0
    attitude_noise: Row = 0.0
    dropout_rate: Row = 0.0
    misalignment: Rows = (0.0, 0.0, 0.0)


class RotationMatrix(NamedTuple):
    """R_BM of eq (1), row by row, for the frame M of the markers."""

    xx: Row
    xy: Row
    xz: Row
    yx: Row
    yy: Row
    yz: Row
    zx: Row
    zy: Row
    zz: Row

    @classmethod
    def of(cls, roll: Row, pitch: Row, yaw: Row) -> "RotationMatrix":
        """Eq (1), of angles in rad."""
        (s_r, s_p, s_y), (c_r, c_p, c_y) = ([f(x) for x in (roll, pitch, yaw)] for f in (np.sin, np.cos))
        return cls(
            c_y * c_p,
            c_y * s_p * s_r - s_y * c_r,
            s_y * s_r + c_y * s_p * c_r,
            s_y * c_p,
            c_y * c_r + s_y * s_p * s_r,
            s_y * s_p * c_r - c_y * s_r,
            -s_p,
            c_p * s_r,
            c_p * c_r,
        )


@formula
def attitude_of_markers(attitude: Rows, R_BM: Rows) -> tuple[Row, Row, Row]:
    """Roll, pitch and yaw (rad) of R_WB R_BM.

    Args:
        attitude: roll, pitch and yaw of B in W, rad.
        R_BM: the nine rows of a `RotationMatrix`, of the markers' frame in B.
    """
    xx, xy, xz, yx, yy, yz, zx, zy, zz = R_BM
    roll, pitch, yaw = attitude
    s_r, c_r = sin_cos(roll)
    s_p, c_p = sin_cos(pitch)
    # Of Ry(θ) Rx(φ) R_BM, the product without the yaw: the first column and the last row.
    rolled_x, rolled_y, rolled_z = s_r * yx + c_r * zx, s_r * yy + c_r * zy, s_r * yz + c_r * zz
    return (
        arctan2(c_p * rolled_y - s_p * xy, c_p * rolled_z - s_p * xz),
        arcsin(s_p * xx - c_p * rolled_x),
        yaw + arctan2(c_r * yx - s_r * zx, c_p * xx + s_p * rolled_x),
    )


@formula
def body_rates(steps: Rows, attitude: Rows) -> tuple[Row, Row, Row]:
    """Eq (2): small rotations about the axes of B for small steps of roll, pitch and yaw at an attitude, all in rad."""
    of_roll, of_pitch, of_yaw = steps
    s_r, c_r = sin_cos(attitude[0])
    s_p, c_p = sin_cos(attitude[1])
    level = c_p * of_yaw
    return of_roll - s_p * of_yaw, c_r * of_pitch + s_r * level, c_r * level - s_r * of_pitch


@formula
def seen_pose(state: Rows, noise: Rows, deviations: Rows, R_BM: Rows, misaligned: float) -> tuple[Row, ...]:
    """Six rows of position and attitude, with misalignment and noise.

    Args:
        state: of the vehicle, 12 rows.
        noise: six normal numbers.
        deviations: of the noise, 6 rows.
        R_BM: the nine rows of a `RotationMatrix`, of the markers' frame in B.
        misaligned: 0 if that frame is B.
    """
    x, y, z = state[0:3]
    aligned = state[3], state[4], state[5]
    roll, pitch, yaw = where(misaligned != 0.0, attitude_of_markers(aligned, R_BM), aligned)
    return (
        x + deviations[0] * noise[0],
        y + deviations[1] * noise[1],
        z + deviations[2] * noise[2],
        roll + deviations[3] * noise[3],
        pitch + deviations[4] * noise[4],
        yaw + deviations[5] * noise[5],
    )


@formula
def first_frame(
    state: Rows, noise: Rows, deviations: Rows, R_BM: Rows, misaligned: float, share: float
) -> tuple[Rows, Rows]:
    """The first frame, 12 rows, with a share of velocity and body rates, and its pose.

    Args:
        state: of the vehicle, 12 rows.
        noise: six normal numbers.
        deviations: of the noise, 6 rows.
        R_BM: the nine rows of a `RotationMatrix`, of the markers' frame in B.
        misaligned: 0 if that frame is B.
        share: 1 if velocity and body rates are seen, 0 if a filter begins at rest.
    """
    pose = seen_pose(state, noise, deviations, R_BM, misaligned)
    v_x, v_y, v_z, p, q, r = state[6:12]
    return (*pose, share * v_x, share * v_y, share * v_z, share * p, share * q, share * r), pose


@formula
def frame(
    state: Rows,
    last: Rows,
    noise: Rows,
    deviations: Rows,
    number: Rows,
    dropout_rate: Rows,
    R_BM: Rows,
    misaligned: float,
) -> tuple[Rows]:
    """A frame whose velocity and body rates are exact, 12 rows.

    Args:
        state: of the vehicle, 12 rows.
        last: the frame before, 12 rows.
        noise: six normal numbers.
        deviations: of the noise, 6 rows.
        number: one between 0 and 1.
        dropout_rate: below which it means that the frame is lost.
        R_BM: the nine rows of a `RotationMatrix`, of the markers' frame in B.
        misaligned: 0 if that frame is B.
    """
    lost, pose = number[0] < dropout_rate[0], seen_pose(state, noise, deviations, R_BM, misaligned)
    motion = state[6], state[7], state[8], state[9], state[10], state[11]
    return ((*where(lost, last[0:6], pose), *where(lost, last[6:12], motion)),)


@formula
def filtered_frame(
    state: Rows,
    last: Rows,
    noise: Rows,
    deviations: Rows,
    number: Rows,
    dropout_rate: Rows,
    R_BM: Rows,
    before: Rows,
    bandwidth: Rows,
    misaligned: float,
    period: float,
) -> tuple[Rows, Rows]:
    """A frame whose velocity and body rates are filtered differences, 12 rows, and the pose that is now the one before.

    Args:
        state: as for `frame`, with all that follows up to the misalignment.
        last: likewise.
        noise: likewise.
        deviations: likewise.
        number: likewise.
        dropout_rate: likewise.
        R_BM: likewise.
        before: the pose before the last frame, 6 rows.
        bandwidth: ω, rad/s.
        misaligned: 0 if the markers' frame is B.
        period: h, s.
    """
    lost = number[0] < dropout_rate[0]
    pose = seen_pose(state, noise, deviations, R_BM, misaligned)
    x, y, z, roll, pitch, yaw = where(lost, last[0:6], pose)
    p, q, r = body_rates((roll - before[3], pitch - before[4], yaw - before[5]), (last[3], last[4]))
    decay = exp(-bandwidth[0] * period)
    gain = (1.0 - decay) / (2.0 * period)
    seen = (
        x,
        y,
        z,
        roll,
        pitch,
        yaw,
        decay * last[6] + gain * (x - before[0]),
        decay * last[7] + gain * (y - before[1]),
        decay * last[8] + gain * (z - before[2]),
        decay * last[9] + gain * p,
        decay * last[10] + gain * q,
        decay * last[11] + gain * r,
    )
    return seen, last[0:6]


@fleet_system(float, AutoDiffXd)
class MotionCapture(FleetSystem):
    """Cameras that see position and attitude, with errors, and filters that make velocity and body rates of them.

    .. pydrake_system::

        name: MotionCapture
        input_ports:
        - state
        - camera_noise
        - dropout
        output_ports:
        - measurement

    `state` and `measurement` have the 12 rows of the vehicle's state. A frame is position and attitude of the frame of
    the markers at an instant, with noise; a frame that is lost is the one before it once more. Of each coordinate x
    the filter ω s / (s + ω) makes the derivative, from differences over two frames:

        v⁺ = a v + (1 - a) (x⁺ - x⁻) / 2h,    a = exp(-ω h)

    where x⁻, x, x⁺ follow each other, so that white noise of standard deviation σ in x is one of σ (1 - a) / (√2 h) in
    v. Differences over a single frame would have their most noise where control that reads every second frame folds it
    down to standstill, and make a vehicle wander; these have none there, for half a frame more of delay. Body rates are
    those of eq (2): it turns the differences of roll, pitch and yaw at the attitude in their middle. Without a
    bandwidth velocity and body rates are seen exactly. A frame can be read `latency_frames` periods after it was taken.

    The random ports are there if there is need for them: `camera_noise` (6 rows: position, attitude), normal numbers;
    `dropout` (1 row), a number between 0 and 1 for each frame, which is lost if it is below the dropout rate.

    Discrete-state groups: those of a `DelayLine`, 12 rows each; with a bandwidth, a last one of 6 rows, position and
    attitude a frame before the newest. Numeric parameters of the context, each if there is need for it: the
    latency, the bandwidth, the deviations of the six coordinates, the dropout rate, the nine rows of `RotationMatrix`.
    What was zero at construction is left out for good.

    Args:
        num_vehicles: N.
        period: h of the frames, s; the paper's cameras run at 100 Hz.
        errors: each entry a number or an (N,) array.
        derivative_bandwidth: ω, rad/s; likewise.
        latency_frames: whole number of periods; likewise.
        longest_latency: that it will ever be in a context; if not given, no longer than these.
    """

    def declare(
        self,
        *,
        num_vehicles: int = 1,
        period: float = 0.01,
        errors: CameraErrors = CameraErrors(),
        derivative_bandwidth: Row | None = None,
        latency_frames: Row = 0,
        longest_latency: int | None = None,
    ) -> None:
        """Declares the system; see the class for the arguments."""
        self.period = period
        self._state = self.input("state", 12)
        self._line = DelayLine(self, "measurement", [0.0] * 12, latency_frames, longest_latency)
        self._first = self.interpreted(first_frame, inputs=(12, 6, 6, 9))
        inputs = [12, 12, 6, 6, 1, 1, 9]
        self._before = self._bandwidth = None
        if derivative_bandwidth is None:
            self._map = self.mapped(frame, inputs=inputs, outputs=(12,))
        else:
            self._before = self.discrete_state("measurement_before", [0.0] * 6)
            self._bandwidth = self.numeric_parameter([derivative_bandwidth])
            self._map = self.mapped(filtered_frame, inputs=[*inputs, 6, 1], outputs=(12, 6))
        self._noise = self._deviations = self._dropout = self._dropout_rate = self._R_BM = None
        if not (is_zero(errors.position_noise) and is_zero(errors.attitude_noise)):
            self._noise = self.random_input("camera_noise", 6, RandomDistribution.kGaussian)
            self._deviations = self.numeric_parameter([*[errors.position_noise] * 3, *[errors.attitude_noise] * 3])
        if not is_zero(errors.dropout_rate):
            self._dropout = self.random_input("dropout", 1, RandomDistribution.kUniform)
            self._dropout_rate = self.numeric_parameter([errors.dropout_rate])
        if not all(is_zero(angle) for angle in errors.misalignment):
            self._R_BM = self.numeric_parameter(RotationMatrix.of(*errors.misalignment))
        self.DeclareInitializationDiscreteUpdateEvent(self._first_frame)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._next_frame)
        self.state_output(12, self._line.out)

    def _first_frame(self, context: Any, discrete_state: Any) -> None:
        state, noise = self.inputs(context, self._state, self._noise)
        sources = [state, noise, self.parameter(context, self._deviations), self.parameter(context, self._R_BM)]
        groups = [self._line.out] if self._before is None else [self._line.out, self._before]
        targets = [discrete_state.get_mutable_vector(group) for group in groups]
        self._first(targets, sources, self._misaligned, 1.0 if self._before is None else 0.0)
        self._line.fill(discrete_state)

    def _next_frame(self, context: Any, discrete_state: Any) -> None:
        state, noise, number = self.inputs(context, self._state, self._noise, self._dropout)
        sources = [
            state,
            self._line.newest(context),
            noise,
            self.parameter(context, self._deviations),
            number,
            self.parameter(context, self._dropout_rate),
            self.parameter(context, self._R_BM),
        ]
        frame = self._line.advance(context, discrete_state)
        if self._before is None:
            self._map([frame], sources, self._misaligned)
        else:
            before, bandwidth = context.get_discrete_state(self._before), self.parameter(context, self._bandwidth)
            targets = [frame, discrete_state.get_mutable_vector(self._before)]
            self._map(targets, [*sources, before, bandwidth], self._misaligned, self.period)
        self._line.release(context, discrete_state)

    @property
    def _misaligned(self) -> float:
        return 0.0 if self._R_BM is None else 1.0
