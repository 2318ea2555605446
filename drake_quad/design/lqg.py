"""Design of linear-quadratic-Gaussian control: the parameters of `control.kind: lqg`, for several plants at once.

A textbook design for one plant has hardly any margin. The parameters therefore minimise the mean square position error
of several plants, with different lags, camera latencies and link delays, in the scenario's wind and noise. The design
limits the peak sensitivity, the delay margin and the RMS of the commands. A trial requires no simulation: it solves two
Riccati equations and, for each plant, a Lyapunov equation of the closed loop over a tick.

The model of an axis, a chain of lags and integrators, only approximates the vehicle, which has drag and tilts in the
wind. A designed controller is therefore also checked in the exact linear model of the vehicle. If it violates a limit
there that it satisfies with the chain, the limit for the chain is tightened and the search continues.
"""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import scipy

from drake_quad.control.lqg.chains import (
    ChainNoise,
    ContinuousModel,
    Disturbances,
    SecondOrderResponse,
    discretise,
    discretise_noise,
    lateral_model,
    vertical_model,
)
from drake_quad.control.lqg.design import AxisLoop, Timing
from drake_quad.design.cascade import design_cascade
from drake_quad.errors import InputError
from drake_quad.flight.mission import plan_route
from drake_quad.flight.simulation import simulate_samples
from drake_quad.linear.closed_loop import laboratory_plant
from drake_quad.linear.disturbances import DisturbanceStatistics, disturbance_statistics, disturbances_along
from drake_quad.linear.link_margins import link_margins
from drake_quad.linear.margins import Margins, fast_margins
from drake_quad.process_settings import single_threaded_blas
from drake_quad.scenario.batch import Batch, median_scenario, scenario_at_quantile
from drake_quad.scenario.controls.lqg import ColouredNoise, LateralAxis, LqgControl, VerticalAxis, YawPd
from drake_quad.scenario.hovering import in_hover, with_exact_measurement
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.paths import distributions_in

_NUM_WIND_SAMPLES = 32  # number of samples for the statistics of the disturbances
# Correlation times of two disturbances that the filter assumes: a constant acceleration, and a constant angular
# acceleration (the bias). They are so long that the filter estimates both as constants, which has the effect of
# integral control.
_CONSTANT_TIME = 50.0  # s
_BIAS_TIME = 20.0  # s
# Smallest standard deviations that a design assumes, so that it also exists for a calm and ideal laboratory. The noise
# values are half of those in laboratory.yaml.
_MIN_DISTURBANCE = 0.05  # m/s²
_MIN_BIAS = 0.5  # m/s⁴, constant angular acceleration times gravity
_MIN_POSITION_NOISE = 5e-4  # m
_MIN_ATTITUDE_NOISE = 2e-3  # rad
# The design treats the error of a state estimator as white noise, whose variance follows from the changes of the error
# within this time. With 0.2 s, the variance is too small, and regulators follow the error: in warehouse_uwb, the RMSE
# is then 9.6 cm instead of 5.9 cm.
_ESTIMATE_INTERVAL = 1.0  # s
_ESTIMATE_DURATION = 20.0  # s, duration of each flight in which the error of an estimator is measured
_NUM_ESTIMATES = 4  # number of these flights
# Assumed uncertainty of plant parameters that are not distributions.
_LAG_SPREAD = 1.6  # factor by which the lag of a rotor may be larger or smaller than its nominal value
_RESPONSE_SPREAD = 1.15  # the same factor for the natural frequency of the attitude response
_DELAY_SPREAD = 1  # number of additional frames of camera latency, and of additional ticks of link delay
_NUM_FREQUENCIES = 120  # number of frequencies at which the sensitivity is computed
_MIN_FREQUENCY = 0.3  # rad/s, smallest frequency at which the sensitivity is computed
_PENALTY_WEIGHT = 9.0  # weight of violated limits in the cost; the logarithm of the error has the weight 1
_MAX_EVALUATIONS = 600  # largest number of cost evaluations in a search
# The limit on the RMS of the torque command is at least this multiple of the constant disturbance torque that the
# command must balance. In 1,000 flights of `bad_day`, Crazyflie designs with the factors 1, 2 and 3 crash in 17, 2.4
# and 3.4 % of the flights.
_TORQUE_HEADROOM = 2.0
# Largest number of searches. Each search has tighter limits than the one before, until the controller satisfies the
# given limits in the exact linear model.
_MAX_ROUNDS = 5
# A violated limit is tightened by the ratio by which it is violated, and by this additional factor.
_TIGHTENING = 0.998


