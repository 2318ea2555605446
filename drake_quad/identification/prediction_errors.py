"""One-step predictions of logged measurements, by an extended Kalman filter in each window.

The filter state consists of the vehicle state x and of a disturbance d. The disturbance is a force and a torque that
follow first-order Gauss-Markov processes. Over the time Δ between two measurements,

    x⁺ = f(x, d, u; θ),   d⁺ = exp(-Δ/T) d + σ_d √(1 - exp(-2Δ/T)) w,   y = h(x, d; θ) + σ_y w,

where w is white noise of unit variance. If model and noise are correct, the prediction errors e = y - ŷ (innovations)
are white. Therefore estimates from prediction errors are consistent, although a controller feeds the measurements back
into the commands. Estimates from simulated windows with free initial states are not consistent (L. Ljung, System
Identification, 2nd ed., 1999, §13.4).

The gains of the filter follow from a linearisation around its predictions for one set of parameters. The predictions
for other parameters use the same gains, so that they are smooth functions of the parameters.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from drake_quad.identification.model import (
    NUM_BODY,
    NUM_DISTURBANCE,
    STATE_ROWS,
    DisturbanceFrame,
    LogModel,
    ModelFlight,
    WindowInputs,
)
from drake_quad.identification.windows import LogWindow, WindowSizes, wrapped_angles
from drake_quad.logs.record import FlightRecord

FORCE = "specific_force"
"""Name of the signal that an accelerometer measures."""
# Rows of roll, pitch and yaw in the state.
_ATTITUDE = slice(STATE_ROWS["attitude"], STATE_ROWS["attitude"] + 3)
# Finite-difference steps for the linearisation of the filter, each in the unit of its state component.
_LINEARISATION_STEPS = np.append(np.repeat([1e-4, 1e-5, 1e-4, 1e-4, 1e-3, 1e-2], 3), [1e-3, 1e-3])
# Standard deviation of the constant horizontal specific force, m/s², which represents the force of an unlogged wind.
_CONSTANT_FORCE_DEVIATION = 1.0
# Standard deviations of the state at the start of a window: position (m), attitude (rad), velocity (m/s), body rates
# (rad/s).
_INITIAL_DEVIATIONS = np.repeat([1.0, 0.5, 2.0, 10.0], 3)
_LOGGED_ATTITUDE_DEVIATION = 0.03  # rad, standard deviation of a logged attitude that is not predicted


class Output(NamedTuple):
    """Output that is predicted: one column of a logged signal."""

    signal: str
    column: int


class PredictionNoise(NamedTuple):
    """Noise of the measurements, and parameters of the disturbance.

    Attributes:
        measured: (m,) standard deviation of the measurement noise of each output, in the unit of the output.
        disturbance: (6,) stationary standard deviations σ_d of the force over mass, m/s², and of the torque over
            inertia, rad/s².
        correlation_time: (6,) correlation times T of the disturbance, s.
    """

    measured: np.ndarray
    disturbance: np.ndarray
    correlation_time: np.ndarray

    @classmethod
    def of(cls, values: np.ndarray) -> "PredictionNoise":
        """Return the noise from its concatenated fields (m + 12,)."""
        return cls(values[:-12], values[-12:-6], values[-6:])

    @property
    def force(self) -> np.ndarray:
        """Standard deviations (3,) of the disturbing force over mass, m/s²."""
        force, _ = np.split(self.disturbance, 2)
        return force

    @property
    def stationary(self) -> np.ndarray:
        """Standard deviations (NUM_DISTURBANCE,) of the disturbance, including the constant force."""
        return np.append(self.disturbance, [_CONSTANT_FORCE_DEVIATION, _CONSTANT_FORCE_DEVIATION])

    def decay(self, duration: float) -> np.ndarray:
        """Return the factors (NUM_DISTURBANCE,) by which the disturbance decays during a time in s."""
        return np.append(np.exp(-duration / self.correlation_time), [1.0, 1.0])

    @property
    def torque(self) -> np.ndarray:
        """Standard deviations (3,) of the disturbing torque over inertia, rad/s²."""
        _, torque = np.split(self.disturbance, 2)
        return torque

    def mean_force(self, duration: float) -> np.ndarray:
        """Return the standard deviations (3,), m/s², of the time-averaged disturbing force over mass.

        The autocorrelation of the force is exp(-|t| / T). The variance of its average over a duration d T is therefore
        the variance of the force times 2 (d - 1 + exp(-d)) / d².

        Args:
            duration: duration over which the force is averaged, s.
        """
        ratio = duration / self.correlation_time[:3]
        return np.asarray(self.force * np.sqrt(2.0 * (ratio - 1.0 + np.exp(-ratio))) / ratio)


class Gains(NamedTuple):
    """Gains of the filter at T measurements in W windows, and its linearisation around its predictions.

    Attributes:
        gain: (T, n, m, W) Kalman gains for the n state components that are estimated, and m outputs.
        whitening: (T, W, m, m) inverse Cholesky factors of the covariances of the prediction errors.
        transition: (T, W, n, n) transition matrices to the next measurement.
        output: (T, W, m, n) derivatives of the outputs with respect to the state.
        errors: (T, m, W) prediction errors.
        disturbance: (T, n, W) predicted disturbance at the next measurement; the rows of all other state components are
            0.
        initial_covariance: (W, n, n) covariance of the state at the first measurement.
        final_covariance: (W, n, n) covariance of the state at the measurement where the next window starts.
        noise: noise for which the gains were computed.
    """

    gain: np.ndarray
    whitening: np.ndarray
    transition: np.ndarray
    output: np.ndarray
    errors: np.ndarray
    disturbance: np.ndarray
    initial_covariance: np.ndarray
    final_covariance: np.ndarray
    noise: PredictionNoise


class InitialStates(NamedTuple):
    """States at the first measurement of each window, to first order in the parameters.

    Attributes:
        state: (NUM_BODY + NUM_DISTURBANCE, W) states.
        jacobian: (NUM_BODY + NUM_DISTURBANCE, p, W) derivatives with respect to the parameters.
        parameters: (p,) parameters for which `state` holds.
        covariance: (W, n, n) covariances of continued windows.
        continued: (W,) mask of the windows that start in the final state of the preceding window. All other windows
            start with the uncertain initial state.
    """

    state: np.ndarray
    jacobian: np.ndarray
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
        offsets = np.arange(-sizes.settle, sizes.length)
        self.evaluated = offsets >= 0
        measured = [
            [
                records[record].of(signal)[np.minimum(start + offsets, len(records[record].time) - 1), column]
                for record, start in windows
            ]
            for signal, column in outputs
        ]
        self.measured = np.ascontiguousarray(np.transpose(measured, (2, 0, 1)))
        signals = {signal for signal, _ in outputs}
        self._angles = np.array([signal == "attitude" for signal, _ in outputs])
        # The specific force is not part of the state, so its row 0 is a placeholder. `_predicted` overwrites the values
        # that are read from this row.
        self._output_rows = [STATE_ROWS.get(signal, 0) + column for signal, column in outputs]
        self.rows = _estimated_rows(signals, model.frame)
        self._deviations = _INITIAL_DEVIATIONS.copy()
        if "attitude" not in signals and all(record.attitude is not None for record in records):
            self._deviations[_ATTITUDE] = _LOGGED_ATTITUDE_DEVIATION
        p = len(model.names)
        state, n, W = self._measured_states(records, offsets[0]), len(self.rows), len(windows)
        jacobian, no_covariance = np.zeros((NUM_BODY + NUM_DISTURBANCE, p, W)), np.zeros((W, n, n))
        self.initial = InitialStates(state, jacobian, np.zeros(p), no_covariance, np.zeros(W, dtype=bool))
        # True for each window that starts where the preceding window ends.
        self._follows = np.array(
            [i > 0 and windows[i - 1] == (record, start - sizes.length) for i, (record, start) in enumerate(windows)]
        )

    @property
    def noise_groups(self) -> np.ndarray:
        """Group number (m + 12,) of each noise parameter. Parameters of the same group have the same value.

        The axes of a position form one group, and so do the axes of an attitude. The x and y axes of any other signal,
        and of the disturbance, also form a group.
        """
        shared = {"position": (0, 0, 0), "attitude": (0, 0, 0)}
        names = [f"{signal}{shared.get(signal, (0, 0, 2))[column]}" for signal, column in self.outputs]
        names += [
            f"{name}{axis}"
            for name in ("force", "torque", "force correlation time", "torque correlation time")
            for axis in (0, 0, 2)
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
        """Return the logged states (NUM_BODY + NUM_DISTURBANCE, W) at the first measurement; 0 if not logged."""
        state = np.zeros((NUM_BODY + NUM_DISTURBANCE, len(self.windows)))
        for signal, row in STATE_ROWS.items():
            for w, (record, start) in enumerate(self.windows):
                values = getattr(records[record], signal)
                if values is not None:
                    state[row : row + 3, w] = values[start + first]
        return state

    def _begin(self, parameters: np.ndarray) -> tuple[ModelFlight, np.ndarray]:
        """Return a model flight for (K, p) parameters, and its state (components, K, W) at the first measurement."""
        flight = ModelFlight(self.model, parameters, self.inputs, self.split * self.sizes.warm_up)
        state, jacobian, reference, _, _ = self.initial
        return flight, state[:, None, :] + np.einsum("rpw,kp->rkw", jacobian, parameters - reference)

    def continue_windows(self, states: np.ndarray, jacobian: np.ndarray, parameters: np.ndarray, gains: Gains) -> None:
        """Start each window in the final state of the preceding window, if the two are adjacent.

        If the model is good, the state of the filter depends on measurements over a long time. If the filter restarted
        in each window, it would treat the controller's reaction to earlier disturbances as noise.

        Args:
            states: (NUM_BODY + NUM_DISTURBANCE, W) states at the measurements where the next windows start.
            jacobian: (NUM_BODY + NUM_DISTURBANCE, p, W) derivatives of the states with respect to the parameters.
            parameters: (p,) parameters for which the states hold.
            gains: gains of the filter.
        """
        continued, preceding = np.flatnonzero(self._follows), np.flatnonzero(self._follows) - 1
        previous = self.initial
        state, state_jacobian, covariance = previous.state.copy(), previous.jacobian.copy(), previous.covariance.copy()
        state[:, continued], state_jacobian[:, :, continued] = states[:, preceding], jacobian[:, :, preceding]
        covariance[continued] = gains.final_covariance[preceding]
        self.initial = InitialStates(state, state_jacobian, parameters, covariance, self._follows)

    def _predicted(self, flight: ModelFlight, state: np.ndarray) -> np.ndarray:
        """Return the predicted outputs (m, K, W) for a state."""
        predicted = state[self._output_rows]
        for signal, measurement in ((FORCE, flight.specific_force), ("attitude", flight.measured_attitude)):
            columns = [column for name, column in self.outputs if name == signal]
            if columns:
                predicted[[name == signal for name, _ in self.outputs]] = measurement(state)[columns]
        return predicted

    def _errors(self, j: int, predicted: np.ndarray) -> np.ndarray:
        """Return the errors (m, K, W) of the predicted outputs at measurement j, measured minus predicted."""
        errors = self.measured[j][:, None, :] - predicted
        errors[self._angles] = wrapped_angles(errors[self._angles])
        return errors

    def process_noise(self, noise: PredictionNoise) -> np.ndarray:
        """Return the variance (n,) that is added to each state component between two measurements."""
        variances = np.zeros(NUM_BODY + NUM_DISTURBANCE)
        variances[NUM_BODY:] = noise.stationary**2 * (1.0 - noise.decay(self.period) ** 2)
        return variances[self.rows]

    def gains(self, parameters: np.ndarray, noise: PredictionNoise) -> Gains:
        """Return the gains of the filter, linearised around its predictions for parameters (p,)."""
        n, rows = len(self.rows), self.rows
        steps = _LINEARISATION_STEPS[rows]
        flight, state = self._begin(np.tile(parameters, (1 + n, 1)))
        covariance = initial_covariance = self._first_covariance(noise)
        process_noise, decay = np.diag(self.process_noise(noise)), noise.decay(self.period)
        measurement_noise = np.diag(noise.measured**2)
        fields: list[tuple[np.ndarray, ...]] = []
        for j in range(len(self.measured)):
            if j == self.sizes.length:
                final_covariance = covariance
            state[:, 1:] = state[:, :1]
            state[rows, 1 + np.arange(n)] += steps[:, None]
            predicted = self._predicted(flight, state)
            output = ((predicted[:, 1:] - predicted[:, :1]) / steps[:, None]).transpose(2, 0, 1)
            errors = self._errors(j, predicted[:, :1])[:, 0]
            update = _update(covariance, output, measurement_noise)
            gain = update.gain.transpose(1, 2, 0)
            state[rows] += np.einsum("nmw,mw->nw", gain, errors)[:, None, :]
            for _ in range(self.split):
                flight.step(state)
            state[NUM_BODY:] *= decay[:, None, None]
            differences = state[:, 1:] - state[:, :1]
            differences[_ATTITUDE] = wrapped_angles(differences[_ATTITUDE])
            transition = (differences[rows] / steps[:, None]).transpose(2, 0, 1)
            covariance = transition @ update.covariance @ transition.transpose(0, 2, 1) + process_noise
            disturbance = np.where(rows[:, None] >= NUM_BODY, state[rows, 0], 0.0)
            fields.append((gain, update.error_covariance, transition, output, errors, disturbance))
        gain, error_covariances, transition, output, errors, disturbance = (
            np.stack(values) for values in zip(*fields, strict=True)
        )
        return Gains(
            gain,
            np.linalg.inv(np.linalg.cholesky(error_covariances)),
            transition,
            output,
            errors,
            disturbance,
            initial_covariance,
            final_covariance,
            noise,
        )

    def _first_covariance(self, noise: PredictionNoise) -> np.ndarray:
        """Return the covariance (W, n, n) of the state at the first measurement."""
        variances = np.concatenate([self._deviations, noise.stationary]) ** 2
        _, _, _, covariance, continued = self.initial
        return np.where(continued[:, None, None], covariance, np.diag(variances[self.rows]))

    def errors(
        self, parameters: np.ndarray, gains: Gains, *, return_state_at: int | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the prediction errors for K sets of parameters, all with the same filter gains.

        Args:
            parameters: (K, p) parameters.
            gains: gains of the filter.
            return_state_at: index of a measurement. The returned state is the predicted state just before this
                measurement. By default, it is the measurement at which the next window starts.

        Returns:
            (T, m, K, W) errors, and (NUM_BODY + NUM_DISTURBANCE, K, W) states.
        """
        return_state_at = self.sizes.length if return_state_at is None else return_state_at
        flight, state = self._begin(parameters)
        decay, errors = gains.noise.decay(self.period), np.empty((*self.measured.shape[:2], *state.shape[1:]))
        gains_of_windows = np.ascontiguousarray(gains.gain.transpose(0, 3, 1, 2))
        for j in range(len(self.measured)):
            if j == return_state_at:
                kept_state = state.copy()
            errors[j] = self._errors(j, self._predicted(flight, state))
            # A matrix product for each window takes only a fraction of the time of `np.einsum`.
            corrections = gains_of_windows[j] @ np.ascontiguousarray(errors[j].transpose(2, 0, 1))
            state[self.rows] += corrections.transpose(1, 2, 0)
            for _ in range(self.split):
                flight.step(state)
            state[NUM_BODY:] *= decay[:, None, None]
        return errors, kept_state

    def open_loop(self, parameters: np.ndarray, gains: Gains, steps: Sequence[int]) -> list[np.ndarray]:
        """Predict the state at the last measurement before each window and at later times, from the commands alone.

        The filter uses the measurements before the window. After the last of them, the vehicle is simulated twice:
        without a disturbance, and with the estimated disturbance, which decays with its correlation time.

        Args:
            parameters: (p,) parameters.
            gains: gains of the filter.
            steps: numbers of samples from that measurement to the later times, in increasing order, at most the length
                of the windows.

        Returns:
            (12, 2, W) states, without and with the disturbance, at the last measurement and after each number of
            samples in `steps`. They are the states that motion capture would measure.
        """
        flight, state = self._begin(np.stack([parameters, parameters]))
        decay, states = gains.noise.decay(self.period)[:, None, None], []
        for j in range(self.sizes.settle + max(steps)):
            if j - self.sizes.settle + 1 in steps:
                states.append(self._measured(state))
            if j < self.sizes.settle:
                errors = self._errors(j, self._predicted(flight, state))
                state[self.rows] += np.einsum("nmw,mkw->nkw", gains.gain[j], errors)
            if j == self.sizes.settle - 1:
                states.append(self._measured(state))
                state[NUM_BODY:, 0] = 0.0
            for _ in range(self.split):
                flight.step(state)
            state[NUM_BODY:] *= decay
        return states

    def _measured(self, state: np.ndarray) -> np.ndarray:
        """Return the states (12, K, W) that motion capture would measure, for states (components, K, W)."""
        body = state[:NUM_BODY]
        return self.model.measured_state(body.reshape(NUM_BODY, -1).copy()).reshape(body.shape)

    def linearised_errors(
        self, gains: Gains, noises: Sequence[PredictionNoise], window_indices: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the prediction errors for several sets of noise parameters, to first order.

        The errors are linearised around the predictions of the filter.

        Let A be the transition matrix, C the output matrix, K the gain for the first noise, r the decay factor of the
        disturbance divided by the decay factor in the filter, and F = r A (I - K C). If the first noise is replaced by
        another one, the covariance of the state changes by

            ΔP⁺ = F ΔP Fᵀ + r A K ΔR (r A K)ᵀ + Δ(r rᵀ) A P Aᵀ + ΔQ,

        where P is the covariance after the update.

        Args:
            gains: gains of the filter.
            noises: C sets of noise parameters. Their differences from the first set must be small, so that the
                first-order approximation is accurate.
            window_indices: indices of w windows.

        Returns:
            (T, C, w, m) errors and (T, C, w, m, m) covariances of the errors, for the T measurements after settling.
        """
        n, m, W = len(self.rows), len(self.outputs), len(window_indices)
        # These are the decay factors with each noise, relative to the decay factors of the filter with `gains.noise`.
        ratios = np.ones((len(noises), NUM_BODY + NUM_DISTURBANCE))
        ratios[:, NUM_BODY:] = [noise.decay(self.period) / gains.noise.decay(self.period) for noise in noises]
        ratios = ratios[:, self.rows]
        variances = np.stack([self.process_noise(noise) for noise in noises])
        noise_variances = np.stack([noise.measured**2 for noise in noises])
        first_covariances = np.stack([self._first_covariance(noise)[window_indices] for noise in noises])
        covariance, deviation, ratio = first_covariances[0], np.zeros((W, n, 1)), ratios[0, :, None]
        process_noise, measurement_noise = np.diag(variances[0]), np.diag(noise_variances[0])
        ratio_products = ratio * ratio.T
        others = _OtherNoises(ratios, variances, noise_variances, first_covariances) if len(noises) > 1 else None
        filter_errors = gains.errors[..., window_indices]
        corrections = np.einsum("tnmw,tmw->twn", gains.gain[..., window_indices], filter_errors)[..., None]
        filter_errors = filter_errors.transpose(0, 2, 1)[..., None]
        disturbances = gains.disturbance[..., window_indices].transpose(0, 2, 1)[..., None]
        count, first_evaluated = int(np.sum(self.evaluated)), len(self.evaluated) - int(np.sum(self.evaluated))
        errors, covariances = np.empty((count, len(noises), W, m)), np.empty((count, len(noises), W, m, m))
        for j in range(len(self.measured)):
            output, transition = gains.output[j][window_indices], gains.transition[j][window_indices]
            update = _update(covariance, output, measurement_noise)
            first_errors = filter_errors[j] - output @ deviation
            corrected = deviation + update.gain @ first_errors - corrections[j]
            # `deviation` is the difference of the state from the state of the filter with `gains.noise`. With another
            # correlation time, the disturbance decays by another factor, which changes this difference.
            propagated = transition @ corrected
            deviation = ratio * propagated + (ratio - 1.0) * disturbances[j]
            propagated_covariance = transition @ update.covariance @ transition.swapaxes(-1, -2)
            covariance = ratio_products * propagated_covariance + process_noise
            index = j - first_evaluated
            if index >= 0:
                errors[index, 0], covariances[index, 0] = first_errors[..., 0], update.error_covariance
            if others is not None:
                disturbed = propagated + disturbances[j]
                shifts, covariance_changes = others.step(
                    update, output, transition, first_errors, disturbed, propagated_covariance
                )
                if index >= 0:
                    errors[index, 1:] = errors[index, 0] - shifts
                    covariances[index, 1:] = covariances[index, 0] + covariance_changes
        return errors, covariances


class _OtherNoises:
    """First-order changes of a Kalman filter's prediction errors and covariances for c other sets of noise parameters.

    The matrices for the c sets are stored side by side, as (w, rows, c, columns) for w windows, so that a single matrix
    product serves all sets.

    Args:
        ratios: (1 + c, n) decay factors of the n state components, relative to those of the filter to be replaced.
        variances: (1 + c, n) variances of the process noise.
        measurement_variances: (1 + c, m) variances of the measurement noise.
        covariances: (1 + c, w, n, n) covariances of the state at the first measurement.
    """

    def __init__(
        self, ratios: np.ndarray, variances: np.ndarray, measurement_variances: np.ndarray, covariances: np.ndarray
    ) -> None:
        self._ratio, self._ratio_changes = ratios[0], ratios[1:] - ratios[0]
        products = ratios[:, :, None] * ratios[:, None, :]
        self._product_changes = (products[1:] - products[0]).transpose(1, 0, 2)
        self._process_changes = (variances[1:] - variances[0]).T[:, :, None] * np.eye(len(variances[0]))[:, None, :]
        self._variance_changes = measurement_variances[1:] - measurement_variances[0]
        self._measured_changes = (
            self._variance_changes.T[:, :, None] * np.eye(measurement_variances.shape[1])[:, None, :]
        )
        # Indices of the noise parameter sets whose measurement noise, or whose correlation times, differ from those of
        # the first set.
        self._with_other_measurement_noise = np.flatnonzero(self._variance_changes.any(axis=1))
        self._with_other_correlation_time = np.flatnonzero(self._ratio_changes.any(axis=1))
        self._covariances = np.ascontiguousarray((covariances[1:] - covariances[0]).transpose(1, 2, 0, 3))
        w, n, c, _ = self._covariances.shape
        self._deviations = np.zeros((w, c, n))

    def step(
        self,
        update: "_Update",
        output: np.ndarray,
        transition: np.ndarray,
        errors: np.ndarray,
        disturbed: np.ndarray,
        propagated_covariance: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Update the filters by a measurement, and propagate them to the next one.

        Args:
            update: measurement update of the filter with the first noise.
            output: (w, m, n) output matrices.
            transition: (w, n, n) transition matrices.
            errors: (w, m, 1) prediction errors of the filter with the first noise.
            disturbed: (w, n, 1) disturbance in the next state, before the factors `ratios` are applied.
            propagated_covariance: (w, n, n) covariances A P Aᵀ with the first noise.

        Returns:
            The changes of the predicted outputs (c, w, m), and of the covariances (c, w, m, m) of their errors.
        """
        cross = _left_product(output, self._covariances)
        shifts = self._deviations @ output.swapaxes(-1, -2)
        covariance_changes = _right_product(cross, output) + self._measured_changes
        weighted_errors = np.linalg.solve(update.error_covariance, errors).swapaxes(-1, -2)
        changes_of_errors = shifts + _left_product(weighted_errors, covariance_changes)[:, 0]
        self._deviations += _left_product(weighted_errors, cross)[:, 0] - changes_of_errors @ update.gain.swapaxes(
            -1, -2
        )
        scaled = self._ratio[:, None] * transition
        self._deviations = self._deviations @ scaled.swapaxes(-1, -2)
        self._deviations += self._ratio_changes * disturbed.swapaxes(-1, -2)
        gain = scaled @ update.gain
        closed_loop = scaled - gain @ output
        changes = _right_product(_left_product(closed_loop, self._covariances), closed_loop) + self._process_changes
        noise_sets, time_sets = self._with_other_measurement_noise, self._with_other_correlation_time
        changes[:, :, noise_sets] += _right_product(gain[:, :, None, :] * self._variance_changes[noise_sets], gain)
        changes[:, :, time_sets] += self._product_changes[:, time_sets] * propagated_covariance[:, :, None, :]
        self._covariances = changes
        return shifts.swapaxes(0, 1), covariance_changes.transpose(2, 0, 1, 3)


def _left_product(matrices: np.ndarray, stacked: np.ndarray) -> np.ndarray:
    """Return the products (w, a, c, d) of matrices (w, a, b) and stacked matrices (w, b, c, d)."""
    w, b, c, d = stacked.shape
    return (matrices @ stacked.reshape(w, b, c * d)).reshape(w, -1, c, d)


def _right_product(stacked: np.ndarray, matrices: np.ndarray) -> np.ndarray:
    """Return the products (w, a, c, d) of stacked matrices (w, a, c, b) and transposed matrices (w, d, b)."""
    w, a, c, b = stacked.shape
    return (stacked.reshape(w, a * c, b) @ matrices.swapaxes(-1, -2)).reshape(w, a, c, -1)


def _estimated_rows(signals: set[str], frame: DisturbanceFrame) -> np.ndarray:
    """Return the indices of the state components that the filter estimates: those on which the outputs depend."""
    position, attitude, velocity, _ = (set(range(row, row + 3)) for row in STATE_ROWS.values())
    force, constant = set(range(NUM_BODY, NUM_BODY + 3)), set(range(NUM_BODY + 6, NUM_BODY + NUM_DISTURBANCE))
    rows = set(range(NUM_BODY + NUM_DISTURBANCE))
    if signals == {"position"}:
        # If only heights are logged, the vehicle is assumed to stay level.
        rows = {max(position), max(velocity), max(force)}
    elif "position" not in signals:
        rows -= position
        if "attitude" not in signals:
            rows -= {max(attitude)}  # the last row of the attitude is the yaw
        if "velocity" not in signals and FORCE not in signals:
            rows -= velocity | force | constant
    if frame == "body":
        rows -= constant
    return np.array(sorted(rows))


class _Update(NamedTuple):
    """Measurement update of a Kalman filter.

    Attributes:
        gain: (..., n, m) gain.
        covariance: (..., n, n) covariance of the state after the update.
        error_covariance: (..., m, m) covariance of the prediction errors.
    """

    gain: np.ndarray
    covariance: np.ndarray
    error_covariance: np.ndarray


def _update(covariance: np.ndarray, output: np.ndarray, measurement_noise: np.ndarray) -> _Update:
    """Return the measurement update of a Kalman filter.

    Args:
        covariance: (..., n, n) covariance of the state before the update.
        output: (..., m, n) output matrix.
        measurement_noise: (m, m) covariance of the measurement noise.
    """
    cross = output @ covariance
    error_covariance = cross @ output.swapaxes(-1, -2) + measurement_noise
    gain = np.linalg.solve(error_covariance, cross).swapaxes(-1, -2)
    updated = covariance - gain @ cross
    return _Update(gain, 0.5 * (updated + updated.swapaxes(-1, -2)), error_covariance)
