"""Conversion of layers and elementwise arithmetic in a network file to a trained network."""

import math
from typing import Any

import numpy as np

from drake_quad.scenario.policies.trained_network import TrainedNetwork

# Largest limit on the output of a layer. Adding and subtracting such a limit causes rounding errors of at most 1e-10.
_MAX_LIMIT = 1e6
_Gates = tuple[np.ndarray, np.ndarray]


class UnreadableError(Exception):
    """Error raised for a network file that cannot be read. The message is a clause without a subject."""


class Layers:
    """Sequence of layers with their weights and biases, built up by successive calls.

    Elementwise arithmetic after an activation is merged into the next layer's weights and biases. If there is no next
    layer, the arithmetic becomes an additional layer.

    Attributes:
        layers: fields of each layer, as in `TrainedNetwork.layers`.
        preprocessing: `offset`, `scale` and `limit` of `TrainedNetwork`, if the network has them.
    """

    def __init__(self) -> None:
        self.layers: list[dict[str, Any]] = []
        self._numbers: list[np.ndarray] = []
        self.preprocessing: dict[str, Any] = {}
        # Factor and summand that are not yet merged into a layer. They apply to the output of the last layer or, before
        # the first layer, to the limited input.
        self._pending: tuple[np.ndarray, np.ndarray] | None = None

    def dense(
        self, weights: np.ndarray, biases: np.ndarray, activation: str = "identity", alpha: float | None = None
    ) -> None:
        """Add a dense layer with weights (outputs, inputs) and biases (outputs,)."""
        if weights.ndim != 2 or biases.shape != weights.shape[:1]:
            raise UnreadableError(f"has weights of shape {weights.shape} and biases of shape {biases.shape}")
        outputs, inputs = weights.shape
        weights, biases = self._with_pending(weights, biases)
        layer = {"kind": "dense", "inputs": inputs, "outputs": outputs, "activation": activation, "alpha": alpha}
        self.layers.append(layer)
        self._numbers += [weights, biases]

    def gru(self, input_gates: _Gates, hidden_gates: _Gates, initial: np.ndarray | None) -> None:
        """Add gated recurrent units, whose weights and biases are stacked in the order reset, update, new gate.

        Args:
            input_gates: weights (3 units, inputs) and biases (3 units,) of the input.
            hidden_gates: weights (3 units, units) and biases (3 units,) of the hidden state.
            initial: initial hidden state, with `units` numbers; None for zero.
        """
        gates, units = hidden_gates[0].shape if hidden_gates[0].ndim == 2 else (0, 0)
        inputs = input_gates[0].shape[-1] if input_gates[0].ndim == 2 else 0
        initial = np.zeros(units) if initial is None else initial.ravel()
        shapes = [each.shape for each in (input_gates[0], input_gates[1], hidden_gates[1], initial)]
        if gates != 3 * units or shapes != [(gates, inputs), (gates,), (gates,), (units,)]:
            raise UnreadableError("has gated recurrent units with weights and biases of inconsistent shapes")
        input_gates = self._with_pending(*input_gates)
        self.layers.append({"kind": "gru", "inputs": inputs, "outputs": units})
        self._numbers += [*input_gates, *hidden_gates, initial]

    def scale_and_shift(self, factor: np.ndarray, summand: np.ndarray) -> None:
        """Scale and shift each element of the last layer's output, or of the input if there is no layer."""
        factor, summand = np.ravel(factor), np.ravel(summand)
        if not self.layers and "limit" not in self.preprocessing:
            self._prepare(factor, summand)
        elif self.layers and self.layers[-1].get("activation") == "identity":
            *before, weights, biases = self._numbers
            factor, summand = (self._broadcast(each, biases.size) for each in (factor, summand))
            self._numbers = [*before, weights * factor[:, np.newaxis], biases * factor + summand]
        else:
            before_factor, before_summand = self._pending or (np.ones(1), np.zeros(1))
            try:
                self._pending = before_factor * factor, before_summand * factor + summand
            except ValueError:
                raise UnreadableError("has arithmetic with arrays of different sizes") from None

    def limit_input(self, limit: float) -> None:
        """Limit each element of the input to [-limit, limit]."""
        if "limit" in self.preprocessing:
            raise UnreadableError("limits its input twice")
        self.preprocessing["limit"] = limit

    def limit_output(self, low: float, high: float) -> None:
        """Limit each element of the last layer's output to [low, high], where either limit may be infinite.

        With r(x) = max(x, 0), max(x, low) is low + r(x - low), and min(x, high) is high - r(high - x).

        Raises:
            UnreadableError: if a finite limit is so large that these sums would lose accuracy.
        """
        one = np.ones(1)
        if any(_MAX_LIMIT < abs(limit) < math.inf for limit in (low, high)):
            raise UnreadableError(f"has a limit larger than {_MAX_LIMIT:g} on the output of a layer")
        if math.isfinite(low):
            self.scale_and_shift(one, -low * one)
            self.activate("relu")
            self.scale_and_shift(one, low * one)
        if math.isfinite(high):
            self.scale_and_shift(-one, high * one)
            self.activate("relu")
            self.scale_and_shift(-one, high * one)

    def activate(self, activation: str, alpha: float | None = None) -> None:
        """Set the activation of the last layer, with its parameter if it has one."""
        if self.layers and self._pending is not None:
            self._add_pending_layer()
        if not self.layers or self.layers[-1].get("activation") != "identity":
            raise UnreadableError(f"has an activation {activation} that does not follow a dense layer")
        self.layers[-1] |= {"activation": activation, "alpha": alpha}

    def network(self) -> TrainedNetwork:
        """Return the network that consists of all layers."""
        if not self.layers:
            raise UnreadableError("has no layers")
        if self._pending is not None:
            self._add_pending_layer()
        for name in ("offset", "scale"):
            if len(self.preprocessing.get(name, ())) == 1:
                self.preprocessing[name] *= self.layers[0]["inputs"]
        numbers = np.concatenate([np.asarray(each, dtype=float).ravel() for each in self._numbers])
        if not np.isfinite(numbers).all():
            raise UnreadableError("has numbers that are not finite")
        return TrainedNetwork.of(tuple(self.layers), numbers, **self.preprocessing)

    def _prepare(self, factor: np.ndarray, summand: np.ndarray) -> None:
        """Merge elementwise arithmetic on the input into the network's offset and scale."""
        known = (np.ravel(self.preprocessing.get(name, value)) for name, value in (("offset", 0.0), ("scale", 1.0)))
        try:
            offset, scale, factor, summand = np.broadcast_arrays(*known, factor, summand)
        except ValueError:
            raise UnreadableError("has arithmetic on its input with arrays of different sizes") from None
        if not (scale * factor).all():
            raise UnreadableError("multiplies its input by zero")
        scale = scale * factor
        self.preprocessing |= {"offset": tuple((offset - summand / scale).tolist()), "scale": tuple(scale.tolist())}

    def _with_pending(self, weights: np.ndarray, biases: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Merge the pending arithmetic into a layer's weights and biases, and return them."""
        if self._pending is None:
            return weights, biases
        factor, summand = (self._broadcast(each, weights.shape[1]) for each in self._pending)
        self._pending = None
        return weights * factor, biases + weights @ summand

    def _add_pending_layer(self) -> None:
        """Add a layer for the pending arithmetic."""
        width = self.layers[-1]["outputs"]
        self.dense(np.eye(width), np.zeros(width))

    def _broadcast(self, numbers: np.ndarray, count: int) -> np.ndarray:
        try:
            return np.broadcast_to(numbers, (count,))
        except ValueError:
            raise UnreadableError(
                f"has arithmetic of {count} neurons with {numbers.size} numbers; there must be one number per neuron"
            ) from None