class LqgLimits(NamedTuple):
    """Limits that a design must satisfy.

    Attributes:
        sensitivity: largest peak of |1 / (1 + L)| at the command link, for the loop with the nominal plant.
        delay: smallest delay margin at the command link, s.
        snap: largest RMS of the command along x and y if torques are sent over the link, m/s⁴; see `snap_limit`. The
            command is an angular acceleration, multiplied by gravity.
        acceleration: largest RMS of the command along z, m/s². With an autopilot, the limit also applies to x and y.
    """

    sensitivity: float = 3.0
    delay: float = 0.03
    snap: float = 40.0
    acceleration: float = 3.0


class Plant(NamedTuple):
    """Plant from the command to the motion of the vehicle.

    Attributes:
        has_series_lag: True if the rotor lag is in series with the attitude response, False if the response includes
            it.
        lag: time constant of the rotor lag, s.
        response: attitude response of an autopilot; None without an autopilot.
        latency_frames: camera latency beyond one frame period, in frames.
        delay_ticks: delay of the command link, in ticks.
        thrust_gain: ratio of actual to commanded changes of the thrust near hover.
    """

    has_series_lag: bool
    lag: float
    response: SecondOrderResponse | None
    latency_frames: int
    delay_ticks: int
    thrust_gain: float = 1.0


class Conditions(NamedTuple):
    """Disturbances, measurement noise and packet loss of a laboratory.

    Attributes:
        lateral: statistics of the disturbing acceleration along x and y.
        vertical: statistics of the disturbing acceleration along z.
        bias: standard deviation of the constant disturbing angular acceleration, multiplied by gravity, m/s⁴.
        position_noise: standard deviation of the measured position, m.
        attitude_noise: standard deviation of the measured attitude, rad.
        loss_rate: fraction of the commands that are lost.
    """

    lateral: DisturbanceStatistics
    vertical: DisturbanceStatistics
    bias: float
    position_noise: float
    attitude_noise: float
    loss_rate: float


