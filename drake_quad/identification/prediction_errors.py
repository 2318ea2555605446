"""One-step predictions of what is measured, by an extended Kalman filter in each window of a log.

The state of the filter are rows of the vehicle's and of a disturbance d, a force and a turning that forget. With Δ
between measurements

    x⁺ = f(x, d, u; θ),   d⁺ = exp(-Δ/T) d + σ_d √(1 - exp(-2Δ/T)) w,   y = h(x, d; θ) + σ_y w

with w white and of unit variance. What a filter did not foresee, e = y - ŷ, is white if model and noise are right, and
owes nothing to the past: this is why parameters from it are right though a controller feeds what is measured back
into the commands, which parameters from simulated windows with free initial states are not (L. Ljung, System
Identification, 2nd ed., 1999, §13.4).

Gains are those of the base: of one set of parameters, around whose predictions the filter linearises. Other sets of
parameters are then predicted with the same gains, so that predictions are smooth in the parameters.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from drake_quad.identification.logs.record import FlightRecord
from drake_quad.identification.model import (
    NUM_BODY,
    NUM_DISTURBANCE,
    STATE_ROWS,
    Disturbance,
    DisturbanceFrame,
    LogModel,
    ModelFlight,
    WindowInputs,
)
from drake_quad.identification.windows import LogWindow, WindowSizes, within_half_a_turn

FORCE = "specific_force"
# Roll, pitch and yaw among the rows of the state.
_ATTITUDE = slice(STATE_ROWS["attitude"], STATE_ROWS["attitude"] + 3)
# Steps of the differences that linearise the filter, in the unit of each row of the state.
_STEPS = np.append(np.repeat([1e-4, 1e-5, 1e-4, 1e-4, 1e-3, 1e-2], 3), [1e-3, 1e-3])
# Standard deviation of the constant part of the horizontal force, m/s²: that of a wind that is not logged.
_CONSTANT_FORCE = 1.0
# What is not known at the beginning of a window of a row that is not measured: position (m), attitude (rad), velocity
# (m/s), body rates (rad/s).
_UNKNOWN = np.repeat([1.0, 0.5, 2.0, 10.0], 3)


class Output(NamedTuple):
    """One column of a signal of a record."""

    signal: str
    column: int


class PredictionNoise(NamedTuple):
    """Standard deviations.

    Attributes:
        measured: (m,) of each output, in its unit.
        disturbance: (6,) σ_d, m/s² and rad/s².
        memory: (6,) T of the disturbance, s.
    """

    measured: np.ndarray
    disturbance: np.ndarray
    memory: np.ndarray

    @classmethod
    def of(cls, values: np.ndarray) -> "PredictionNoise":
        """The noise of (m + 12,) numbers in a row."""
        return cls(values[:-12], values[-12:-6], values[-6:])

    @property
    def force(self) -> np.ndarray:
        """(3,) standard deviations of the disturbing force over mass, m/s²."""
        force, _ = np.split(self.disturbance, 2)
        return force

    def mean_force(self, duration: float) -> np.ndarray:
        """Return the standard deviations (3,) of means of the disturbing force over mass, m/s².

        For a force with the correlation exp(-|t| / T), in a mean over a duration of d T, the variance is
        2 (d - 1 + exp(-d)) / d² of that of the force.

        Args:
            duration: duration over which the force is averaged, s.
        """
        ratio = duration / self.memory[:3]
        return np.asarray(self.force * np.sqrt(2.0 * (ratio - 1.0 + np.exp(-ratio))) / ratio)


class Gains(NamedTuple):
    """What a filter does at each of T measurements in W windows, and what it expects.

    Attributes:
        gain: (T, n, m, W).
        whitening: (T, W, m, m) the inverse of the Cholesky factor of the covariance of what it does not foresee.
        transition: (T, W, n, n) derivative of the next state by this one.
        output: (T, W, m, n) derivative of the outputs by the state.
        errors: (T, m, W) what it did not foresee.
        disturbance: (T, n, W) what is expected of the disturbance in the next state; 0 in its other rows.
        beginning: (W, n, n) covariance of the state that it begins with.
        handed_on: (W, n, n) covariance where the next window begins.
    """

    gain: np.ndarray
    whitening: np.ndarray
    transition: np.ndarray
    output: np.ndarray
    errors: np.ndarray
    disturbance: np.ndarray
    beginning: np.ndarray
    handed_on: np.ndarray


class WindowBeginnings(NamedTuple):
    """What filters begin with, to first order in the parameters.

    Attributes:
        state: (NUM_BODY + NUM_DISTURBANCE, W).
        slopes: (NUM_BODY + NUM_DISTURBANCE, p, W) by the parameters.
        parameters: (p,) at which that is so.
        covariance: (W, n, n); that of `known` windows counts, the others know little.
        known: (W,) True for those that go on where another one was.
    """

    state: np.ndarray
    slopes: np.ndarray
    parameters: np.ndarray
    covariance: np.ndarray
    known: np.ndarray


class Predictor:
    """Predictor of the measurements in windows of records.

    Args:
        model: model of the vehicle.
        records: records that contain the windows.
        windows: W windows of the records.
        sizes: sizes of the windows.
        outputs: m columns of the records that are predicted.
        split: number of model steps per sample.
        longest: largest possible delay, s.
    """

    def __init__(
        self,
        model: LogModel,
        records: Sequence[FlightRecord],
        windows: Sequence[LogWindow],
        sizes: WindowSizes,
        outputs: Sequence[Output],
        *,
        split: int = 1,
        longest: float = 0.05,
    ) -> None:
        self.model, self.windows, self.sizes, self.outputs, self.split = model, windows, sizes, outputs, split
        self.inputs = WindowInputs.of(records, model, windows, sizes, split=split, max_delay=longest)
        index = np.arange(-sizes.settle, sizes.length)
        self.counted = index >= 0
        self.measured = np.stack(
            [
                np.stack(
                    [
                        records[number].of(signal)[np.minimum(start + index, len(records[number].time) - 1), column]
                        for number, start in windows
                    ],
                    axis=1,
                )
                for signal, column in outputs
            ],
            axis=1,
        )
        signals = {signal for signal, _ in outputs}
        self._angles = np.array([signal == "attitude" for signal, _ in outputs])
        # Of what is not measured and decides nothing that is: position and yaw.
        self.free = _free_rows(signals, model.frame)
        p = len(model.names)
        state, n, W = self._start(records, index[0]), len(self.free), len(windows)
        slopes, nothing = np.zeros((NUM_BODY + NUM_DISTURBANCE, p, W)), np.zeros((W, n, n))
        self.beginnings = WindowBeginnings(state, slopes, np.zeros(p), nothing, np.zeros(W, dtype=bool))
        # Windows that go on where the one before them ends.
        self._follows = np.array(
            [i > 0 and windows[i - 1] == (number, start - sizes.length) for i, (number, start) in enumerate(windows)]
        )

    @property
    def alike(self) -> np.ndarray:
        """(m + 12,) which numbers of the noise are one: those of a direction along x and along y, and all of a pose."""
        shared = {"position": (0, 0, 0), "attitude": (0, 0, 0)}
        names = [f"{signal}{shared.get(signal, (0, 0, 2))[column]}" for signal, column in self.outputs]
        names += [
            f"{what}{axis}" for what in ("force", "turning", "force memory", "turning memory") for axis in (0, 0, 2)
        ]
        return np.unique(names, return_inverse=True)[1]

    @property
    def period(self) -> float:
        """Between measurements, s."""
        return self.split * self.inputs.period

    @property
    def duration(self) -> float:
        """Duration of all windows together, s."""
        return len(self.windows) * self.sizes.length * self.period

    def _start(self, records: Sequence[FlightRecord], first: int) -> np.ndarray:
        """(NUM_BODY + NUM_DISTURBANCE, W) where the filters begin: as measured, at rest where it is not."""
        state = np.zeros((NUM_BODY + NUM_DISTURBANCE, len(self.windows)))
        for signal, row in STATE_ROWS.items():
            for w, (number, start) in enumerate(self.windows):
                values = getattr(records[number], signal)
                if values is not None:
                    state[row : row + 3, w] = values[start + first]
        return state

    def _fly(self, parameters: np.ndarray) -> tuple[ModelFlight, np.ndarray]:
        flown = ModelFlight(self.model, parameters, self.inputs, self.split * self.sizes.warm_up)
        state, slopes, own, _, _ = self.beginnings
        return flown, state[:, None, :] + np.einsum("rpw,kp->rkw", slopes, parameters - own)

    def hand_on(self, states: np.ndarray, slopes: np.ndarray, parameters: np.ndarray, gains: Gains) -> None:
        """Lets windows begin with what the ones before them expect there, where these go on without a gap.

        A filter whose model is good forgets slowly. One that begins anew in each window, as if nothing were known of
        the past, would take for noise what a controller made of it.

        Args:
            states: (NUM_BODY + NUM_DISTURBANCE, W) in each window where the next begins, for (p,) parameters.
            slopes: (NUM_BODY + NUM_DISTURBANCE, p, W) of them by the parameters.
            parameters: (p,).
            gains: of the filter.
        """
        then, before = np.flatnonzero(self._follows), np.flatnonzero(self._follows) - 1
        old = self.beginnings
        state, slope, covariance = old.state.copy(), old.slopes.copy(), old.covariance.copy()
        state[:, then], slope[:, :, then] = states[:, before], slopes[:, :, before]
        covariance[then] = gains.handed_on[before]
        self.beginnings = WindowBeginnings(state, slope, parameters, covariance, self._follows)

    def _predicted(self, flown: ModelFlight, state: np.ndarray) -> np.ndarray:
        """Return the predicted outputs (m, K, W)."""
        signals = {signal for signal, _ in self.outputs}
        values = {signal: state[row : row + 3] for signal, row in STATE_ROWS.items() if signal in signals}
        if FORCE in signals:
            values[FORCE] = flown.specific_force(state)
        if "attitude" in signals:
            values["attitude"] = flown.seen_attitude(state)
        return np.stack([values[signal][column] for signal, column in self.outputs])

    def _errors(self, j: int, predicted: np.ndarray) -> np.ndarray:
        """Return the prediction errors (m, K, W) of measurement j, measured minus predicted."""
        errors = self.measured[j][:, None, :] - predicted
        errors[self._angles] = within_half_a_turn(errors[self._angles])
        return errors

    def _fades(self, noise: PredictionNoise) -> np.ndarray:
        """Return the share (NUM_DISTURBANCE,) of the disturbance that is left at the next measurement."""
        return np.append(np.exp(-self.period / noise.memory), [1.0, 1.0])

    def pushes(self, noise: PredictionNoise) -> np.ndarray:
        """(n,) variance that is added to each row of the state from one measurement to the next."""
        pushed = np.zeros(NUM_BODY + NUM_DISTURBANCE)
        pushed[NUM_BODY:] = _of_disturbance(noise) ** 2 * (1.0 - self._fades(noise) ** 2)
        return pushed[self.free]

    def gains(self, parameters: np.ndarray, noise: PredictionNoise) -> Gains:
        """Return the gains of the filter for the predictions with parameters (p,)."""
        n, free = len(self.free), self.free
        steps = _STEPS[free]
        flown, state = self._fly(np.tile(parameters, (1 + n, 1)))
        covariance = beginning = self._first(noise)
        pushes, fades = np.diag(self.pushes(noise)), self._fades(noise)
        variances = np.diag(noise.measured**2)
        kept: list[tuple[np.ndarray, ...]] = []
        for j in range(len(self.measured)):
            if j == self.sizes.length:
                handed_on = covariance
            state[:, 1:] = state[:, :1]
            state[free, 1 + np.arange(n)] += steps[:, None]
            predicted = self._predicted(flown, state)
            output = ((predicted[:, 1:] - predicted[:, :1]) / steps[:, None]).transpose(2, 0, 1)
            errors = self._errors(j, predicted[:, :1])[:, 0]
            update = _updated(covariance, output, variances)
            gain = update.gain.transpose(1, 2, 0)
            state[free] += np.einsum("nmw,mw->nw", gain, errors)[:, None, :]
            for _ in range(self.split):
                flown.step(state)
            state[NUM_BODY:] *= fades[:, None, None]
            apart = state[:, 1:] - state[:, :1]
            apart[_ATTITUDE] = within_half_a_turn(apart[_ATTITUDE])
            transition = (apart[free] / steps[:, None]).transpose(2, 0, 1)
            covariance = transition @ update.covariance @ transition.transpose(0, 2, 1) + pushes
            expected = np.where(free[:, None] >= NUM_BODY, state[free, 0], 0.0)
            kept.append((gain, update.whitening, transition, output, errors, expected))
        gain, whitening, transition, output, errors, expected = (np.stack(values) for values in zip(*kept, strict=True))
        return Gains(gain, whitening, transition, output, errors, expected, beginning, handed_on)

    def _first(self, noise: PredictionNoise) -> np.ndarray:
        """(W, n, n) covariance at the beginning."""
        first = np.concatenate([_UNKNOWN, _of_disturbance(noise)]) ** 2
        _, _, _, covariance, known = self.beginnings
        return np.where(known[:, None, None], covariance, np.diag(first[self.free]))

    def errors(
        self, parameters: np.ndarray, gains: Gains, noise: PredictionNoise, *, keep: int | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """What filters with these gains do not foresee.

        Args:
            parameters: (K, p) of them.
            gains: of all.
            noise: of the disturbance, which fades.
            keep: measurement before which the state is kept; where the next window begins if not given.

        Returns:
            (T, m, K, W) errors, and (NUM_BODY + NUM_DISTURBANCE, K, W) states.
        """
        keep = self.sizes.length if keep is None else keep
        flown, state = self._fly(parameters)
        fades, found = self._fades(noise), np.empty((*self.measured.shape[:2], *state.shape[1:]))
        for j in range(len(self.measured)):
            if j == keep:
                handed_on = state.copy()
            found[j] = self._errors(j, self._predicted(flown, state))
            state[self.free] += np.einsum("nmw,mkw->nkw", gains.gain[j], found[j])
            for _ in range(self.split):
                flown.step(state)
            state[NUM_BODY:] *= fades[:, None, None]
        return found, handed_on

    def open_loop(
        self, parameters: np.ndarray, gains: Gains, noise: PredictionNoise, steps: Sequence[int]
    ) -> list[np.ndarray]:
        """Return measured states (12, 2, W) at the last measurement before each window, and after some samples.

        From this measurement on, the states follow from the commands alone: first without a disturbance, second with
        the disturbance that the filter has estimated, which fades as the noise says.

        Args:
            parameters: (p,) parameters.
            gains: gains of the filter.
            noise: noise of the filter.
            steps: numbers of samples, in increasing order, at most the length of the windows.
        """
        flown, state = self._fly(np.stack([parameters, parameters]))
        fades, found = self._fades(noise)[:, None, None], []
        for j in range(self.sizes.settle + max(steps)):
            if j - self.sizes.settle + 1 in steps:
                found.append(self._seen(state))
            if j < self.sizes.settle:
                errors = self._errors(j, self._predicted(flown, state))
                state[self.free] += np.einsum("nmw,mkw->nkw", gains.gain[j], errors)
            if j == self.sizes.settle - 1:
                found.append(self._seen(state))
                state[NUM_BODY:, 0] = 0.0
            for _ in range(self.split):
                flown.step(state)
            state[NUM_BODY:] *= fades
        return found

    def _seen(self, state: np.ndarray) -> np.ndarray:
        """Return the states (12, K, W) that are measured."""
        body = state[:NUM_BODY]
        return self.model.seen_state(body.reshape(NUM_BODY, -1).copy()).reshape(body.shape)

    def expected(
        self, gains: Gains, own: PredictionNoise, noises: Sequence[PredictionNoise], chosen: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """What filters of other noise do not foresee, to first order around the predictions of a filter.

        Args:
            gains: of the filter.
            own: its noise.
            noises: C of them.
            chosen: w windows.

        Returns:
            (T, C, w, m) errors and (T, C, w, m, m) covariances that the filters expect of them, where they count.
        """
        n, C, W = len(self.free), len(noises), len(chosen)
        covariance = np.stack([self._first(noise)[chosen] for noise in noises])
        variances = np.stack([np.diag(noise.measured**2) for noise in noises])[:, None]
        pushes = np.stack([np.diag(self.pushes(noise)) for noise in noises])[:, None]
        last = self.free >= NUM_BODY
        fading = np.ones((C, 1, n, 1))
        for c, noise in enumerate(noises):
            fading[c, 0, last, 0] = (self._fades(noise) / self._fades(own))[self.free[last] - NUM_BODY]
        both = fading * fading.swapaxes(-1, -2)
        off, errors, spreads = np.zeros((C, W, n, 1)), [], []
        for j in range(len(self.measured)):
            output, transition = gains.output[j][chosen], gains.transition[j][chosen]
            foreseen = gains.errors[j][:, chosen].T[:, :, None]
            update = _updated(covariance, output, variances)
            rest = foreseen - output @ off
            if self.counted[j]:
                errors.append(rest[..., 0])
                spreads.append(update.spread)
            step = gains.gain[j][:, :, chosen].transpose(2, 0, 1) @ foreseen
            moved = off + update.gain @ rest - step
            # What fades otherwise than in the filter at hand does so as a whole, not only in what differs.
            disturbance = gains.disturbance[j][:, chosen].T[:, :, None]
            off = fading * (transition @ moved) + (fading - 1.0) * disturbance
            covariance = both * (transition @ update.covariance @ transition.swapaxes(-1, -2)) + pushes
        return np.stack(errors), np.stack(spreads)


def _of_disturbance(noise: PredictionNoise) -> np.ndarray:
    """Return the standard deviations (NUM_DISTURBANCE,) of the disturbance."""
    return np.append(noise.disturbance, [_CONSTANT_FORCE, _CONSTANT_FORCE])


def _rows(signal: str, axes: str = "xyz") -> set[int]:
    """Return the rows of a signal in the state, along some axes."""
    return {STATE_ROWS[signal] + "xyz".index(axis) for axis in axes}


def _disturbance_rows(*names: str) -> set[int]:
    """Return the rows of parts of the disturbance in the state."""
    return {NUM_BODY + Disturbance._fields.index(name) for name in names}


def _free_rows(signals: set[str], frame: DisturbanceFrame) -> np.ndarray:
    """Return the rows of the state that the filter estimates: those that the outputs determine, or depend on."""
    constant = _disturbance_rows("constant_x", "constant_y")
    rows = set(range(NUM_BODY + NUM_DISTURBANCE))
    if signals == {"position"}:
        # The height of a vehicle that is assumed to stay level.
        rows = _rows("position", "z") | _rows("velocity", "z") | _disturbance_rows("z")
    elif "position" not in signals:
        rows -= _rows("position")
        if "attitude" not in signals:
            rows -= _rows("attitude", "z")  # yaw
        if "velocity" not in signals and FORCE not in signals:
            rows -= _rows("velocity") | _disturbance_rows("x", "y", "z") | constant
    if frame == "body":
        rows -= constant
    return np.array(sorted(rows))


class _Update(NamedTuple):
    """The gain, the covariance afterwards, and that of the errors with what whitens them."""

    gain: np.ndarray
    covariance: np.ndarray
    spread: np.ndarray
    whitening: np.ndarray


def _updated(covariance: np.ndarray, output: np.ndarray, variances: np.ndarray) -> _Update:
    """A measurement: (..., n, n) covariances before, (..., m, n) outputs, (m, m) variances."""
    seen = output @ covariance
    spread = seen @ output.swapaxes(-1, -2) + variances
    whitening = np.linalg.inv(np.linalg.cholesky(spread))
    half = whitening @ seen
    gain = half.swapaxes(-1, -2) @ whitening
    after = covariance - half.swapaxes(-1, -2) @ half
    return _Update(gain, 0.5 * (after + after.swapaxes(-1, -2)), spread, whitening)
