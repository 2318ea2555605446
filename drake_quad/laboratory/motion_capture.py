"""Motion capture: what the ground station sees of the vehicles.

A frame is taken at the beginning, by an initialization event, and at every multiple of the period; it can be read from
then on, but by the other discrete updates of that instant only at the next. A simulator that goes on with a flight must
suppress initialization events, or filters begin anew:

    frame  ●━━━━━━━━━━○●━━━━━━━━━━○
           0          h            2h
"""

import math
from typing import Any, NamedTuple

import numpy as np
from pydrake.common import RandomDistribution

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


def attitude_of_markers(attitude: Rows, R_BM: Rows) -> tuple[Row, Row, Row]:
    """Roll, pitch and yaw (rad) of R_WB R_BM.

    Args:
        attitude: roll, pitch and yaw of B in W, rad.
        R_BM: the nine rows of a `RotationMatrix`, of the markers' frame in B.
    """
    xx, xy, xz, yx, yy, yz, zx, zy, zz = R_BM
    (s_r, s_p), (c_r, c_p) = sin_cos(attitude[:2])
    # Of Ry(θ) Rx(φ) R_BM, the product without the yaw: the first column and the last row.
    rolled_x, rolled_y, rolled_z = s_r * yx + c_r * zx, s_r * yy + c_r * zy, s_r * yz + c_r * zz
    return (
        arctan2(c_p * rolled_y - s_p * xy, c_p * rolled_z - s_p * xz),
        arcsin(s_p * xx - c_p * rolled_x),
        attitude[2] + arctan2(c_r * yx - s_r * zx, c_p * xx + s_p * rolled_x),
    )


def body_rates(steps: Rows, attitude: Rows) -> tuple[Row, Row, Row]:
    """Eq (2): small rotations about the axes of B for small steps of roll, pitch and yaw at an attitude, all in rad."""
    of_roll, of_pitch, of_yaw = steps
    (s_r, s_p), (c_r, c_p) = sin_cos(attitude[:2])
    level = c_p * of_yaw
    return of_roll - s_p * of_yaw, c_r * of_pitch + s_r * level, c_r * level - s_r * of_pitch


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
    attitude a frame before the newest. Numeric parameters of the context: the latency, if there can be any; then one
    with the bandwidth (infinite if there is none), the deviations of the six coordinates, the dropout rate and the nine
    rows of `RotationMatrix`. What was zero at construction is left out for good.

    Args:
        num_vehicles: N.
        period: h of the frames, s; the paper's cameras run at 100 Hz.
        errors: each entry a number or an (N,) array.
        derivative_bandwidth: ω, rad/s; likewise.
        latency_frames: whole number of periods; likewise.
    """

    def declare(
        self,
        *,
        num_vehicles: int = 1,
        period: float = 0.01,
        errors: CameraErrors = CameraErrors(),
        derivative_bandwidth: Row | None = None,
        latency_frames: Row = 0,
    ) -> None:
        """Declares the system; see the class for the arguments."""
        self.period = period
        self._state = self.input("state", 12)
        self._line = DelayLine(self, "measurement", [0.0] * 12, latency_frames)
        self._derives = derivative_bandwidth is not None
        if self._derives:
            self._before = self.discrete_state("measurement_before", [0.0] * 6)
        parameters = [derivative_bandwidth if self._derives else math.inf]

        def places(*rows: Row) -> slice:
            """Where these rows are among the parameters."""
            parameters.extend(rows)
            return slice(len(parameters) - len(rows), len(parameters))

        self._deviations = self._dropout_rate = self._misalignment = None
        if not (is_zero(errors.position_noise) and is_zero(errors.attitude_noise)):
            self._deviations = places(*[errors.position_noise] * 3, *[errors.attitude_noise] * 3)
            self._noise = self.random_input("camera_noise", 6, RandomDistribution.kGaussian)
        if not is_zero(errors.dropout_rate):
            self._dropout_rate = places(errors.dropout_rate)
            self._dropout = self.random_input("dropout", 1, RandomDistribution.kUniform)
        if not all(is_zero(angle) for angle in errors.misalignment):
            self._misalignment = places(*RotationMatrix.of(*errors.misalignment))
        self._parameters = self.numeric_parameter(parameters)
        self.DeclareInitializationDiscreteUpdateEvent(self._first_frame)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._next_frame)
        self.state_output(12, self._line.out)

    def _first_frame(self, context: Any, discrete_state: Any) -> None:
        parameters, state = self.parameter_rows(context, self._parameters), self.input_rows(context, self._state)
        pose = self._pose(context, parameters, state)
        motion = [0.0] * 6 if self._derives else state[6:12]
        self._line.fill(discrete_state, [*pose, *motion])
        if self._derives:
            self.write(discrete_state.get_mutable_vector(self._before), pose)

    def _next_frame(self, context: Any, discrete_state: Any) -> None:
        last = self._line.newest(context)
        self._line.advance(context, discrete_state, lambda frame: self.write(frame, self._frame(context, last)))
        if self._derives:
            self.write(discrete_state.get_mutable_vector(self._before), last[0:6])

    def _frame(self, context: Any, last: Rows) -> list[Row]:
        """The 12 rows of the frame of this instant, given those of the one before."""
        parameters, state = self.parameter_rows(context, self._parameters), self.input_rows(context, self._state)
        pose, motion = self._pose(context, parameters, state), state[6:12]
        if self._dropout_rate is not None:
            (number,), (rate,) = self.input_rows(context, self._dropout), parameters[self._dropout_rate]
            lost = number < rate
            pose = where(lost, last[0:6], pose)
            motion = motion if self._derives else where(lost, last[6:12], motion)
        if self._derives:
            decay = exp(-parameters[0] * self.period)
            gain = (1.0 - decay) / (2.0 * self.period)
            steps = [new - old for new, old in zip(pose, self.state_rows(context, self._before))]
            steps[3:6] = body_rates(steps[3:6], last[3:6])
            motion = [decay * old + gain * step for old, step in zip(last[6:12], steps)]
        return [*pose, *motion]

    def _pose(self, context: Any, parameters: Rows, state: Rows) -> Rows:
        """Six rows of position and attitude, with misalignment and noise."""
        pose = state[0:6]
        if self._misalignment is not None:
            pose = [*state[0:3], *attitude_of_markers(state[3:6], parameters[self._misalignment])]
        if self._deviations is None:
            return pose
        noise = self.input_rows(context, self._noise)
        return [x + deviation * n for x, deviation, n in zip(pose, parameters[self._deviations], noise)]
