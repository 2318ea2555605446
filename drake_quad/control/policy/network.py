"""Networks of policies: dense layers and layers of gated recurrent units.

    dense     y = σ(W x + b)
    GRU       r = s(W_r x + b_r + U_r h + c_r),  z = s(W_z x + b_z + U_z h + c_z)
              n = tanh(W_n x + b_n + r (U_n h + c_n)),  h' = z h + (1 - z) n

with the logistic function s and an activation σ. The gated recurrent unit (GRU) is from K. Cho et al., "Learning phrase
representations using RNN encoder-decoder for statistical machine translation", 2014. The reset gate r is applied after
the product with U_n, as in PyTorch, TensorFlow and ONNX (`linear_before_reset`).
"""

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Literal, NamedTuple

from drake_quad.framework.elementary import dense, erf, exp, identity, maximum, minimum, tanh, where
from drake_quad.framework.symbols import Matrix
from drake_quad.signals import Row

Activation = Literal["identity", "relu", "tanh", "sigmoid", "elu", "silu", "leaky_relu", "gelu", "gelu_tanh"]
_ROOT_OF_HALF = math.sqrt(0.5)  # √½, in the exact formula of GELU
_ROOT_OF_2_OVER_PI = math.sqrt(2.0 / math.pi)  # √(2/π), in the tanh approximation of GELU
GELU_CUBIC_COEFFICIENT = 0.044715
"""Coefficient of the cubic term in the approximation of GELU (Hendrycks and Gimpel, 2016)."""


def relu(x: Row) -> Row:
    """Return the larger of x and 0."""
    return maximum(x, 0.0)


def sigmoid(x: Row) -> Row:
    """Return the logistic function of x."""
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
    """Return the approximation of GELU by a hyperbolic tangent (Hendrycks and Gimpel, 2016)."""
    return 0.5 * x * (1.0 + tanh(_ROOT_OF_2_OVER_PI * (x + GELU_CUBIC_COEFFICIENT * x * x * x)))


def silu(x: Row) -> Row:
    """Return x times its logistic function."""
    return x * sigmoid(x)


_FORMULAS: tuple[Callable[..., Row], ...] = (identity, relu, tanh, sigmoid, elu, silu, leaky_relu, gelu, gelu_tanh)
ACTIVATIONS = {formula.__name__: formula for formula in _FORMULAS}
"""Activation functions, by name."""

WITH_ALPHA: tuple[Activation, ...] = ("elu", "leaky_relu")
"""Activations with a parameter α."""


class Dense(NamedTuple):
    """Dense layer of a network.

    Attributes:
        matrix: weights W and biases b.
        activation: name of the activation σ.
        alpha: parameter α of the activation; None for the default value of this activation.
    """

    matrix: Matrix
    activation: Activation = "identity"
    alpha: float | None = None

    @property
    def formula(self) -> Callable[[Row], Row]:
        """Activation function σ of the layer."""
        formula = ACTIVATIONS[self.activation]
        return formula if self.alpha is None else partial(formula, alpha=self.alpha)


class Gru(NamedTuple):
    """Layer of gated recurrent units.

    Attributes:
        input_matrix: W and b of r, z and n, stacked in this order.
        memory_matrix: U and c of r, z and n, stacked in this order.
        initial: (units,) initial memory h.
    """

    input_matrix: Matrix
    memory_matrix: Matrix
    initial: tuple[float, ...]


class Network(NamedTuple):
    """Layers and input scaling of a network.

    Attributes:
        layers: layers, from the input to the output.
        num_inputs: number of inputs.
        offset: (num_inputs,) offsets that are subtracted from the input; None for zeros.
        scale: (num_inputs,) factors by which the difference is multiplied; None for ones.
        limit: largest absolute value of the scaled input; None for no limit.
    """

    layers: tuple[Dense | Gru, ...]
    num_inputs: int
    offset: tuple[float, ...] | None = None
    scale: tuple[float, ...] | None = None
    limit: float | None = None

    @property
    def memory(self) -> tuple[tuple[float, ...], ...]:
        """Initial memory of each recurrent layer of the network."""
        return tuple([layer.initial for layer in self.layers if isinstance(layer, Gru)])

    @property
    def num_outputs(self) -> int:
        """Number of outputs of the network."""
        *_, last = self.layers
        return len(last.initial) if isinstance(last, Gru) else last.matrix.num_rows


class NetworkStep(NamedTuple):
    """Output and memory of a network after one input.

    Attributes:
        output: values of the outputs.
        memory: memory of each recurrent layer.
    """

    output: tuple[Row, ...]
    memory: tuple[tuple[Row, ...], ...]


def evaluate_network(network: Network, inputs: Sequence[Row], memory: Sequence[Sequence[Row]]) -> NetworkStep:
    """Evaluate a network for one input.

    Args:
        network: network to evaluate.
        inputs: values of the inputs.
        memory: current memory of each recurrent layer.
    """
    rows = _scaled_input(network, inputs)
    remembered: list[tuple[Row, ...]] = []
    for layer in network.layers:
        if isinstance(layer, Dense):
            rows = dense(layer.matrix, rows, layer.formula)
        else:
            rows = _recurrent(layer, rows, memory[len(remembered)])
            remembered.append(tuple(rows))
    return NetworkStep(tuple(rows), tuple(remembered))


def _scaled_input(network: Network, inputs: Sequence[Row]) -> list[Row]:
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
    input_gates, memory_gates = (
        _gates(dense(matrix, layer_input, identity), units)
        for matrix, layer_input in ((layer.input_matrix, rows), (layer.memory_matrix, memory))
    )
    memory_after = []
    unit_gates = zip(zip(*input_gates, strict=True), zip(*memory_gates, strict=True), strict=True)
    for before, ((r, z, n), (u_r, u_z, u_n)) in zip(memory, unit_gates, strict=True):
        update = sigmoid(z + u_z)
        proposed = tanh(n + sigmoid(r + u_r) * u_n)
        memory_after.append(update * before + (1.0 - update) * proposed)
    return memory_after


def _gates(rows: Sequence[Row], units: int) -> list[Sequence[Row]]:
    """Split values into those of the reset gate, of the update gate and of the proposed memory."""
    return [rows[first : first + units] for first in range(0, len(rows), units)]
