"""One-step predictions of the measurements of a log, by an extended Kalman filter in each window.

The state of the filter consists of rows of the vehicle's state x and of a disturbance d, a force and a torque that
follow first-order Gauss-Markov processes. Over the time Δ between two measurements,

    x⁺ = f(x, d, u; θ),   d⁺ = exp(-Δ/T) d + σ_d √(1 - exp(-2Δ/T)) w,   y = h(x, d; θ) + σ_y w,

where w is white noise of unit variance. If model and noise are correct, the prediction errors e = y - ŷ (innovations)
are white. For this reason estimates from prediction errors are consistent although a controller feeds the
measurements back into the commands. Estimates from simulated windows with free initial states are not (L. Ljung,
System Identification, 2nd ed., 1999, §13.4).

The gains belong to one set of parameters, around whose predictions the filter is linearised. The predictions for other
parameters use the same gains, so that they are smooth functions of the parameters.
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
# Rows of roll, pitch and yaw in the state.
_ATTITUDE = slice(STATE_ROWS["attitude"], STATE_ROWS["attitude"] + 3)
# Steps of the finite differences that linearise the filter, in the unit of each row of the state.
_STEPS = np.append(np.repeat([1e-4, 1e-5, 1e-4, 1e-4, 1e-3, 1e-2], 3), [1e-3, 1e-3])
# Standard deviation of the constant horizontal specific force, m/s², which represents the drag of an unlogged wind.
_CONSTANT_FORCE_DEVIATION = 1.0
# Standard deviations of the state at the start of a window: position (m), attitude (rad), velocity (m/s), body rates
# (rad/s).
_INITIAL_DEVIATIONS = np.repeat([1.0, 0.5, 2.0, 10.0], 3)
_LOGGED_ATTITUDE = 0.03  # rad, standard deviation of a logged attitude that is not predicted


class Output(NamedTuple):
    """Column of a signal of a record."""

    signal: str
    column: int


class PredictionNoise(NamedTuple):
    """Noise of the measurements, and process noise of the disturbance.

    Attributes:
        measured: (m,) standard deviation of the measurement noise of each output, in its unit.
        disturbance: (6,) stationary standard deviations σ_d of the force over mass, m/s², and of the torque over
            inertia, rad/s².
        memory: (6,) correlation times T of the disturbance, s.
    """

    measured: np.ndarray
    disturbance: np.ndarray
    memory: np.ndarray

    @classmethod
    def of(cls, values: np.ndarray) -> "PredictionNoise":
        """Return the noise whose concatenated fields are values (m + 12,)."""
        return cls(values[:-12], values[-12:-6], values[-6:])

    @property
    def force(self) -> np.ndarray:
        """Standard deviations (3,) of the disturbing force over mass, m/s²."""
        force, _ = np.split(self.disturbance, 2)
        return force

    @property
    def torque(self) -> np.ndarray:
        """Standard deviations (3,) of the disturbing torque over inertia, rad/s²."""
        _, torque = np.split(self.disturbance, 2)
        return torque

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
    """Gains of the filter at T measurements in W windows, with its n states linearised around its predictions.

    Attributes:
        gain: (T, n, m, W) Kalman gains.
        whitening: (T, W, m, m) inverse Cholesky factors of the covariances of the prediction errors.
        transition: (T, W, n, n) transition matrices to the next measurement.
        output: (T, W, m, n) derivatives of the outputs with respect to the state.
        errors: (T, m, W) prediction errors.
        disturbance: (T, n, W) predicted disturbance at the next measurement; 0 in the other rows of the state.
        initial_covariance: (W, n, n) covariance of the state at the first measurement.
        final_covariance: (W, n, n) covariance of the state where the next window starts.
    """

    gain: np.ndarray
    whitening: np.ndarray
    transition: np.ndarray
    output: np.ndarray
    errors: np.ndarray
    disturbance: np.ndarray
    initial_covariance: np.ndarray
    final_covariance: np.ndarray


class InitialStates(NamedTuple):
    """States at the first measurement of each window, to first order in the parameters.

    Attributes:
        state: (NUM_BODY + NUM_DISTURBANCE, W) states.
        slopes: (NUM_BODY + NUM_DISTURBANCE, p, W) derivatives with respect to the parameters.
        parameters: (p,) parameters for which `state` holds.
        covariance: (W, n, n) covariances of continued windows.
        continued: (W,) mask of the windows that continue the window before them. The others have a large covariance.
    """

    state: np.ndarray
    slopes: np.ndarray
    parameters: np.ndarray
    covariance: np.ndarray
    continued: np.ndarray


class Predictor:
    """Predictor of the measurements in windows of records.

    Args:
        model: model of the vehicle.
        records: records that contain the windows.
        windows: W windows of the records.
        sizes: sizes of the windows.
        outputs: m columns of the records that are predicted.
        split: number of model steps per sample.
        max_delay: largest possible delay, s.
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
        max_delay: float = 0.05,
    ) -> None:
        self.model, self.windows, self.sizes, self.outputs, self.split = model, windows, sizes, outputs, split
        self.inputs = WindowInputs.of(records, model, windows, sizes, split=split, max_delay=max_delay)
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
        self.rows = _estimated_rows(signals, model.frame)
        self._deviations = _INITIAL_DEVIATIONS.copy()
        if "attitude" not in signals and all(record.attitude is not None for record in records):
            self._deviations[_ATTITUDE] = _LOGGED_ATTITUDE
        p = len(model.names)
        state, n, W = self._measured_states(records, index[0]), len(self.rows), len(windows)
        slopes, nothing = np.zeros((NUM_BODY + NUM_DISTURBANCE, p, W)), np.zeros((W, n, n))
        self.initial = InitialStates(state, slopes, np.zeros(p), nothing, np.zeros(W, dtype=bool))
        # Windows that start where the window before them ends.
        self._follows = np.array(
            [i > 0 and windows[i - 1] == (number, start - sizes.length) for i, (number, start) in enumerate(windows)]
        )

    @property
    def noise_groups(self) -> np.ndarray:
        """Group number (m + 12,) of each noise parameter. Parameters of the same group are equal.

        All axes of a position or of an attitude form one group. So do x and y of any other signal, and of the
        disturbance.
        """
        shared = {"position": (0, 0, 0), "attitude": (0, 0, 0)}
        names = [f"{signal}{shared.get(signal, (0, 0, 2))[column]}" for signal, column in self.outputs]
        names += [
            f"{name}{axis}" for name in ("force", "torque", "force memory", "torque memory") for axis in (0, 0, 2)
        ]
        return np.unique(names, return_inverse=True)[1]

    @property
    def period(self) -> float:
        """Time between measurements, s."""
        return self.split * self.inputs.period

    @property
    def duration(self) -> float:
        """Duration of all windows together, s."""
        return len(self.windows) * self.sizes.length * self.period

    def _measured_states(self, records: Sequence[FlightRecord], first: int) -> np.ndarray:
        """Return the states (NUM_BODY + NUM_DISTURBANCE, W) at the first measurement; 0 where nothing is logged."""
        state = np.zeros((NUM_BODY + NUM_DISTURBANCE, len(self.windows)))
        for signal, row in STATE_ROWS.items():
            for w, (number, start) in enumerate(self.windows):
                values = getattr(records[number], signal)
                if values is not None:
                    state[row : row + 3, w] = values[start + first]
        return state

    def _begin(self, parameters: np.ndarray) -> tuple[ModelFlight, np.ndarray]:
        """Return the model at the first measurement, for (K, p) parameters, and its state (rows, K, W)."""
        flown = ModelFlight(self.model, parameters, self.inputs, self.split * self.sizes.warm_up)
        state, slopes, own, _, _ = self.initial
        return flown, state[:, None, :] + np.einsum("rpw,kp->rkw", slopes, parameters - own)

    def continue_windows(self, states: np.ndarray, slopes: np.ndarray, parameters: np.ndarray, gains: Gains) -> None:
        """Start each window in the final state of the window before it, if the two are adjacent.

        The filter of a good model has a long memory. If it started in each window without knowledge of the past, it
        would attribute the reaction of the controller to earlier disturbances to noise.

        Args:
            states: (NUM_BODY + NUM_DISTURBANCE, W) states in each window where the next window starts.
            slopes: (NUM_BODY + NUM_DISTURBANCE, p, W) derivatives of the states with respect to the parameters.
            parameters: (p,) parameters for which the states hold.
            gains: gains of the filter.
        """
        then, before = np.flatnonzero(self._follows), np.flatnonzero(self._follows) - 1
        old = self.initial
        state, slope, covariance = old.state.copy(), old.slopes.copy(), old.covariance.copy()
        state[:, then], slope[:, :, then] = states[:, before], slopes[:, :, before]
        covariance[then] = gains.final_covariance[before]
        self.initial = InitialStates(state, slope, parameters, covariance, self._follows)

    def _predicted(self, flown: ModelFlight, state: np.ndarray) -> np.ndarray:
        """Return the predicted outputs (m, K, W)."""
        signals = {signal for signal, _ in self.outputs}
        values = {signal: state[row : row + 3] for signal, row in STATE_ROWS.items() if signal in signals}
        if FORCE in signals:
            values[FORCE] = flown.specific_force(state)
        if "attitude" in signals:
            values["attitude"] = flown.measured_attitude(state)
        return np.stack([values[signal][column] for signal, column in self.outputs])

    def _errors(self, j: int, predicted: np.ndarray) -> np.ndarray:
        """Return the prediction errors (m, K, W) of measurement j, measured minus predicted."""
        errors = self.measured[j][:, None, :] - predicted
        errors[self._angles] = within_half_a_turn(errors[self._angles])
        return errors

    def _decay(self, noise: PredictionNoise) -> np.ndarray:
        """Return the factor (NUM_DISTURBANCE,) by which the disturbance decays until the next measurement."""
        return np.append(np.exp(-self.period / noise.memory), [1.0, 1.0])

    def process_noise(self, noise: PredictionNoise) -> np.ndarray:
        """Return the variance (n,) that is added to each row of the state between two measurements."""
        variances = np.zeros(NUM_BODY + NUM_DISTURBANCE)
        variances[NUM_BODY:] = _disturbance_deviations(noise) ** 2 * (1.0 - self._decay(noise) ** 2)
        return variances[self.rows]

    def _decay_ratios(self, own: PredictionNoise, noises: Sequence[PredictionNoise]) -> np.ndarray:
        """Return the ratios (C, 1, n, 1) of the decay of each row of the state to that in a filter."""
        ratios = np.ones((len(noises), 1, NUM_BODY + NUM_DISTURBANCE, 1))
        for c, noise in enumerate(noises):
            ratios[c, 0, NUM_BODY:, 0] = self._decay(noise) / self._decay(own)
        return ratios[:, :, self.rows]

    def gains(self, parameters: np.ndarray, noise: PredictionNoise) -> Gains:
        """Return the gains of the filter for the predictions with parameters (p,)."""
        n, rows = len(self.rows), self.rows
        steps = _STEPS[rows]
        flown, state = self._begin(np.tile(parameters, (1 + n, 1)))
        covariance = initial_covariance = self._first_covariance(noise)
        process_noise, decay = np.diag(self.process_noise(noise)), self._decay(noise)
        measurement_noise = np.diag(noise.measured**2)
        found: list[tuple[np.ndarray, ...]] = []
        for j in range(len(self.measured)):
            if j == self.sizes.length:
                final_covariance = covariance
            state[:, 1:] = state[:, :1]
            state[rows, 1 + np.arange(n)] += steps[:, None]
            predicted = self._predicted(flown, state)
            output = ((predicted[:, 1:] - predicted[:, :1]) / steps[:, None]).transpose(2, 0, 1)
            errors = self._errors(j, predicted[:, :1])[:, 0]
            update = _update(covariance, output, measurement_noise)
            gain = update.gain.transpose(1, 2, 0)
            state[rows] += np.einsum("nmw,mw->nw", gain, errors)[:, None, :]
            for _ in range(self.split):
                flown.step(state)
            state[NUM_BODY:] *= decay[:, None, None]
            differences = state[:, 1:] - state[:, :1]
            differences[_ATTITUDE] = within_half_a_turn(differences[_ATTITUDE])
            transition = (differences[rows] / steps[:, None]).transpose(2, 0, 1)
            covariance = transition @ update.covariance @ transition.transpose(0, 2, 1) + process_noise
            disturbance = np.where(rows[:, None] >= NUM_BODY, state[rows, 0], 0.0)
            found.append((gain, update.whitening, transition, output, errors, disturbance))
        stacked = (np.stack(values) for values in zip(*found, strict=True))
        return Gains._make([*stacked, initial_covariance, final_covariance])

    def _first_covariance(self, noise: PredictionNoise) -> np.ndarray:
        """Return the covariance (W, n, n) of the state at the first measurement."""
        variances = np.concatenate([self._deviations, _disturbance_deviations(noise)]) ** 2
        _, _, _, covariance, continued = self.initial
        return np.where(continued[:, None, None], covariance, np.diag(variances[self.rows]))

    def errors(
        self, parameters: np.ndarray, gains: Gains, noise: PredictionNoise, *, keep: int | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the prediction errors of filters with these gains.

        Args:
            parameters: (K, p) parameters.
            gains: gains of all filters.
            noise: noise, whose memory is that of the disturbance.
            keep: index of the measurement before which the state is returned; by default that of the measurement at
                which the next window starts.

        Returns:
            (T, m, K, W) errors, and (NUM_BODY + NUM_DISTURBANCE, K, W) states.
        """
        keep = self.sizes.length if keep is None else keep
        flown, state = self._begin(parameters)
        decay, found = self._decay(noise), np.empty((*self.measured.shape[:2], *state.shape[1:]))
        of_windows = np.ascontiguousarray(gains.gain.transpose(0, 3, 1, 2))
        for j in range(len(self.measured)):
            if j == keep:
                kept = state.copy()
            found[j] = self._errors(j, self._predicted(flown, state))
            # A matrix product for each window takes a fraction of the time of `np.einsum`.
            corrections = of_windows[j] @ np.ascontiguousarray(found[j].transpose(2, 0, 1))
            state[self.rows] += corrections.transpose(1, 2, 0)
            for _ in range(self.split):
                flown.step(state)
            state[NUM_BODY:] *= decay[:, None, None]
        return found, kept

    def open_loop(
        self, parameters: np.ndarray, gains: Gains, noise: PredictionNoise, steps: Sequence[int]
    ) -> list[np.ndarray]:
        """Return measured states (12, 2, W) at the last measurement before each window, and after each of `steps`.

        From this measurement on, the states follow from the commands alone: first without a disturbance, second with
        the disturbance that the filter has estimated, which decays with its memory.

        Args:
            parameters: (p,) parameters.
            gains: gains of the filter.
            noise: noise of the filter.
            steps: numbers of samples, in increasing order, at most the length of the windows.
        """
        flown, state = self._begin(np.stack([parameters, parameters]))
        decay, found = self._decay(noise)[:, None, None], []
        for j in range(self.sizes.settle + max(steps)):
            if j - self.sizes.settle + 1 in steps:
                found.append(self._measured(state))
            if j < self.sizes.settle:
                errors = self._errors(j, self._predicted(flown, state))
                state[self.rows] += np.einsum("nmw,mkw->nkw", gains.gain[j], errors)
            if j == self.sizes.settle - 1:
                found.append(self._measured(state))
                state[NUM_BODY:, 0] = 0.0
            for _ in range(self.split):
                flown.step(state)
            state[NUM_BODY:] *= decay
        return found

    def _measured(self, state: np.ndarray) -> np.ndarray:
        """Return the measured states (12, K, W) of states (rows, K, W) of the filter."""
        body = state[:NUM_BODY]
        return self.model.measured_state(body.reshape(NUM_BODY, -1).copy()).reshape(body.shape)

    def linearised_errors(
        self, gains: Gains, own: PredictionNoise, noises: Sequence[PredictionNoise], chosen: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the prediction errors of filters with other noise, to first order around the predictions of a filter.

        With r the ratio of the decay of the disturbance to that in the filter, with K the gain for the first noise, and
        with F = r A (I - K C), the covariance of the state for another noise changes by

            ΔP⁺ = F ΔP Fᵀ + r A K ΔR (r A K)ᵀ + Δ(r rᵀ) A P Aᵀ + ΔQ,

        where P is the covariance after the update.

        Args:
            gains: gains of the filter.
            own: noise of the filter.
            noises: a noise, and C - 1 noises that differ so little from it that a first-order expansion is accurate.
            chosen: indices of w windows.

        Returns:
            (T, C, w, m) errors and (T, C, w, m, m) covariances of these errors, for the T measurements that count.
        """
        n, C, W = len(self.rows), len(noises), len(chosen)
        ratios_of_noises = self._decay_ratios(own, noises)
        ratio, ratio_changes = _and_changes(ratios_of_noises)
        ratios, ratios_changes = _and_changes(ratios_of_noises * ratios_of_noises.swapaxes(-1, -2))
        covariance, changes = _and_changes(np.stack([self._first_covariance(noise)[chosen] for noise in noises]))
        measured, measured_changes = _and_changes(np.stack([np.diag(noise.measured**2) for noise in noises])[:, None])
        process, process_changes = _and_changes(
            np.stack([np.diag(self.process_noise(noise)) for noise in noises])[:, None]
        )
        # Indices of the noises that differ in the noise of the measurements, or in the memory of the disturbance.
        of_measured, of_memory = (np.flatnonzero(x.any(axis=(1, 2, 3))) for x in (measured_changes, ratio_changes))
        deviation, deviations, errors, covariances = np.zeros((W, n, 1)), np.zeros((C - 1, W, n, 1)), [], []
        for j in range(len(self.measured)):
            output, transition = gains.output[j][chosen], gains.transition[j][chosen]
            filter_errors = gains.errors[j][:, chosen].T[:, :, None]
            update = _update(covariance, output, measured)
            own_errors = filter_errors - output @ deviation
            cross, shift = output @ changes, output @ deviations
            spread = cross @ _transposed(output) + measured_changes
            if self.counted[j]:
                errors.append(np.concatenate([own_errors[None], own_errors - shift]))
                covariances.append(np.concatenate([update.error_covariance[None], update.error_covariance + spread]))
            white = update.whitening.swapaxes(-1, -2) @ (update.whitening @ own_errors)
            correction = gains.gain[j][:, :, chosen].transpose(2, 0, 1) @ filter_errors
            corrected = deviation + update.gain @ own_errors - correction
            deviations = deviations + cross.swapaxes(-1, -2) @ white - update.gain @ (shift + spread @ white)
            # A different memory changes the whole disturbance, not only its deviation from that of the filter.
            disturbance = gains.disturbance[j][:, chosen].T[:, :, None]
            moved, scaled = transition @ corrected, ratio * transition
            deviation = ratio * moved + (ratio - 1.0) * disturbance
            deviations = scaled @ deviations + ratio_changes * (moved + disturbance)
            after = transition @ update.covariance @ transition.swapaxes(-1, -2)
            covariance = ratios * after + process
            gain = scaled @ update.gain
            closed = scaled - gain @ output
            changes = closed @ changes @ _transposed(closed)
            changes += process_changes
            changes[of_measured] += gain @ measured_changes[of_measured] @ _transposed(gain)
            changes[of_memory] += ratios_changes[of_memory] * after
        return np.stack(errors)[..., 0], np.stack(covariances)


def _transposed(matrices: np.ndarray) -> np.ndarray:
    """Return transposed matrices in row-major order, which NumPy multiplies faster than transposed views."""
    return np.ascontiguousarray(matrices.swapaxes(-1, -2))


def _and_changes(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the first of some arrays, and the differences of the other arrays from it."""
    return values[0], values[1:] - values[0]


def _disturbance_deviations(noise: PredictionNoise) -> np.ndarray:
    """Return the standard deviations (NUM_DISTURBANCE,) of the disturbance."""
    return np.append(noise.disturbance, [_CONSTANT_FORCE_DEVIATION, _CONSTANT_FORCE_DEVIATION])


def _rows(signal: str, axes: str = "xyz") -> set[int]:
    """Return the rows of a signal in the state, for some axes."""
    return {STATE_ROWS[signal] + "xyz".index(axis) for axis in axes}


def _disturbance_rows(*names: str) -> set[int]:
    """Return the rows of parts of the disturbance in the state."""
    return {NUM_BODY + Disturbance._fields.index(name) for name in names}


def _estimated_rows(signals: set[str], frame: DisturbanceFrame) -> np.ndarray:
    """Return the rows of the state that the filter estimates, which the outputs determine or depend on."""
    constant = _disturbance_rows("constant_x", "constant_y")
    rows = set(range(NUM_BODY + NUM_DISTURBANCE))
    if signals == {"position"}:
        # If only heights are logged, the vehicle is assumed to stay level.
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
    """Measurement update of a Kalman filter.

    Attributes:
        gain: (..., n, m) gain.
        covariance: (..., n, n) covariance of the state after the update.
        error_covariance: (..., m, m) covariance of the prediction errors.
        whitening: (..., m, m) inverse Cholesky factor of `error_covariance`.
    """

    gain: np.ndarray
    covariance: np.ndarray
    error_covariance: np.ndarray
    whitening: np.ndarray


def _update(covariance: np.ndarray, output: np.ndarray, measurement_noise: np.ndarray) -> _Update:
    """Return the measurement update of a Kalman filter.

    Args:
        covariance: (..., n, n) covariance of the state before the update.
        output: (..., m, n) output matrix.
        measurement_noise: (m, m) or (..., m, m) covariance of the measurement noise.
    """
    cross = output @ covariance
    error_covariance = cross @ output.swapaxes(-1, -2) + measurement_noise
    whitening = np.linalg.inv(np.linalg.cholesky(error_covariance))
    half = whitening @ cross
    gain = half.swapaxes(-1, -2) @ whitening
    after = covariance - half.swapaxes(-1, -2) @ half
    return _Update(gain, 0.5 * (after + after.swapaxes(-1, -2)), error_covariance, whitening)
