"""Design of linear-quadratic-Gaussian control: the few numbers of `control.kind: lqg`, for several plants at once.

A textbook design for one plant has hardly any margin. So the numbers are those that make the mean square of the
position error least over several plants, with other lags, later frames and longer delays of the link, in the wind and
noise of the scenario, within limits on the peak sensitivity, the delay margin and the size of the commands. Each trial
is two Riccati equations, and for each plant a Lyapunov equation of the closed loop, lifted over a tick: nothing flies.
The chain of an axis is not quite the vehicle, which has drag and leans in the wind: where the whole loop breaks a limit
that the chain keeps, the chain's is narrowed, and the search goes on.
"""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import scipy

from drake_quad.control.lqg.chains import (
    AttitudeResponse,
    ChainNoise,
    ContinuousModel,
    Disturbances,
    lateral_model,
    sampled,
    sampled_noise,
    vertical_model,
)
from drake_quad.control.lqg.design import AxisLoop, Timing
from drake_quad.design.cascade import design_cascade
from drake_quad.errors import InputError
from drake_quad.flight.mission import plan_route
from drake_quad.linear.closed_loop import laboratory_plant
from drake_quad.linear.disturbances import DisturbanceStatistics, disturbance_statistics, disturbances_along
from drake_quad.linear.link_margins import link_margins
from drake_quad.linear.margins import Margins, fast_margins
from drake_quad.linear.sampled_system import SampledSystem
from drake_quad.process_settings import single_threaded_blas
from drake_quad.scenario.batch import Batch, at_quantile, middle_of
from drake_quad.scenario.controls.lqg import ColouredNoise, LateralAxis, LqgControl, VerticalAxis, YawPd
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.paths import distributions_in

# Samples in whose wind the spectra are taken, and times of correlation of what lasts for a flight and of the bias, s:
# so long that the filter takes them for constants, as an integral does.
_SAMPLES, _LASTING, _BIAS = 32, 50.0, 20.0
# Least deviations, so that a calm and ideal laboratory has a design, too: of disturbances (m/s²), of the bias (m/s⁴)
# and of the noise of position (m) and attitude (rad), half of what laboratory.yaml has.
_CALM, _UNBIASED, _SHARP, _LEVEL = 0.05, 0.5, 5e-4, 2e-3
# Assumed uncertainty of a plant without distributions: factors on the lag and on the answer, and frames or ticks.
_LAG_SPREAD, _ANSWER_SPREAD, _LATER = 1.6, 1.15, 1
# Points at which margins are looked at and the lowest frequency, rad/s; weight of what breaks a limit, of the logarithm
# of the error; evaluations of a search.
_POINTS, _SLOWEST, _PENALTY, _EVALUATIONS = 120, 0.3, 9.0, 600
# Root mean square of the command along x and y relative to the torque that it must hold. With 1, 2 and 3, designs for
# a Crazyflie crash in 17, 2.4 and 3.4 % of 1,000 flights of its bad day.
_TORQUE_HEADROOM = 2.0
# Searches until the whole loop keeps the limits, and the factor by which a broken one is narrowed besides.
_ROUNDS, _NARROWER = 5, 0.998


class LqgLimits(NamedTuple):
    """Limits of a design.

    Attributes:
        sensitivity: peak of |1 / (1 + L)|, broken where commands go over the link, of the middle plant's whole loop.
        delay: margin there, s.
        snap: root mean square of the command along x and y with torques over the link, m/s⁴; see `snap_limit`.
        acceleration: of that along z, and along x and y with an autopilot, m/s².
    """

    sensitivity: float = 3.0
    delay: float = 0.03
    snap: float = 40.0
    acceleration: float = 3.0


class Plant(NamedTuple):
    """Plant between the command and the motion of the vehicle.

    Attributes:
        lags: whether the attitude lags behind the rotors, too; not if its answer is known as a whole.
        lag: of the rotors, s.
        answer: of the attitude with an autopilot; None without one.
        latency_frames: after which a frame can be read, beside the one that it always takes.
        delay_ticks: of the link.
        thrust_gain: change of the thrust over that of its command near hover.
    """

    lags: bool
    lag: float
    answer: AttitudeResponse | None
    latency_frames: int
    delay_ticks: int
    thrust_gain: float = 1.0


