"""Residuals of windows as white noise of a sensor plus what an unknown force or torque makes of it.

A vehicle that is pushed by what the model leaves out strays in a window by a double integral of white noise. So the
residuals of an output at times t of a window have the covariance

    Σ = a² 1 + b² K,    K(t, t') = t² (3 t' - t) / 6 for t ≤ t',

of which a and b are those of maximum likelihood. Residuals times Σ^(-1/2) are white.
"""

from typing import NamedTuple

import numpy as np

# Of b² over a², times the mean of K's eigenvalues.
_LOGARITHMS = (-15.0, 15.0)
# In m, m/s, rad and rad/s: far below any sensor. A simulated flight without noise would otherwise have none, and the
# information about its parameters would be infinite.
_MIN_WHITE_NOISE = 1e-5


class Shape(NamedTuple):
    """Eigenvalues and eigenvectors of K at the times of a window."""

    values: np.ndarray
    vectors: np.ndarray


class Noise(NamedTuple):
    """Noise of an output.

    Attributes:
        white: a, in the output's unit.
        strayed: b, in the unit over s^(3/2).
    """

    white: float
    strayed: float

    def whitener(self, shape: Shape) -> np.ndarray:
        """(T, T) by which rows of residuals are multiplied from the right."""
        return np.asarray(shape.vectors / np.sqrt(self.white**2 + self.strayed**2 * shape.values))


def straying(times: np.ndarray) -> Shape:
    """The shape of what strays.

    Args:
        times: (T,) since the beginning of the window, s.
    """
    early, late = np.minimum.outer(times, times), np.maximum.outer(times, times)
    values, vectors = np.linalg.eigh(early * early * (3.0 * late - early) / 6.0)
    return Shape(np.maximum(values, 0.0), vectors)


def still(shape: Shape) -> Shape:
    """The same times without anything that strays."""
    return shape._replace(values=np.zeros_like(shape.values))


def noise_of(residuals: np.ndarray, shape: Shape) -> Noise:
    """Return the noise under which residuals are most likely, with white noise of at least `_MIN_WHITE_NOISE`.

    Args:
        residuals: (W, T), each window with its initial state fitted.
        shape: of what strays.
    """
    squares = np.mean((residuals @ shape.vectors) ** 2, axis=0)
    if not shape.values.any():
        return Noise(max(_MIN_WHITE_NOISE, float(np.sqrt(np.mean(squares)))), 0.0)
    relative = shape.values / np.mean(shape.values)
    logarithms = np.linspace(*_LOGARITHMS, 400)
    growing = 1.0 + np.exp(logarithms)[:, None] * relative
    # For a ratio of b² to a², the likeliest a² is a mean; what is left is the ratio.
    likeliest = np.mean(squares / growing, axis=1)
    unlikelihood = len(squares) * np.log(likeliest + 1e-300) + np.sum(np.log(growing), axis=1)
    best = int(np.argmin(unlikelihood))
    white, ratio = float(np.sqrt(likeliest[best])), float(np.exp(logarithms[best]))
    return Noise(max(_MIN_WHITE_NOISE, white), white * float(np.sqrt(ratio / np.mean(shape.values))))
