"""Layers of a network, as a file gives them one after another."""

import math
from typing import Any

import numpy as np

from drake_quad.scenario.policies.trained_network import TrainedNetwork

# Largest limit on the output of a layer. Adding and subtracting it costs at most 1e-10 of accuracy.
_MAX_LIMIT = 1e6
_Gates = tuple[np.ndarray, np.ndarray]


class UnreadableError(Exception):
    """Error in a file of a network."""


class Layers:
    """Sequence of layers with their numbers.

    Elementwise arithmetic after an activation is merged into the weights and biases of the next layer. If there is no
    next layer, it becomes a layer of its own.
    """

    def __init__(self) -> None:
        self.layers: list[dict[str, Any]] = []
        self._numbers: list[np.ndarray] = []
        self.prepared: dict[str, Any] = {}
        # Pending factor and summand of the output of the last layer, or of the input after its limit.
        self._waiting: tuple[np.ndarray, np.ndarray] | None = None

    def dense(
        self, weights: np.ndarray, biases: np.ndarray, activation: str = "identity", alpha: float | None = None
    ) -> None:
        """Add a dense layer with weights (outputs, inputs) and biases (outputs,)."""
        if weights.ndim != 2 or biases.shape != weights.shape[:1]:
            raise UnreadableError(f"has weights of shape {weights.shape} beside biases of shape {biases.shape}")
        outputs, inputs = weights.shape
        weights, biases = self._taken_in(weights, biases)
        layer = {"kind": "dense", "inputs": inputs, "outputs": outputs, "activation": activation, "alpha": alpha}
        self.layers.append(layer)
        self._numbers += [weights, biases]

    def gru(self, of_input: _Gates, of_memory: _Gates, initial: np.ndarray | None) -> None:
        """Add gated recurrent units with weights and biases, whose gates follow one another."""
        gates, units = of_memory[0].shape if of_memory[0].ndim == 2 else (0, 0)
        inputs = of_input[0].shape[-1] if of_input[0].ndim == 2 else 0
        initial = np.zeros(units) if initial is None else initial.ravel()
        shapes = [each.shape for each in (of_input[0], of_input[1], of_memory[1], initial)]
        if gates != 3 * units or shapes != [(gates, inputs), (gates,), (gates,), (units,)]:
            raise UnreadableError("has gated recurrent units whose weights and biases do not fit together")
        of_input = self._taken_in(*of_input)
        self.layers.append({"kind": "gru", "inputs": inputs, "outputs": units})
        self._numbers += [*of_input, *of_memory, initial]

    def change(self, factor: np.ndarray, summand: np.ndarray) -> None:
        """Multiply each row of the present output, or of the input, by a factor, and then add a summand."""
        factor, summand = np.ravel(factor), np.ravel(summand)
        if not self.layers and "limit" not in self.prepared:
            self._prepare(factor, summand)
        elif self.layers and self.layers[-1].get("activation") == "identity":
            *before, weights, biases = self._numbers
            factor, summand = (self._sized(each, biases.size) for each in (factor, summand))
            self._numbers = [*before, weights * factor[:, np.newaxis], biases * factor + summand]
        else:
            before_factor, before_summand = self._waiting or (np.ones(1), np.zeros(1))
            try:
                self._waiting = before_factor * factor, before_summand * factor + summand
            except ValueError:
                raise UnreadableError("has arithmetic with arrays of different sizes") from None

    def clip(self, limit: float) -> None:
        """Hold the input within a limit on both sides of zero."""
        if "limit" in self.prepared:
            raise UnreadableError("limits its input twice")
        self.prepared["limit"] = limit

    def hold(self, low: float, high: float) -> None:
        """Hold the present output within limits, of which either may be infinite.

        With r(x) = max(x, 0), max(x, low) is low + r(x - low), and min(x, high) is high - r(high - x).

        Raises:
            UnreadableError: if a finite limit is so large that the sums would lose digits.
        """
        one = np.ones(1)
        if any(_MAX_LIMIT < abs(limit) < math.inf for limit in (low, high)):
            raise UnreadableError(f"has a limit of more than {_MAX_LIMIT:g} on the output of a layer")
        if math.isfinite(low):
            self.change(one, -low * one)
            self.activate("relu")
            self.change(one, low * one)
        if math.isfinite(high):
            self.change(-one, high * one)
            self.activate("relu")
            self.change(-one, high * one)

    def activate(self, activation: str, alpha: float | None = None) -> None:
        """Set the activation of the last layer, with its parameter if it has one."""
        if self.layers and self._waiting is not None:
            self._settle()
        if not self.layers or self.layers[-1].get("activation") != "identity":
            raise UnreadableError(f"has an activation {activation} that follows no layer of neurons")
        self.layers[-1] |= {"activation": activation, "alpha": alpha}

    def network(self) -> TrainedNetwork:
        """Return the network of all layers."""
        if not self.layers:
            raise UnreadableError("has no layers")
        if self._waiting is not None:
            self._settle()
        for name in ("offset", "scale"):
            if len(self.prepared.get(name, ())) == 1:
                self.prepared[name] *= self.layers[0]["inputs"]
        numbers = np.concatenate([np.asarray(each, dtype=float).ravel() for each in self._numbers])
        if not np.isfinite(numbers).all():
            raise UnreadableError("has numbers that are not finite")
        return TrainedNetwork.of(tuple(self.layers), numbers, **self.prepared)

    def _prepare(self, factor: np.ndarray, summand: np.ndarray) -> None:
        """Merge elementwise arithmetic on the input into the offset and the scale of the network."""
        known = (np.ravel(self.prepared.get(name, value)) for name, value in (("offset", 0.0), ("scale", 1.0)))
        try:
            offset, scale, factor, summand = np.broadcast_arrays(*known, factor, summand)
        except ValueError:
            raise UnreadableError("has arithmetic on its input with arrays of different sizes") from None
        if not (scale * factor).all():
            raise UnreadableError("multiplies its input by zero")
        scale = scale * factor
        self.prepared |= {"offset": tuple((offset - summand / scale).tolist()), "scale": tuple(scale.tolist())}

    def _taken_in(self, weights: np.ndarray, biases: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the weights and biases of a layer after merging the pending arithmetic into them."""
        if self._waiting is None:
            return weights, biases
        factor, summand = (self._sized(each, weights.shape[1]) for each in self._waiting)
        self._waiting = None
        return weights * factor, biases + weights @ summand

    def _settle(self) -> None:
        """Add a layer for the pending arithmetic."""
        width = self.layers[-1]["outputs"]
        self.dense(np.eye(width), np.zeros(width))

    def _sized(self, numbers: np.ndarray, count: int) -> np.ndarray:
        try:
            return np.broadcast_to(numbers, (count,))
        except ValueError:
            raise UnreadableError(f"has arithmetic of other than {count} numbers behind {count} neurons") from None