class Conditions(NamedTuple):
    """Disturbances and noise of a laboratory.

    Attributes:
        lateral: disturbing acceleration along x and y.
        vertical: along z.
        bias: deviation of what turns the vehicle, m/s⁴.
        position_noise: deviation, m.
        attitude_noise: deviation, rad.
        loss_rate: share of the commands that are lost.
    """

    lateral: DisturbanceStatistics
    vertical: DisturbanceStatistics
    bias: float
    position_noise: float
    attitude_noise: float
    loss_rate: float


class Truth(NamedTuple):
    """A plant as it is, sampled at the frames, with what acts on it.

    Attributes:
        A: (n, n).
        B: (n, 1).
        C: (p, n).
        Q: (n, n) covariance of what disturbs it for a frame.
        R: (p, p) covariance of what is measured.
        plant: whose frames and commands are late.
        loss_rate: share of the commands that are lost.
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    Q: np.ndarray
    R: np.ndarray
    plant: Plant
    loss_rate: float

    @classmethod
    def of(cls, model: ContinuousModel, plant: Plant, found: Conditions, timing: Timing, gravity: float) -> "Truth":
        """Return the plant of a model, in conditions that are found."""
        noise = np.array([found.position_noise, gravity * found.attitude_noise])[: len(model.C)]
        Q = sampled_noise(model.A, model.Q, timing.frame)
        return cls(*sampled(model.A, model.B, timing.frame), model.C, Q, np.diag(noise**2), plant, found.loss_rate)


class Predicted(NamedTuple):
    """Prediction of the linear model of an axis.

    Attributes:
        error: root mean square of the position error at the ticks, m; infinite if the loop is unstable.
        command: of the command, in its unit.
        pole: size of the largest.
    """

    error: float
    command: float
    pole: float


@dataclass(frozen=True)
class LqgDesign:
    """A design.

    Attributes:
        control: as the block `control` of a scenario has it.
        plants: for which it was made, the nominal one first.
        conditions: in which they fly.
        lateral: what is predicted along x, or y, for each plant.
        vertical: along z.
    """

    control: LqgControl
    plants: tuple[Plant, ...]
    conditions: Conditions
    lateral: tuple[Predicted, ...]
    vertical: tuple[Predicted, ...]


def design_lqg(scenario: Scenario, limits: LqgLimits = LqgLimits()) -> LqgDesign:
    """Design the linear-quadratic-Gaussian control of a scenario; without an autopilot its yaw as in a cascade.

    Args:
        scenario: with or without distributions; its control does not matter.
        limits: to keep to.

    Raises:
        InputError: no design is stable for the nominal plant, or there is none for the yaw.
    """
    on_board = scenario.laboratory.autopilot.controls_attitude
    plants, found = plants_of(scenario), conditions_of(scenario)
    nominal, *_ = plants
    timings = believed_timings(scenario, plants)
    gravity = scenario.nominal.gravity

    def lateral_axis(weight: float, noise: float, first: float, second: float, bias: float, seen: float) -> LateralAxis:
        answer = nominal.answer
        return LateralAxis(
            lag=nominal.lag if nominal.lags else None,
            natural_frequency=answer.natural_frequency if answer else None,
            damping=answer.damping if answer else None,
            bias=ColouredNoise(deviation=bias, time=_BIAS),
            attitude_noise=float(f"{seen * found.attitude_noise:.4g}"),
            **_common(weight, noise, first, second, found.lateral.time, found.position_noise),
        )

    def vertical_axis(weight: float, noise: float, first: float) -> VerticalAxis:
        # The thrust of the lateral axes is the weight less the estimated disturbance along z. With a larger deviation
        # the height is held a little better, but the estimate shakes, and with it the commanded tilt.
        second = float(f"{found.vertical.deviation:.4g}")
        common = _common(weight, noise, first, second, found.vertical.time, found.position_noise)
        return VerticalAxis(lag=nominal.lag, **common)

    # Where the search begins: the numbers of controllers/lqg.yaml, or as much for a command that is an acceleration.
    weight, noise = (1e-2, 0.3) if on_board else (1e-5, 3.3)

    def search_along_x(timing: Timing) -> _LqgSearch:
        return _LqgSearch(
            lateral_axis,
            lambda axis: axis.loop(timing, gravity),
            [Truth.of(lateral_truth(plant, found), plant, found, timing, gravity) for plant in plants],
            limits.acceleration if on_board else snap_limit(limits, found),
            timing,
            (weight, noise, max(found.lateral.mean, _CALM), 0.8, max(found.bias, 5.0), 0.5),
            limits,
        )

    lateral = min((search_along_x(timing).advanced() for timing in timings), key=lambda search: search.cost)
    timing = lateral.timing
    vertical = _LqgSearch(
        vertical_axis,
        lambda axis: axis.loop(timing, gravity),
        [Truth.of(vertical_truth(plant, found), plant, found, timing, gravity) for plant in plants],
        limits.acceleration,
        timing,
        (1e-3, 0.03, max(found.vertical.mean, _CALM)),
        limits,
    ).advanced()
    yaw = None if on_board else _yaw(scenario)
    for _ in range(_ROUNDS):
        (along, of_lateral), (up, of_vertical) = lateral.found(), vertical.found()
        control = LqgControl(
            kind="lqg",
            delay_ticks=timing.delay_ticks,
            lateral=along,
            vertical=up,
            yaw=yaw,
            **dict(scenario.control.limits()),
        )
        design = LqgDesign(control, plants, found, of_lateral, of_vertical)
        thrust, roll, pitch, _ = link_margins(middle_of(scenario.model_copy(update={"control": control}))).values()
        narrowed = lateral.narrowed(limits, (roll, pitch)), vertical.narrowed(limits, (thrust,))
        if narrowed == (lateral, vertical):
            break
        lateral, vertical = (search.advanced() for search in narrowed)
    return design


def plants_of(scenario: Scenario) -> tuple[Plant, ...]:
    """Return the plants for which a controller of a scenario shall be good: the middle one, and the corners around it.

    Where the scenario has a distribution, the corners are its tenth and its last; else they are what a model that is
    written as one number may be off by.
    """
    middle, low, high = (at_quantile(scenario, share) for share in (0.5, 0.1, 0.9))
    varied = distributions_in(scenario)

    def ends(path: str, number: Callable[[Scenario], Any], least: Any, most: Any) -> tuple[Any, Any]:
        return (number(low), number(high)) if path in varied else (least, most)

    lag, frames, ticks = _lag(middle), _latency(middle), _delay(middle)
    lags = ends("vehicle.rotor_time_constant", _lag, 1.0 / _LAG_SPREAD * lag, _LAG_SPREAD * lag)
    latencies = ends("laboratory.motion_capture.latency_frames", _latency, frames, frames + _LATER)
    delays = ends("laboratory.command_link.delay_ticks", _delay, ticks, ticks + _LATER)
    autopilot = middle.laboratory.autopilot
    answer = autopilot.answer()
    middle_plant = Plant(not autopilot.models_vehicle, lag, answer, frames, ticks, _thrust_gain(middle))
    spread = zip(lags, (_ANSWER_SPREAD, 1.0 / _ANSWER_SPREAD), strict=True)
    corners = [
        middle_plant._replace(
            lag=lag,
            answer=answer and answer._replace(natural_frequency=factor * answer.natural_frequency),
            latency_frames=latency,
            delay_ticks=delay,
        )
        for (lag, factor), (latency, delay) in itertools.product(spread, zip(latencies, delays, strict=True))
    ]
    return middle_plant, *corners


def snap_limit(limits: LqgLimits, found: Conditions) -> float:
    """Return the root mean square that a command over the link along x and y may have, m/s⁴.

    It is that of the limits, or a multiple of the torque that the command has to hold if that is more. The torque of a
    centre of mass beside the rotors' middle turns a vehicle of mass m and inertia I by m g r / I. A small vehicle has a
    large mass over its inertia: 0.3 mm turn a Crazyflie by 5 rad/s², five times as much as the paper's vehicle.
    """
    return max(limits.snap, _TORQUE_HEADROOM * found.bias)


def believed_timings(scenario: Scenario, plants: Sequence[Plant]) -> list[Timing]:
    """When things happen, with the delays that may be believed: the mean of the plants', and the next later tick.

    Of a mean between two ticks the later one has more phase, the nearer one less to wait for.
    """
    cameras, link = scenario.laboratory.motion_capture, scenario.laboratory.command_link
    delays = [plant.delay_ticks + plant.latency_frames * cameras.period / link.period for plant in plants]
    mean = sum(delays) / len(delays)
    return [Timing(cameras.period, link.period, ticks) for ticks in sorted({round(mean), math.ceil(mean)})]


def conditions_of(scenario: Scenario) -> Conditions:
    """Return the wind, the noise and the faults in which a scenario is flown, from samples along its plan."""
    batch = Batch.draw(scenario, range(_SAMPLES))
    disturbed = disturbances_along(batch, plan_route(scenario))
    x, y, z = disturbed.acceleration
    gravity = scenario.nominal.gravity
    cameras, link = scenario.laboratory.motion_capture, scenario.laboratory.command_link
    position, attitude = (_size(noise) for noise in (cameras.position_noise, cameras.attitude_noise))
    lateral, vertical = (
        each._replace(deviation=max(each.deviation, _CALM), time=max(each.time, 5.0 * link.period))
        for each in (
            disturbance_statistics(np.array([x, y]), disturbed.step),
            disturbance_statistics(z, disturbed.step),
        )
    )
    bias = gravity * float(np.sqrt((disturbed.turning**2).mean()))
    if scenario.laboratory.autopilot.models_vehicle:
        bias = 0.0  # the attitude answers as a whole
    return Conditions(
        lateral,
        vertical,
        max(bias, _UNBIASED),
        max(position, _SHARP),
        max(attitude, _LEVEL),
        _size(link.loss_rate),
    )


def predicted(loop: AxisLoop, truth: Truth, timing: Timing) -> Predicted:
    """Return the prediction of the linear model of an axis for a plant, which may differ from the believed one."""
    (answer,) = _Lifted.of(loop, [truth], timing).predicted()
    return answer


def loop_transfer(loop: AxisLoop, truth: Truth, timing: Timing) -> SampledSystem:
    """L of an axis, broken where commands go over the link."""
    lifted = _Lifted.of(loop, [truth], timing)
    names = tuple(str(i) for i in range(lifted.command.shape[1]))
    D = np.zeros((1, 1))
    return SampledSystem(lifted.opened[0], lifted.lost[0], -lifted.command, D, timing.tick, names, ("u",), ("loop",))


@dataclass(frozen=True)
class _Lifted:
    """Loops of an axis around k plants over a tick: the chain as it is, frames under way, the filter, and commands.

    All plants have as many states as the one with the latest frames and commands.

    Attributes:
        A: (k, n, n) of the closed loops.
        Q: (k, n, n) covariance of the noise of a tick.
        command: (k, n) rows of what is sent.
        change: (k, n) rows of its change.
        lost: (k, n, 1) column of what is sent in place of it.
        opened: (k, n, n) A of the loops from what goes over the link to minus what is sent.
        loss_rates: (k,) shares of the commands that are lost.
    """

    A: np.ndarray
    Q: np.ndarray
    command: np.ndarray
    change: np.ndarray
    lost: np.ndarray
    opened: np.ndarray
    loss_rates: np.ndarray

    @classmethod
    def of(cls, loop: AxisLoop, truths: Sequence[Truth], timing: Timing) -> "_Lifted":
        """Return the loops of one filter and regulator around plants."""
        nominal, plants = truths[0], [truth.plant for truth in truths]
        n, p, m, believed = len(nominal.A), len(nominal.C), len(loop.K), len(loop.K_pending)
        frames, ticks = (max(late) + 1 for late in zip(*((each.latency_frames, each.delay_ticks) for each in plants)))
        ends = np.cumsum((0, n, p * frames, m, believed + 1, ticks))
        chain, line, filtered, told, sent = (slice(*pair) for pair in itertools.pairwise(ends.tolist()))
        size = int(ends[-1])
        # The filter and the line of frames are updated at every frame.
        F, H, L, gain = (np.array(part) for part in (loop.A, loop.B, loop.L, loop.K))
        C = np.eye(m)[[loop.K._fields.index(name) for name in ("position", "thrust")[:p]]]
        update, camera, moved = (np.tile(np.eye(size), (len(truths), 1, 1)) for _ in range(3))
        noise = np.zeros_like(update)
        update[:, filtered, filtered] = F @ (np.eye(m) - L.T @ C)
        update[:, filtered, told.stop - 1] = H
        camera[:, line, line] = np.eye(p * frames, k=-p)
        arriving = slice(line.start, line.start + p)
        for i, (truth, plant) in enumerate(zip(truths, plants, strict=True)):
            read = line.start + p * plant.latency_frames
            update[i, filtered, read : read + p] = F @ L.T
            camera[i, arriving, chain] = truth.C
            moved[i, chain, chain], moved[i, chain, sent.start + plant.delay_ticks] = truth.A, truth.B.ravel()
            noise[i, chain, chain], noise[i, arriving, arriving] = truth.Q, truth.R
        # The queues of commands for the filter and for the vehicle, newest first, advance at each tick.
        row = np.zeros(size)
        row[filtered] = -gain
        row[told.start : told.stop - 1] = -np.array(loop.K_pending)[::-1]
        shifted = np.eye(size)
        for part in (told, sent):
            shifted[part, part] = np.eye(part.stop - part.start, k=-1)
        shifted[told.start] = row
        into = np.zeros((size, 1))
        into[sent.start] = 1.0
        seen = moved @ camera
        frame, opened, column = seen @ update, seen @ shifted @ update, seen @ into
        asked = row @ update
        closed, Q = opened + column @ asked[:, np.newaxis], noise
        for _ in range(round(timing.tick / timing.frame) - 1):
            closed, opened, column = frame @ closed, frame @ opened, frame @ column
            Q = frame @ Q @ frame.transpose(0, 2, 1) + noise
        before = np.zeros(size)
        before[sent.start] = 1.0
        return cls(closed, Q, asked, asked - before, column, opened, np.array([each.loss_rate for each in truths]))

    def predicted(self) -> list[Predicted]:
        """See the function of that name, for each plant; it hears the last command once more where one is lost."""
        poles = np.abs(np.linalg.eigvals(self.A)).max(axis=1)
        error, command = np.full((2, len(poles)), np.inf)
        stable = np.flatnonzero(poles < 1.0 - 1e-9)
        lost = self.lost[stable]
        noise = np.stack([self.Q[stable], lost @ lost.transpose(0, 2, 1)])
        # Each array is (2, stable plants): for the noise of a tick, and for unit noise in place of the command.
        X = _stationary_covariance(self.A[stable], noise)
        errors, commands, changes = X[..., 0, 0], _variance(self.command[stable], X), _variance(self.change[stable], X)
        # A lost command is noise of the size of its change, to which that noise adds.
        echo = self.loss_rates[stable] * changes[1]
        heard = echo < 0.9
        size = (self.loss_rates[stable] * changes[0])[heard] / (1.0 - echo[heard])
        for total, sizes in ((error, errors), (command, commands)):
            own, one = sizes[:, heard]
            total[stable[heard]] = np.sqrt(own + size * one)
        return [Predicted(*each) for each in zip(error.tolist(), command.tolist(), poles.tolist(), strict=True)]

    def sensitivity(self, z: np.ndarray) -> np.ndarray:
        """Return 1 / (1 + L) of the first plant at points of the z-plane, as det(zI - A_opened) / det(zI - A)."""
        zeros, poles = (np.linalg.eigvals(each[0]) for each in (self.opened, self.A))
        return ((z[:, np.newaxis] - zeros) / (z[:, np.newaxis] - poles)).prod(axis=1)


def _stationary_covariance(A: np.ndarray, Q: np.ndarray) -> np.ndarray:
    """Return X = A X Aᵀ + Q of stable A (k, n, n), for (..., k, n, n) covariances Q.

    The sum over A^i Q Aᵀ^i is doubled until nothing is added (R. A. Smith, "Matrix equation XA + BX = C", 1968). For
    stacks of small matrices that takes a fraction of the time of Schur forms.
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
    """Return (..., k) variances of rows (k, n) of states whose covariances are X (..., k, n, n)."""
    return np.einsum("ki,...kij,kj->...k", row, X, row)


