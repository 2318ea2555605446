"""Forecast of held-out flight, and the fraction of the variance that the forecast explains.

The filter first settles in each window. The model is then simulated with the logged commands, without measurements. The
forecast ŷ of an output y explains the fraction 1 - Σ (y - ŷ)² / Σ (y - ȳ)² of the variance of y, where ȳ is the
prediction by persistence: the position changes at the initial velocity, the attitude changes at the initial body rates,
and the body rates are constant. The prediction ȳ of a specific force is its mean.
"""

import numpy as np

from drake_quad.identification.model import STATE_ROWS
from drake_quad.identification.prediction_errors import FORCE, PredictionNoise, Predictor
from drake_quad.identification.result import ForecastOutput
from drake_quad.identification.windows import wrapped_angles
from drake_quad.logs.record import QUANTITIES

_AXES = ("x", "y", "z"), ("roll", "pitch", "yaw"), ("p", "q", "r")
# For each signal, the row of the model state that contains the rate of change of the signal's first component.
_RATE_ROWS = {"position": STATE_ROWS["velocity"], "attitude": STATE_ROWS["body_rates"]}


def forecast(predictor: Predictor, parameters: np.ndarray, noise: PredictionNoise) -> tuple[ForecastOutput, ...]:
    """Forecast each output of a predictor in its windows, with model parameters (p,) and the noise of the filter."""
    gains = predictor.gains(parameters, noise)
    open_loop_gains = gains._replace(gain=np.where(predictor.evaluated[:, None, None, None], 0.0, gains.gain))
    evaluated = np.flatnonzero(predictor.evaluated)
    errors, initial_state = predictor.errors(parameters[None], open_loop_gains, return_state_at=int(evaluated[0]))
    measured = predictor.measured[evaluated]
    predicted = measured - errors[evaluated][:, :, 0]
    time = predictor.period * np.arange(len(evaluated))
    persistence_errors = np.empty_like(measured)
    for i, (signal, column) in enumerate(predictor.outputs):
        if signal == FORCE:
            persistence_errors[:, i] = measured[:, i] - measured[:, i].mean()
            continue
        start = initial_state[STATE_ROWS[signal] + column, 0]
        rate = initial_state[_RATE_ROWS[signal] + column, 0] if signal in _RATE_ROWS else 0.0 * start
        persistence_errors[:, i] = measured[:, i] - start - time[:, None] * rate
        if signal == "attitude":
            persistence_errors[:, i] = wrapped_angles(persistence_errors[:, i])
    forecast_squares, persistence_squares = (
        np.sum((measured - predicted) ** 2, axis=(0, 2)),
        np.sum(persistence_errors**2, axis=(0, 2)),
    )
    explained = 1.0 - forecast_squares / np.where(persistence_squares > 0.0, persistence_squares, np.nan)
    window_time = np.arange(measured.shape[2])[:, None] * float(time[-1]) + time
    return tuple(
        ForecastOutput(
            output_name(signal, column),
            QUANTITIES[signal].unit,
            window_time,
            measured[:, i].T,
            predicted[:, i].T,
            float(explained[i]),
            float(noise.measured[i]),
        )
        for i, (signal, column) in enumerate(predictor.outputs)
    )


def output_name(signal: str, column: int) -> str:
    """Return the name of an output, such as "body rate p", "specific force along z", "position y" or "roll"."""
    if signal == "attitude":
        return _AXES[1][column]
    if signal == "body_rates":
        return f"body rate {_AXES[2][column]}"
    return f"{signal.replace('_', ' ')} {'along ' if signal == FORCE else ''}{_AXES[0][column]}"
