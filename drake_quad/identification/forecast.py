"""Share of the variance of held-out flight that a model explains.

In each window the filter first settles. From then on, the model follows the logged commands without measurements. Of an
output y, the model explains the share 1 - Σ (y - ŷ)² / Σ (y - ȳ)², where ȳ is the prediction by persistence: a position
continues at its velocity, an attitude at its body rates, and body rates are constant. A specific force has its mean.
"""

from typing import NamedTuple

import numpy as np

from drake_quad.identification.model import STATE_ROWS
from drake_quad.identification.prediction_errors import FORCE, PredictionNoise, Predictor
from drake_quad.identification.windows import within_half_a_turn

_AXES = ("x", "y", "z"), ("roll", "pitch", "yaw"), ("p", "q", "r")
_ROWS_OF_RATES = {"position": STATE_ROWS["velocity"], "attitude": STATE_ROWS["body_rates"]}


class Forecast(NamedTuple):
    """Forecasts in W windows, with the measurements.

    Attributes:
        names: (m,) names of the outputs, as in "body rate p".
        time: (T,) time since the filter used the last measurement, s.
        measured: (T, m, W) measurements.
        predicted: (T, m, W) forecasts.
        explained: (m,) explained share of the variance over the whole horizon, in all windows; NaN if nothing varies.
    """

    names: tuple[str, ...]
    time: np.ndarray
    measured: np.ndarray
    predicted: np.ndarray
    explained: np.ndarray


def forecast(predictor: Predictor, parameters: np.ndarray, noise: PredictionNoise) -> Forecast:
    """Return the forecast of a predictor's model over the length of its windows, for parameters (p,)."""
    gains = predictor.gains(parameters, noise)
    held = gains._replace(gain=np.where(predictor.counted[:, None, None, None], 0.0, gains.gain))
    kept = np.flatnonzero(predictor.counted)
    errors, state = predictor.errors(parameters[None], held, noise, keep=int(kept[0]))
    measured = predictor.measured[kept]
    predicted = measured - errors[kept][:, :, 0]
    time = predictor.period * np.arange(len(kept))
    persistence_errors = np.empty_like(measured)
    for i, (signal, column) in enumerate(predictor.outputs):
        if signal == FORCE:
            persistence_errors[:, i] = measured[:, i] - measured[:, i].mean()
            continue
        start = state[STATE_ROWS[signal] + column, 0]
        rate = state[_ROWS_OF_RATES[signal] + column, 0] if signal in _ROWS_OF_RATES else 0.0 * start
        persistence_errors[:, i] = measured[:, i] - start - time[:, None] * rate
        if signal == "attitude":
            persistence_errors[:, i] = within_half_a_turn(persistence_errors[:, i])
    squares, whole = np.sum((measured - predicted) ** 2, axis=(0, 2)), np.sum(persistence_errors**2, axis=(0, 2))
    names = tuple(named(signal, column) for signal, column in predictor.outputs)
    return Forecast(names, time, measured, predicted, 1.0 - squares / np.where(whole > 0.0, whole, np.nan))


def named(signal: str, column: int) -> str:
    """Return the name of an output, such as body rate p, specific force along z, position y, or roll."""
    if signal == "attitude":
        return _AXES[1][column]
    if signal == "body_rates":
        return f"body rate {_AXES[2][column]}"
    return f"{signal.replace('_', ' ')} {'along ' if signal == FORCE else ''}{_AXES[0][column]}"