@dataclass(frozen=True, eq=False)
class _LqgSearch:
    """The search for the numbers of an axis.

    Attributes:
        axis_of: the axis that has some numbers.
        loop_of: filter and regulator of an axis.
        truths: of the plants, the nominal one first.
        most: the root mean square of the command is to be at most this.
        timing: of frames and ticks.
        numbers: the best so far, or where to begin.
        allowed: limits of the loop of the nominal chain.
        cost: of these numbers.
    """

    axis_of: Callable[..., Any]
    loop_of: Callable[[Any], AxisLoop]
    truths: Sequence[Truth]
    most: float
    timing: Timing
    numbers: Sequence[float]
    allowed: LqgLimits
    cost: float = math.inf

    def cost_of(self, logs: np.ndarray) -> float:
        """Return the logarithm of the error, and a penalty for what breaks a limit, of numbers by their logarithms."""
        try:
            loop = self.loop_of(self.axis_of(*np.exp(logs).tolist()))
        except (np.linalg.LinAlgError, ValueError):
            return 1e3
        lifted = _Lifted.of(loop, self.truths, self.timing)
        answers = lifted.predicted()
        stable = [answer for answer in answers if math.isfinite(answer.error)]
        broken = sum(5.0 + 20.0 * max(answer.pole - 1.0, 0.0) for answer in answers if answer not in stable)
        first, *_ = answers
        if not math.isfinite(first.error):
            return 50.0 + first.pole
        grid = np.geomspace(_SLOWEST, 0.999 * math.pi / self.timing.tick, _POINTS)
        S = lifted.sensitivity(np.exp(1j * grid * self.timing.tick))
        delay = float(fast_margins(1.0 / S - 1.0, grid).delay)
        broken += max(0.0, np.abs(S).max() / self.allowed.sensitivity - 1.0)
        broken += max(0.0, 1.0 - delay / self.allowed.delay)
        broken += max(0.0, math.log(first.command / self.most))
        return float(0.5 * math.log(np.mean([answer.error**2 for answer in stable])) + _PENALTY * broken)

    def advanced(self) -> "_LqgSearch":
        """Return the search with the numbers of the lowest cost that it finds, starting from its present numbers."""
        logs = np.log(self.numbers)
        first, *_ = steps = np.eye(len(logs))
        with single_threaded_blas():
            # The weight of the command decides most: its best decade first.
            begin = min((logs + shift * first for shift in np.arange(-7.0, 7.1, 1.75)), key=self.cost_of)
            signed = (
                begin + sign * step for step, sign in zip(0.8 * steps, itertools.cycle((-1.0, 1.0)), strict=False)
            )
            options = {"maxfev": _EVALUATIONS, "initial_simplex": np.vstack([begin, *signed])}
            best = scipy.optimize.minimize(self.cost_of, begin, method="Nelder-Mead", options=options)
        return replace(self, numbers=np.exp(best.x).tolist(), cost=float(best.fun))

    def found(self) -> tuple[Any, tuple[Predicted, ...]]:
        """Return the axis with these numbers, and its predicted performance for each plant."""
        axis = self.axis_of(*(float(f"{number:.4g}") for number in self.numbers))
        loop = self.loop_of(axis)
        answers = tuple(predicted(loop, truth, self.timing) for truth in self.truths)
        if not math.isfinite(answers[0].error):
            raise InputError(f"no design of this kind is stable: at best there is a pole of size {answers[0].pole:.4f}")
        return axis, answers

    def narrowed(self, limits: LqgLimits, exact: Sequence[Margins | None]) -> "_LqgSearch":
        """This search if the whole loop keeps the limits, else one with limits that much narrower."""
        looped = [margins for margins in exact if margins is not None]
        sensitivity = max((margins.sensitivity for margins in looped), default=0.0)
        delay = min((margins.delay for margins in looped), default=math.inf)
        allowed = self.allowed
        if sensitivity > limits.sensitivity:
            narrower = _NARROWER * allowed.sensitivity * limits.sensitivity / sensitivity
            allowed = allowed._replace(sensitivity=narrower)
        if delay < limits.delay:
            allowed = allowed._replace(delay=allowed.delay * limits.delay / (_NARROWER * delay))
        return self if allowed == self.allowed else replace(self, allowed=allowed)


