"""Share of the variance of held-out flight that a model explains.

In each window the filter first settles. From then on, the model follows the logged commands without measurements. The
share of the variance of an output y that the model explains is 1 - Σ (y - ŷ)² / Σ (y - ȳ)². Here ŷ is the forecast, and
ȳ is the prediction by persistence: a position continues at its velocity, an attitude at its body rates, and body rates
are constant. For a specific force, ȳ is the mean.
"""

import numpy as np

from drake_quad.identification.logs.record import QUANTITIES
from drake_quad.identification.model import STATE_ROWS
from drake_quad.identification.prediction_errors import FORCE, PredictionNoise, Predictor
from drake_quad.identification.result import ForecastOutput
from drake_quad.identification.windows import within_half_a_turn

_AXES = ("x", "y", "z"), ("roll", "pitch", "yaw"), ("p", "q", "r")
_ROWS_OF_RATES = {"position": STATE_ROWS["velocity"], "attitude": STATE_ROWS["body_rates"]}


def forecast(predictor: Predictor, parameters: np.ndarray, noise: PredictionNoise) -> tuple[ForecastOutput, ...]:
    """Return the forecast of each output over the length of the windows, for parameters (p,) and a noise."""
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
    explained = 1.0 - squares / np.where(whole > 0.0, whole, np.nan)
    shown_time = np.arange(measured.shape[2])[:, None] * float(time[-1]) + time
    return tuple(
        ForecastOutput(
            named(signal, column),
            QUANTITIES[signal].unit,
            shown_time,
            measured[:, i].T,
            predicted[:, i].T,
            float(explained[i]),
            float(noise.measured[i]),
        )
        for i, (signal, column) in enumerate(predictor.outputs)
    )


def named(signal: str, column: int) -> str:
    """Return the name of an output, such as body rate p, specific force along z, position y, or roll."""
    if signal == "attitude":
        return _AXES[1][column]
    if signal == "body_rates":
        return f"body rate {_AXES[2][column]}"
    return f"{signal.replace('_', ' ')} {'along ' if signal == FORCE else ''}{_AXES[0][column]}"
