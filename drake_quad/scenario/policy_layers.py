"""Layers of a network, as a file gives them one after another."""

from typing import Any

import numpy as np

from drake_quad.scenario.policy import TrainedNetwork


class UnreadableError(Exception):
    """What is wrong with a file."""


class Layers:
    """Layers and their numbers, one after another."""

    def __init__(self) -> None:
        self.layers: list[dict[str, Any]] = []
        self._numbers: list[np.ndarray] = []
        self.prepared: dict[str, Any] = {}

    def dense(self, weights: np.ndarray, biases: np.ndarray, activation: str = "identity") -> None:
        """Adds neurons of these weights (outputs, inputs) and biases (outputs,)."""
        if weights.ndim != 2 or biases.shape != weights.shape[:1]:
            raise UnreadableError(f"has weights of shape {weights.shape} beside biases of shape {biases.shape}")
        outputs, inputs = weights.shape
        self.layers.append({"kind": "dense", "inputs": inputs, "outputs": outputs, "activation": activation})
        self._numbers += [weights, biases]

    def gru(
        self,
        of_input: tuple[np.ndarray, np.ndarray],
        of_memory: tuple[np.ndarray, np.ndarray],
        initial: np.ndarray | None,
    ) -> None:
        """Adds gated recurrent units of these weights and biases, gate after gate."""
        gates, units = of_memory[0].shape if of_memory[0].ndim == 2 else (0, 0)
        inputs = of_input[0].shape[-1] if of_input[0].ndim == 2 else 0
        initial = np.zeros(units) if initial is None else initial.ravel()
        shapes = [each.shape for each in (of_input[0], of_input[1], of_memory[1], initial)]
        if gates != 3 * units or shapes != [(gates, inputs), (gates,), (gates,), (units,)]:
            raise UnreadableError("has gated recurrent units whose weights and biases do not fit together")
        self.layers.append({"kind": "gru", "inputs": inputs, "outputs": units})
        self._numbers += [*of_input, *of_memory, initial]

    def change(self, factor: np.ndarray, summand: np.ndarray) -> None:
        """Multiplies each row of what comes out until now, or of the input, and adds to it then."""
        if not self.layers:
            if "limit" in self.prepared:
                raise UnreadableError("has arithmetic behind the limit of its input")
            known = (np.ravel(self.prepared.get(name, value)) for name, value in (("offset", 0.0), ("scale", 1.0)))
            try:
                offset, scale, factor, summand = np.broadcast_arrays(*known, np.ravel(factor), np.ravel(summand))
            except ValueError:
                raise UnreadableError("has arithmetic on its input with arrays of different sizes") from None
            if not (scale * factor).all():
                raise UnreadableError("multiplies its input by zero")
            scale = scale * factor
            self.prepared |= {"offset": tuple((offset - summand / scale).tolist()), "scale": tuple(scale.tolist())}
            return
        if self.layers[-1].get("activation") != "identity":
            raise UnreadableError("has arithmetic behind an activation or a recurrent layer")
        *before, weights, biases = self._numbers
        try:
            factor, summand = (np.broadcast_to(np.ravel(each), biases.shape) for each in (factor, summand))
        except ValueError:
            raise UnreadableError(
                f"has arithmetic of other than {biases.size} numbers behind {biases.size} neurons"
            ) from None
        self._numbers = [*before, weights * factor[:, np.newaxis], biases * factor + summand]

    def clip(self, limit: float) -> None:
        """Holds the input within a limit on both sides of zero."""
        if "limit" in self.prepared:
            raise UnreadableError("limits its input twice")
        self.prepared["limit"] = limit

    def activate(self, activation: str) -> None:
        """Gives the last layer an activation."""
        if not self.layers or self.layers[-1].get("activation") != "identity":
            raise UnreadableError(f"has an activation {activation} that follows no layer of neurons")
        self.layers[-1]["activation"] = activation

    def network(self) -> TrainedNetwork:
        """The network."""
        if not self.layers:
            raise UnreadableError("has no layers")
        for name in ("offset", "scale"):
            if len(self.prepared.get(name, ())) == 1:
                self.prepared[name] *= self.layers[0]["inputs"]
        numbers = np.concatenate([np.asarray(each, dtype=float).ravel() for each in self._numbers])
        if not np.isfinite(numbers).all():
            raise UnreadableError("has numbers that are not finite")
        return TrainedNetwork.of(tuple(self.layers), numbers, **self.prepared)