def _common(
    weight: float, noise: float, first: float, second: float, time: float, position_noise: float
) -> dict[str, Any]:
    """Return the fields that all axes have."""
    return {
        "first": ColouredNoise(deviation=first, time=_LASTING),
        "second": ColouredNoise(deviation=second, time=float(f"{time:.3g}")),
        "command_noise": noise,
        "position_noise": float(f"{position_noise:.4g}"),
        "command_weight": weight,
    }


def lateral_truth(plant: Plant, found: Conditions) -> ContinuousModel:
    """Return the chain along x, or y, of a plant and what disturbs it."""
    lag = plant.lag if plant.lags or plant.answer is None else None
    return lateral_model(lag, plant.answer, _disturbing(found.lateral, ChainNoise(found.bias, _BIAS)))


def vertical_truth(plant: Plant, found: Conditions) -> ContinuousModel:
    """Return the chain along z of a plant and what disturbs it."""
    model = vertical_model(plant.lag, _disturbing(found.vertical, None))
    return model._replace(B=plant.thrust_gain * model.B)


def _disturbing(found: DisturbanceStatistics, bias: ChainNoise | None) -> Disturbances:
    return Disturbances(ChainNoise(found.mean, _LASTING), ChainNoise(found.deviation, found.time), bias, 0.0)