class ActualPlant(NamedTuple):
    """Model of an actual plant, sampled at the camera frames, with its disturbances and noise.

    Attributes:
        A: (n, n) system matrix.
        B: (n, 1) input matrix.
        C: (p, n) output matrix.
        Q: (n, n) covariance of the disturbances over a frame.
        R: (p, p) covariance of the measurement noise.
        plant: plant with the camera latency and the link delay.
        loss_rate: fraction of the commands that are lost.
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    Q: np.ndarray
    R: np.ndarray
    plant: Plant
    loss_rate: float

    @classmethod
    def of(
        cls, model: ContinuousModel, plant: Plant, conditions: Conditions, timing: Timing, gravity: float
    ) -> "ActualPlant":
        """Sample a continuous plant model, with given disturbances and noise."""
        noise = np.array([conditions.position_noise, gravity * conditions.attitude_noise])[: len(model.C)]
        Q = discretise_noise(model.A, model.Q, timing.frame)
        return cls(
            *discretise(model.A, model.B, timing.frame), model.C, Q, np.diag(noise**2), plant, conditions.loss_rate
        )


class AxisPrediction(NamedTuple):
    """Performance on one axis that a linear model predicts.

    Attributes:
        error: RMS position error at the ticks, m; infinite if the loop is unstable.
        command: RMS command, in the unit of the command.
        pole: largest magnitude of a closed-loop pole.
    """

    error: float
    command: float
    pole: float


@dataclass(frozen=True)
class LqgDesign:
    """Result of an LQG design.

    Attributes:
        control: scenario block `control` with the designed parameters.
        plants: plants that the design considers, the nominal plant first.
        conditions: disturbances and noise that the design considers.
        lateral: predicted performance along x or y, for each plant.
        vertical: predicted performance along z, for each plant.
    """

    control: LqgControl
    plants: tuple[Plant, ...]
    conditions: Conditions
    lateral: tuple[AxisPrediction, ...]
    vertical: tuple[AxisPrediction, ...]


def design_lqg(scenario: Scenario, limits: LqgLimits = LqgLimits()) -> LqgDesign:
    """Design linear-quadratic-Gaussian control for a scenario.

    If the scenario has no autopilot, the result includes a yaw PD, which is designed as for a cascade. If the scenario
    has a state estimator, the design assumes that the exact state is measured, with noise. The exact linear model, in
    which the limits are checked, contains the estimator.

    Args:
        scenario: scenario with or without distributions; its control is ignored.
        limits: limits that the design must satisfy.

    Raises:
        InputError: if no design is stable for the nominal plant, or the yaw PD cannot be designed.
    """
    on_board = scenario.laboratory.autopilot.controls_attitude
    measured = with_exact_measurement(scenario)
    plants, conditions = considered_plants(measured), flight_conditions(scenario)
    nominal, *_ = plants
    timings = candidate_timings(measured, plants)
    gravity = scenario.nominal.gravity

    def lateral_axis(
        command_weight: float, command_noise: float, first: float, second: float, bias: float, noise_factor: float
    ) -> LateralAxis:
        response = nominal.response
        return LateralAxis(
            lag=nominal.lag if nominal.has_series_lag else None,
            natural_frequency=response.natural_frequency if response else None,
            damping=response.damping if response else None,
            bias=ColouredNoise(deviation=bias, time=_BIAS_TIME),
            attitude_noise=float(f"{noise_factor * conditions.attitude_noise:.4g}"),
            **_common_fields(
                command_weight, command_noise, first, second, conditions.lateral.time, conditions.position_noise
            ),
        )

    def vertical_axis(command_weight: float, command_noise: float, first: float) -> VerticalAxis:
        # The deviation of the second disturbance is not tuned. A larger value improves the height slightly, but makes
        # the estimated disturbance along z noisier. The lateral axes use this estimate to predict the thrust, so the
        # commanded tilt would also be noisier.
        second = float(f"{conditions.vertical.deviation:.4g}")
        time, position_noise = conditions.vertical.time, conditions.position_noise
        common = _common_fields(command_weight, command_noise, first, second, time, position_noise)
        return VerticalAxis(lag=nominal.lag, **common)

    # The search starts from the parameters in controllers/lqg.yaml or, if the command is an acceleration, from
    # equivalent parameters.
    command_weight, command_noise = (1e-2, 0.3) if on_board else (1e-5, 3.3)

    def search_along_x(timing: Timing) -> _LqgSearch:
        return _LqgSearch(
            lateral_axis,
            lambda axis: axis.loop(timing, gravity),
            [
                ActualPlant.of(lateral_plant_model(plant, conditions), plant, conditions, timing, gravity)
                for plant in plants
            ],
            limits.acceleration if on_board else snap_limit(limits, conditions),
            timing,
            (
                command_weight,
                command_noise,
                max(conditions.lateral.mean, _MIN_DISTURBANCE),
                0.8,
                max(conditions.bias, 5.0),
                0.5,
            ),
            limits,
        )

    lateral = min((search_along_x(timing).improved() for timing in timings), key=lambda search: search.cost)
    timing = lateral.timing
    vertical = _LqgSearch(
        vertical_axis,
        lambda axis: axis.loop(timing, gravity),
        [
            ActualPlant.of(vertical_plant_model(plant, conditions), plant, conditions, timing, gravity)
            for plant in plants
        ],
        limits.acceleration,
        timing,
        (1e-3, 0.03, max(conditions.vertical.mean, _MIN_DISTURBANCE)),
        limits,
    ).improved()
    yaw = None if on_board else _yaw_pd(scenario)
    for _ in range(_MAX_ROUNDS):
        lateral_design, lateral_predictions = lateral.result()
        vertical_design, vertical_predictions = vertical.result()
        control = LqgControl(
            kind="lqg",
            delay_ticks=timing.delay_ticks,
            lateral=lateral_design,
            vertical=vertical_design,
            yaw=yaw,
            **dict(scenario.control.limits()),
        )
        design = LqgDesign(control, plants, conditions, lateral_predictions, vertical_predictions)
        thrust, roll, pitch, _ = link_margins(
            median_scenario(scenario.model_copy(update={"control": control}))
        ).values()
        tightened = lateral.with_tighter_limits(limits, (roll, pitch)), vertical.with_tighter_limits(limits, (thrust,))
        if tightened == (lateral, vertical):
            break
        lateral, vertical = (search.improved() for search in tightened)
    return design


def considered_plants(scenario: Scenario) -> tuple[Plant, ...]:
    """Return the plants that a design considers: the nominal plant, and corner plants around it.

    Each corner plant has extreme values of the uncertain fields. For a field with a distribution, these are the 10th
    and 90th percentiles. For any other field, they follow from an assumed uncertainty.
    """
    middle, low, high = (scenario_at_quantile(scenario, probability) for probability in (0.5, 0.1, 0.9))
    varied = distributions_in(scenario)

    def bounds(path: str, number: Callable[[Scenario], Any], default_low: Any, default_high: Any) -> tuple[Any, Any]:
        return (number(low), number(high)) if path in varied else (default_low, default_high)

    lag, frames, ticks = _rotor_time_constant(middle), _latency_frames(middle), _delay_ticks(middle)
    lags = bounds("vehicle.rotor_time_constant", _rotor_time_constant, 1.0 / _LAG_SPREAD * lag, _LAG_SPREAD * lag)
    latencies = bounds("laboratory.motion_capture.latency_frames", _latency_frames, frames, frames + _DELAY_SPREAD)
    delays = bounds("laboratory.command_link.delay_ticks", _delay_ticks, ticks, ticks + _DELAY_SPREAD)
    autopilot = middle.laboratory.autopilot
    response = autopilot.attitude_response()
    middle_plant = Plant(not autopilot.models_vehicle, lag, response, frames, ticks, _thrust_gain(middle))
    spread = zip(lags, (_RESPONSE_SPREAD, 1.0 / _RESPONSE_SPREAD), strict=True)
    corners = [
        middle_plant._replace(
            lag=lag,
            response=response and response._replace(natural_frequency=factor * response.natural_frequency),
            latency_frames=latency,
            delay_ticks=delay,
        )
        for (lag, factor), (latency, delay) in itertools.product(spread, zip(latencies, delays, strict=True))
    ]
    return middle_plant, *corners


def snap_limit(limits: LqgLimits, conditions: Conditions) -> float:
    """Return the limit on the RMS command along x and y over the link, m/s⁴.

    The limit must leave headroom for the constant command that balances an offset of the centre of mass. It is
    therefore at least a multiple of this command. An offset r causes the angular acceleration m g r / I of a vehicle
    with mass m and inertia I. This acceleration is large for small vehicles: an offset of 0.3 mm causes 5 rad/s² for a
    Crazyflie, five times as much as for the paper's vehicle.
    """
    return max(limits.snap, _TORQUE_HEADROOM * conditions.bias)


def candidate_timings(scenario: Scenario, plants: Sequence[Plant]) -> list[Timing]:
    """Return candidate timings: the mean delay of the plants, rounded to the nearest tick, and rounded up.

    If the mean lies between two ticks, the later tick gives more phase margin, and the nearer tick a faster loop.
    """
    cameras, link = scenario.laboratory.motion_capture, scenario.laboratory.command_link
    delays = [plant.delay_ticks + plant.latency_frames * cameras.period / link.period for plant in plants]
    mean = sum(delays) / len(delays)
    return [Timing(cameras.period, link.period, ticks) for ticks in sorted({round(mean), math.ceil(mean)})]


def flight_conditions(scenario: Scenario) -> Conditions:
    """Return the disturbances along the plan of a scenario, the measurement noise, and the packet loss rate."""
    batch = Batch.draw(scenario, range(_NUM_WIND_SAMPLES))
    disturbed = disturbances_along(batch, plan_route(scenario))
    x, y, z = disturbed.acceleration
    gravity = scenario.nominal.gravity
    link = scenario.laboratory.command_link
    position, attitude = measurement_noise(scenario)
    lateral, vertical = (
        each._replace(deviation=max(each.deviation, _MIN_DISTURBANCE), time=max(each.time, 5.0 * link.period))
        for each in (
            disturbance_statistics(np.array([x, y]), disturbed.step),
            disturbance_statistics(z, disturbed.step),
        )
    )
    bias = gravity * float(np.sqrt((disturbed.angular_acceleration**2).mean()))
    if scenario.laboratory.autopilot.models_vehicle:
        # An identified attitude response replaces the rotational dynamics, so no disturbing torque acts.
        bias = 0.0
    return Conditions(
        lateral,
        vertical,
        max(bias, _MIN_BIAS),
        max(position, _MIN_POSITION_NOISE),
        max(attitude, _MIN_ATTITUDE_NOISE),
        _rms(link.loss_rate),
    )


def measurement_noise(scenario: Scenario) -> tuple[float, float]:
    """Return the standard deviations of the measured position (m) and attitude (rad) that a design assumes.

    The error of a state estimator is correlated in time. The design replaces the error by white noise. The differences
    of two values of this noise have the same variance as the changes of the error within `_ESTIMATE_INTERVAL`, in
    simulated flights in hover with the control of the scenario.
    """
    laboratory = scenario.laboratory
    if not laboratory.estimator.integrates_sensors:
        return _rms(laboratory.motion_capture.position_noise), _rms(laboratory.motion_capture.attitude_noise)
    hovering = in_hover(median_scenario(scenario)).model_copy(update={"duration": _ESTIMATE_DURATION})
    flights = simulate_samples(hovering, range(_NUM_ESTIMATES))
    lag = max(round(_ESTIMATE_INTERVAL / laboratory.command_link.period), 1)

    def deviation(names: Sequence[str]) -> float:
        """Return the root mean square of the noise in some components of the state."""
        errors = np.array(
            [
                getattr(flight.record("measurement"), name) - getattr(flight.record("state"), name)
                for flight in flights
                for name in names
            ]
        )
        return float(np.sqrt(0.5 * np.square(errors[:, lag:] - errors[:, :-lag]).mean()))

    # The design assumes the same noise in x, y and z, and the same noise in roll and pitch.
    return deviation(("x", "y", "z")), deviation(("roll", "pitch"))


def predict_performance(loop: AxisLoop, actual_plant: ActualPlant, timing: Timing) -> AxisPrediction:
    """Return the performance that a linear model predicts if the filter and regulator of a loop control a plant."""
    (prediction,) = _LiftedLoops.of(loop, [actual_plant], timing).predicted()
    return prediction


@dataclass(frozen=True)
class _LiftedLoops:
    """Closed loops of an axis with k plants, over a tick.

    The state contains the states of the chain, the frames in transit, the states of the filter, and the commands in
    transit (once for the filter and once for the vehicle). All plants have as many states as the plant with the largest
    latency and delay.

    Attributes:
        A: (k, n, n) system matrices of the closed loops.
        Q: (k, n, n) covariances of the noise over a tick.
        command: (k, n) matrix rows that compute the sent command from the state.
        change: (k, n) matrix rows that compute the change of the sent command since the last tick.
        lost: (k, n, 1) change of the next state if the command that the vehicle receives exceeds the sent command by 1.
        opened: (k, n, n) system matrices of the loops, opened at the command link.
        loss_rates: (k,) fractions of the commands that are lost.
    """

    A: np.ndarray
    Q: np.ndarray
    command: np.ndarray
    change: np.ndarray
    lost: np.ndarray
    opened: np.ndarray
    loss_rates: np.ndarray

    @classmethod
    def of(cls, loop: AxisLoop, actual_plants: Sequence[ActualPlant], timing: Timing) -> "_LiftedLoops":
        """Return the loops of one filter and one regulator with several plants."""
        nominal, plants = actual_plants[0], [actual_plant.plant for actual_plant in actual_plants]
        n, p, m, num_pending = len(nominal.A), len(nominal.C), len(loop.K), len(loop.K_pending)
        frames, ticks = (max(late) + 1 for late in zip(*((each.latency_frames, each.delay_ticks) for each in plants)))
        ends = np.cumsum((0, n, p * frames, m, num_pending + 1, ticks))
        chain, frame_queue, estimate, filter_commands, vehicle_commands = (
            slice(*pair) for pair in itertools.pairwise(ends.tolist())
        )
        size = int(ends[-1])
        # The filter and the queue of frames are updated at every frame.
        F, H, L, gain = (np.array(part) for part in (loop.A, loop.B, loop.L, loop.K))
        C = np.eye(m)[[loop.K._fields.index(name) for name in ("position", "thrust")[:p]]]
        update, camera, motion = (np.tile(np.eye(size), (len(actual_plants), 1, 1)) for _ in range(3))
        noise = np.zeros_like(update)
        update[:, estimate, estimate] = F @ (np.eye(m) - L.T @ C)
        update[:, estimate, filter_commands.stop - 1] = H
        camera[:, frame_queue, frame_queue] = np.eye(p * frames, k=-p)
        newest_frame = slice(frame_queue.start, frame_queue.start + p)
        for i, (actual_plant, plant) in enumerate(zip(actual_plants, plants, strict=True)):
            first_read = frame_queue.start + p * plant.latency_frames
            update[i, estimate, first_read : first_read + p] = F @ L.T
            camera[i, newest_frame, chain] = actual_plant.C
            motion[i, chain, chain], motion[i, chain, vehicle_commands.start + plant.delay_ticks] = (
                actual_plant.A,
                actual_plant.B.ravel(),
            )
            noise[i, chain, chain], noise[i, newest_frame, newest_frame] = actual_plant.Q, actual_plant.R
        # At each tick, the two command queues advance: one for the filter and one for the vehicle, newest command
        # first.
        row = np.zeros(size)
        row[estimate] = -gain
        row[filter_commands.start : filter_commands.stop - 1] = -np.array(loop.K_pending)[::-1]
        shifted = np.eye(size)
        for part in (filter_commands, vehicle_commands):
            shifted[part, part] = np.eye(part.stop - part.start, k=-1)
        shifted[filter_commands.start] = row
        sent_column = np.zeros((size, 1))
        sent_column[vehicle_commands.start] = 1.0
        frame_motion = motion @ camera
        frame, opened, column = frame_motion @ update, frame_motion @ shifted @ update, frame_motion @ sent_column
        command_row = row @ update
        closed, Q = opened + column @ command_row[:, np.newaxis], noise
        for _ in range(round(timing.tick / timing.frame) - 1):
            closed, opened, column = frame @ closed, frame @ opened, frame @ column
            Q = frame @ Q @ frame.transpose(0, 2, 1) + noise
        previous_command = np.zeros(size)
        previous_command[vehicle_commands.start] = 1.0
        return cls(
            closed,
            Q,
            command_row,
            command_row - previous_command,
            column,
            opened,
            np.array([each.loss_rate for each in actual_plants]),
        )

    def predicted(self) -> list[AxisPrediction]:
        """Return the predicted performance for each plant, as `predict_performance` does for one plant.

        If a command is lost, the vehicle repeats the last command.
        """
        poles = np.abs(np.linalg.eigvals(self.A)).max(axis=1)
        error, command = np.full((2, len(poles)), np.inf)
        stable = np.flatnonzero(poles < 1.0 - 1e-9)
        lost = self.lost[stable]
        noise = np.stack([self.Q[stable], lost @ lost.transpose(0, 2, 1)])
        # The first axis of each array has two entries: one for the disturbances and measurement noise during a tick,
        # and one for noise of unit variance that is added to the command. The second axis enumerates the stable loops.
        X = _stationary_covariance(self.A[stable], noise)
        errors, commands, changes = X[..., 0, 0], _variance(self.command[stable], X), _variance(self.change[stable], X)
        # A lost command acts like noise with the variance of the command's change. This noise itself increases the
        # command's changes, so its variance follows from a geometric series.
        feedback = self.loss_rates[stable] * changes[1]
        converges = feedback < 0.9
        loss_variance = (self.loss_rates[stable] * changes[0])[converges] / (1.0 - feedback[converges])
        for total, sizes in ((error, errors), (command, commands)):
            by_noise, by_loss = sizes[:, converges]
            total[stable[converges]] = np.sqrt(by_noise + loss_variance * by_loss)
        return [AxisPrediction(*each) for each in zip(error.tolist(), command.tolist(), poles.tolist(), strict=True)]

    def sensitivity(self, z: np.ndarray) -> np.ndarray:
        """Return 1 / (1 + L) = det(zI - A_opened) / det(zI - A) at points of the z-plane, for the first plant."""
        zeros, poles = (np.linalg.eigvals(each[0]) for each in (self.opened, self.A))
        return ((z[:, np.newaxis] - zeros) / (z[:, np.newaxis] - poles)).prod(axis=1)


def _stationary_covariance(A: np.ndarray, Q: np.ndarray) -> np.ndarray:
    """Solve X = A X Aᵀ + Q for stable A (k, n, n) and covariances Q (..., k, n, n).

    The number of terms in the sum of A^i Q Aᵀ^i is doubled until the sum no longer changes (R. A. Smith, "Matrix
    equation XA + BX = C", 1968). For stacks of small matrices, this method is much faster than Schur forms.
    """
    X, power = Q, A
    while True:
        added = power @ X @ power.transpose(0, 2, 1)
        X = X + added
        variances, new = (np.diagonal(each, axis1=-2, axis2=-1) for each in (X, added))
        if not (new > np.finfo(float).eps * variances).any():
            return X
        power = power @ power


def _variance(row: np.ndarray, X: np.ndarray) -> np.ndarray:
    """Return the variances (..., k) of linear functions (k, n) of states with covariances X (..., k, n, n)."""
    return np.einsum("ki,...kij,kj->...k", row, X, row)


@dataclass(frozen=True, eq=False)
class _LqgSearch:
    """Search for the best controller parameters on one axis.

    Attributes:
        axis_of: function that returns the scenario block of the axis for given parameters.
        loop_of: function that returns the filter and the regulator for this block.
        actual_plants: models of all plants that the design considers, the nominal plant first.
        max_command: largest allowed RMS of the command.
        timing: control period, frame period and delay that the filter assumes.
        values: best parameters so far, or initial parameters.
        chain_limits: limits for the loop with the nominal chain.
        cost: cost of the best parameters so far.
    """

    axis_of: Callable[..., Any]
    loop_of: Callable[[Any], AxisLoop]
    actual_plants: Sequence[ActualPlant]
    max_command: float
    timing: Timing
    values: Sequence[float]
    chain_limits: LqgLimits
    cost: float = math.inf

    def cost_of(self, logs: np.ndarray) -> float:
        """Return the logarithm of the error plus a penalty for violated limits, given the parameters' logarithms."""
        try:
            loop = self.loop_of(self.axis_of(*np.exp(logs).tolist()))
        except (np.linalg.LinAlgError, ValueError):
            return 1e3
        lifted = _LiftedLoops.of(loop, self.actual_plants, self.timing)
        predictions = lifted.predicted()
        stable = [prediction for prediction in predictions if math.isfinite(prediction.error)]
        violation = sum(
            5.0 + 20.0 * max(prediction.pole - 1.0, 0.0) for prediction in predictions if prediction not in stable
        )
        nominal, *_ = predictions
        if not math.isfinite(nominal.error):
            return 50.0 + nominal.pole
        grid = np.geomspace(_MIN_FREQUENCY, 0.999 * math.pi / self.timing.tick, _NUM_FREQUENCIES)
        S = lifted.sensitivity(np.exp(1j * grid * self.timing.tick))
        delay = float(fast_margins(1.0 / S - 1.0, grid).delay)
        violation += max(0.0, np.abs(S).max() / self.chain_limits.sensitivity - 1.0)
        violation += max(0.0, 1.0 - delay / self.chain_limits.delay)
        violation += max(0.0, math.log(nominal.command / self.max_command))
        return float(
            0.5 * math.log(np.mean([prediction.error**2 for prediction in stable])) + _PENALTY_WEIGHT * violation
        )

    def improved(self) -> "_LqgSearch":
        """Return the search after a local search for better parameters, which starts from the present ones."""
        logs = np.log(self.values)
        steps = np.eye(len(logs))
        with single_threaded_blas():
            # The weight of the command has the largest influence, so a coarse search over decades of this weight comes
            # first.
            start = min((logs + shift * steps[0] for shift in np.arange(-7.0, 7.1, 1.75)), key=self.cost_of)
            others = (
                start + sign * step for step, sign in zip(0.8 * steps, itertools.cycle((-1.0, 1.0)), strict=False)
            )
            options = {"maxfev": _MAX_EVALUATIONS, "initial_simplex": np.vstack([start, *others])}
            best = scipy.optimize.minimize(self.cost_of, start, method="Nelder-Mead", options=options)
        return replace(self, values=np.exp(best.x).tolist(), cost=float(best.fun))

    def result(self) -> tuple[Any, tuple[AxisPrediction, ...]]:
        """Return the scenario block of the axis with the present parameters, and the performance for each plant."""
        axis = self.axis_of(*(float(f"{number:.4g}") for number in self.values))
        loop = self.loop_of(axis)
        predictions = tuple(predict_performance(loop, actual_plant, self.timing) for actual_plant in self.actual_plants)
        if not math.isfinite(predictions[0].error):
            raise InputError(
                f"no LQG design is stable for the nominal plant: the best design has a pole of magnitude"
                f" {predictions[0].pole:.4f}"
            )
        return axis, predictions

    def with_tighter_limits(self, limits: LqgLimits, exact: Sequence[Margins | None]) -> "_LqgSearch":
        """Return this search if the exact loops satisfy the limits; otherwise return a search with tighter limits.

        Args:
            limits: limits for the exact loops.
            exact: margins of the loop through each command signal in the exact linear model; None for a signal without
                feedback.
        """
        loop_margins = [margins for margins in exact if margins is not None]
        sensitivity = max((margins.sensitivity for margins in loop_margins), default=0.0)
        delay = min((margins.delay for margins in loop_margins), default=math.inf)
        chain_limits = self.chain_limits
        if sensitivity > limits.sensitivity:
            tightened = _TIGHTENING * chain_limits.sensitivity * limits.sensitivity / sensitivity
            chain_limits = chain_limits._replace(sensitivity=tightened)
        if delay < limits.delay:
            chain_limits = chain_limits._replace(delay=chain_limits.delay * limits.delay / (_TIGHTENING * delay))
        return self if chain_limits == self.chain_limits else replace(self, chain_limits=chain_limits)


def _common_fields(
    command_weight: float, command_noise: float, first: float, second: float, time: float, position_noise: float
) -> dict[str, Any]:
    """Return the control fields that all axes share.

    Args:
        command_weight: weight of the command in the cost of the regulator.
        command_noise: assumed noise of the command.
        first: standard deviation of the first, nearly constant disturbance, m/s².
        second: standard deviation of the second disturbance, m/s².
        time: correlation time of the second disturbance, s.
        position_noise: standard deviation of the measured position, m.
    """
    return {
        "first": ColouredNoise(deviation=first, time=_CONSTANT_TIME),
        "second": ColouredNoise(deviation=second, time=float(f"{time:.3g}")),
        "command_noise": command_noise,
        "position_noise": float(f"{position_noise:.4g}"),
        "command_weight": command_weight,
    }


def lateral_plant_model(plant: Plant, conditions: Conditions) -> ContinuousModel:
    """Return the model of a plant along x or y, a chain of lags and integrators, with its disturbances."""
    lag = plant.lag if plant.has_series_lag or plant.response is None else None
    return lateral_model(lag, plant.response, _disturbing(conditions.lateral, ChainNoise(conditions.bias, _BIAS_TIME)))


def vertical_plant_model(plant: Plant, conditions: Conditions) -> ContinuousModel:
    """Return the model of a plant along z, a chain of lags and integrators, with its disturbances."""
    model = vertical_model(plant.lag, _disturbing(conditions.vertical, None))
    return model._replace(B=plant.thrust_gain * model.B)


def _disturbing(conditions: DisturbanceStatistics, bias: ChainNoise | None) -> Disturbances:
    return Disturbances(
        ChainNoise(conditions.mean, _CONSTANT_TIME), ChainNoise(conditions.deviation, conditions.time), bias, 0.0
    )


def _yaw_pd(scenario: Scenario) -> YawPd:
    """Return a yaw PD, designed as for a cascade."""
    gains: Any = design_cascade(median_scenario(scenario)).loops["yaw"].gains
    return YawPd(k_p=gains.k_p, k_d=gains.k_d)


def _rotor_time_constant(scenario: Scenario) -> float:
    """Return the time constant of the rotors, s: the geometric mean of the values for acceleration and braking."""
    up, down = scenario.vehicle.rotor_time_constant, scenario.vehicle.rotor_time_constant_down
    return float(f"{up if down is None else math.sqrt(up * down):.4g}")


def _thrust_gain(scenario: Scenario) -> float:
    """Return the ratio of actual to nominal thrust changes, from the response of the height to a slow command."""
    period, mass, slow = scenario.laboratory.command_link.period, scenario.nominal.mass, 2.0
    plant = laboratory_plant(scenario, vehicle="actual").system
    command = f"{scenario.laboratory.autopilot.command}.thrust"
    response = plant.between([command], ["measurement.z"]).response(np.exp([1j * slow * period])).item()
    return float(f"{abs(response) * mass * slow**2 * math.hypot(1.0, slow * _rotor_time_constant(scenario)):.3g}")


def _latency_frames(scenario: Scenario) -> int:
    return int(scenario.laboratory.motion_capture.latency_frames)


def _delay_ticks(scenario: Scenario) -> int:
    return int(scenario.laboratory.command_link.delay_ticks)


def _rms(quantity: Any) -> float:
    """Return the root mean square of a quantity, which may be a distribution or a number."""
    if isinstance(quantity, float):
        return quantity
    drawn = quantity.quantile((np.arange(101) + 0.5) / 101)
    return float(np.sqrt(np.mean(drawn**2)))
