"""Networks of a policy: layers of neurons, and gated recurrent units that remember.

    dense     y = σ(W x + b)
    GRU       r = s(W_r x + b_r + U_r h + c_r),  z = s(W_z x + b_z + U_z h + c_z)
              n = tanh(W_n x + b_n + r (U_n h + c_n)),  h' = z h + (1 - z) n

with the logistic function s and an activation σ. The unit is that of K. Cho et al., "Learning phrase representations
using RNN encoder-decoder for statistical machine translation", 2014, with the reset gate r behind the product, as
PyTorch, TensorFlow and ONNX (`linear_before_reset`) have it.
"""

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Literal, NamedTuple

from drake_quad.framework.elementary import dense, erf, exp, identity, maximum, minimum, tanh, where
from drake_quad.framework.symbols import Matrix
from drake_quad.signals import Row

Activation = Literal["identity", "relu", "tanh", "sigmoid", "elu", "silu", "leaky_relu", "gelu", "gelu_tanh"]
_ROOT_OF_HALF = math.sqrt(0.5)
_ROOT_OF_2_OVER_PI = math.sqrt(2.0 / math.pi)
GELU_CUBE = 0.044715
"""Coefficient of the third power in the approximation of GELU (Hendrycks and Gimpel, 2016)."""


def relu(x: Row) -> Row:
    """The larger of x and 0."""
    return maximum(x, 0.0)


def sigmoid(x: Row) -> Row:
    """The logistic function."""
    return 0.5 + 0.5 * tanh(0.5 * x)


def elu(x: Row, alpha: float = 1.0) -> Row:
    """Return x for x >= 0, and α (exp x - 1) for x < 0."""
    below = exp(minimum(x, 0.0)) - 1.0
    return where(x > 0.0, x, below if alpha == 1.0 else alpha * below)


def leaky_relu(x: Row, alpha: float = 0.01) -> Row:
    """Return x for x >= 0, and α x for x < 0."""
    return where(x > 0.0, x, alpha * x)


def gelu(x: Row) -> Row:
    """Return x times the probability that a standard normal variable is below x (Hendrycks and Gimpel, 2016)."""
    return 0.5 * x * (1.0 + erf(_ROOT_OF_HALF * x))


def gelu_tanh(x: Row) -> Row:
    """Return the approximation of `gelu` by a hyperbolic tangent, from the same authors."""
    return 0.5 * x * (1.0 + tanh(_ROOT_OF_2_OVER_PI * (x + GELU_CUBE * x * x * x)))


def silu(x: Row) -> Row:
    """X times its logistic function."""
    return x * sigmoid(x)


_FORMULAS: tuple[Callable[..., Row], ...] = (identity, relu, tanh, sigmoid, elu, silu, leaky_relu, gelu, gelu_tanh)
ACTIVATIONS = {formula.__name__: formula for formula in _FORMULAS}
"""The functions of activations, by name."""

WITH_ALPHA: tuple[Activation, ...] = ("elu", "leaky_relu")
"""Activations with a parameter α."""


class Dense(NamedTuple):
    """Dense layer of a network.

    Attributes:
        matrix: weights W and biases b.
        activation: name of the activation σ.
        alpha: parameter α of the activation; None for its default.
    """

    matrix: Matrix
    activation: Activation = "identity"
    alpha: float | None = None

    @property
    def formula(self) -> Callable[[Row], Row]:
        """Return the function σ."""
        formula = ACTIVATIONS[self.activation]
        return formula if self.alpha is None else partial(formula, alpha=self.alpha)


class Gru(NamedTuple):
    """A layer of gated recurrent units.

    Attributes:
        of_input: W and b, those of r, z and n one after another.
        of_memory: U and c, likewise.
        initial: (units,) what they remember at the beginning.
    """

    of_input: Matrix
    of_memory: Matrix
    initial: tuple[float, ...]


class Network(NamedTuple):
    """Layers, from the input on.

    Attributes:
        layers: one after another.
        num_inputs: rows of the input.
        offset: that is taken from each row of the input.
        scale: by which it is multiplied then.
        limit: to which what comes of that is held, on both sides of zero.
    """

    layers: tuple[Dense | Gru, ...]
    num_inputs: int
    offset: tuple[float, ...] | None = None
    scale: tuple[float, ...] | None = None
    limit: float | None = None

    @property
    def memory(self) -> tuple[tuple[float, ...], ...]:
        """What the units of each recurrent layer remember at the beginning."""
        return tuple([layer.initial for layer in self.layers if isinstance(layer, Gru)])

    @property
    def num_outputs(self) -> int:
        """Rows of the output."""
        *_, last = self.layers
        return len(last.initial) if isinstance(last, Gru) else last.matrix.num_rows


class NetworkStep(NamedTuple):
    """What a network makes of an input.

    Attributes:
        output: rows.
        memory: of each recurrent layer.
    """

    output: tuple[Row, ...]
    memory: tuple[tuple[Row, ...], ...]


def passed(network: Network, inputs: Sequence[Row], memory: Sequence[Sequence[Row]]) -> NetworkStep:
    """Evaluate a network for one input.

    Args:
        network: network of constants.
        inputs: rows of the input.
        memory: present memory of each recurrent layer.
    """
    rows = _prepared(network, inputs)
    remembered: list[tuple[Row, ...]] = []
    for layer in network.layers:
        if isinstance(layer, Dense):
            rows = dense(layer.matrix, rows, layer.formula)
        else:
            rows = _recurrent(layer, rows, memory[len(remembered)])
            remembered.append(tuple(rows))
    return NetworkStep(tuple(rows), tuple(remembered))


def _prepared(network: Network, inputs: Sequence[Row]) -> list[Row]:
    rows = list(inputs)
    if network.offset is not None:
        rows = [row - offset for row, offset in zip(rows, network.offset, strict=True)]
    if network.scale is not None:
        rows = [row * scale for row, scale in zip(rows, network.scale, strict=True)]
    if network.limit is not None:
        rows = [minimum(maximum(row, -network.limit), network.limit) for row in rows]
    return rows


def _recurrent(layer: Gru, rows: Sequence[Row], memory: Sequence[Row]) -> list[Row]:
    units = len(layer.initial)
    new, old = (
        _gates(dense(matrix, given, identity), units)
        for matrix, given in ((layer.of_input, rows), (layer.of_memory, memory))
    )
    found = []
    for before, now, then in zip(memory, zip(*new, strict=True), zip(*old, strict=True), strict=True):
        (r, z, n), (u_r, u_z, u_n) = now, then
        update = sigmoid(z + u_z)
        proposed = tanh(n + sigmoid(r + u_r) * u_n)
        found.append(update * before + (1.0 - update) * proposed)
    return found


def _gates(rows: Sequence[Row], units: int) -> list[Sequence[Row]]:
    """Those of the reset gate, of the update gate and of what is proposed, each of so many units."""
    return [rows[first : first + units] for first in range(0, len(rows), units)]