def _yaw(scenario: Scenario) -> YawPd:
    """Return the yaw's PD, as a cascade has it."""
    gains: Any = design_cascade(middle_of(scenario)).loops["yaw"].gains
    return YawPd(k_p=gains.k_p, k_d=gains.k_d)


def _lag(scenario: Scenario) -> float:
    """Return the lag of the rotors; the geometric mean of those upwards and downwards if they differ, s."""
    up, down = scenario.vehicle.rotor_time_constant, scenario.vehicle.rotor_time_constant_down
    return float(f"{up if down is None else math.sqrt(up * down):.4g}")


def _thrust_gain(scenario: Scenario) -> float:
    """Return the actual over the believed gain of the thrust, from the response of the height to a slow command."""
    period, mass, slow = scenario.laboratory.command_link.period, scenario.nominal.mass, 2.0
    plant = laboratory_plant(scenario, vehicle="actual").system
    command = f"{scenario.laboratory.autopilot.command}.thrust"
    answer = plant.between([command], ["measurement.z"]).response(np.exp([1j * slow * period])).item()
    return float(f"{abs(answer) * mass * slow**2 * math.hypot(1.0, slow * _lag(scenario)):.3g}")


def _latency(scenario: Scenario) -> int:
    return int(scenario.laboratory.motion_capture.latency_frames)


def _delay(scenario: Scenario) -> int:
    return int(scenario.laboratory.command_link.delay_ticks)


def _size(quantity: Any) -> float:
    """Return the root mean square of a quantity that may be a distribution."""
    if isinstance(quantity, float):
        return quantity
    drawn = quantity.quantile((np.arange(101) + 0.5) / 101)
    return float(np.sqrt(np.mean(drawn**2)))
