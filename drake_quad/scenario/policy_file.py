"""Networks of policies from files: NumPy's .npz, and ONNX.

An .npz file has, for layer k counted from 0, `weights_k` (outputs, inputs) and `biases_k` (outputs,), and perhaps
`activation_k`, a word; or, of gated recurrent units, `weights_input_k` (3 units, inputs), `biases_input_k`,
`weights_hidden_k` (3 units, units), `biases_hidden_k` (3 units,), those of reset, update and new gates one after
another, and perhaps `initial_k` (units,). Beside them it may have `offset`, `scale` (inputs,) and `limit`.
"""

import io
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from drake_quad.errors import InputError, listed
from drake_quad.extras import needed
from drake_quad.scenario.limits import MOST_NETWORK_BYTES
from drake_quad.scenario.marked_tree import Mark, Tree
from drake_quad.scenario.policy import TrainedNetwork
from drake_quad.scenario.reading import opened

# Of a file: its numbers may be of double precision though single would do.
_MOST_BYTES = 8 * MOST_NETWORK_BYTES
_ACTIVATIONS = {
    "Tanh": "tanh",
    "Relu": "relu",
    "Sigmoid": "sigmoid",
    "Elu": "elu",
}
# Nodes of ONNX that change no number.
_SILENT = ("Identity", "Flatten", "Reshape", "Squeeze", "Unsqueeze", "Cast", "Dropout")


class _UnreadableError(Exception):
    """What is wrong with a file."""


class _Layers:
    """Layers and their numbers, one after another."""

    def __init__(self) -> None:
        self.layers: list[dict[str, Any]] = []
        self._numbers: list[np.ndarray] = []
        self.prepared: dict[str, Any] = {}

    def dense(self, weights: np.ndarray, biases: np.ndarray, activation: str = "identity") -> None:
        """Adds neurons of these weights (outputs, inputs) and biases (outputs,)."""
        if weights.ndim != 2 or biases.shape != weights.shape[:1]:
            raise _UnreadableError(f"has weights of shape {weights.shape} beside biases of shape {biases.shape}")
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
        initial = np.zeros(units) if initial is None else initial.ravel()
        shapes = [each.shape for each in (of_input[0], of_input[1], of_memory[1], initial)]
        if gates != 3 * units or shapes != [(gates, shapes[0][-1]), (gates,), (gates,), (units,)]:
            raise _UnreadableError("has gated recurrent units whose weights and biases do not fit together")
        self.layers.append({"kind": "gru", "inputs": shapes[0][1], "outputs": units})
        self._numbers += [*of_input, *of_memory, initial]

    def change(self, factor: np.ndarray, summand: np.ndarray) -> None:
        """Multiplies each row of what comes out until now, or of the input, and adds to it then."""
        if not self.layers:
            scale = np.ones(1) * np.ravel(self.prepared.get("scale", 1.0)) * np.ravel(factor)
            if not scale.all():
                raise _UnreadableError("multiplies its input by zero")
            offset = np.ravel(self.prepared.get("offset", 0.0)) - np.ravel(summand) / scale
            self.prepared |= {"offset": tuple(offset.tolist()), "scale": tuple(scale.tolist())}
            return
        if self.layers[-1].get("activation") != "identity":
            raise _UnreadableError("has arithmetic behind an activation or a recurrent layer")
        *before, weights, biases = self._numbers
        factor, summand = (np.broadcast_to(np.ravel(each), biases.shape) for each in (factor, summand))
        self._numbers = [*before, weights * factor[:, np.newaxis], biases * factor + summand]

    def activate(self, activation: str) -> None:
        """Gives the last layer an activation."""
        if not self.layers or self.layers[-1].get("activation") != "identity":
            raise _UnreadableError(f"has an activation {activation} that follows no layer of neurons")
        self.layers[-1]["activation"] = activation

    def network(self) -> TrainedNetwork:
        """The network."""
        if not self.layers:
            raise _UnreadableError("has no layers")
        numbers = np.concatenate([np.asarray(each, dtype=float).ravel() for each in self._numbers])
        if not np.isfinite(numbers).all():
            raise _UnreadableError("has numbers that are not finite")
        return TrainedNetwork.of(tuple(self.layers), numbers, **self.prepared)


def policy_network(path: Path) -> Tree:
    """Reads a network as the mapping `policy` of a control.

    Args:
        path: of an .npz or .onnx file.

    Raises:
        InputError: the file cannot be read, is none such, or has layers that are not known here.
    """
    mark = Mark(str(path), 0)
    read = {".npz": _of_npz, ".onnx": _of_onnx}.get(path.suffix.lower())
    if read is None:
        raise InputError(f"{mark}: is not a network that can be read: its name must end in .npz or .onnx")
    with opened(path) as file:
        data = file.read(_MOST_BYTES + 1)
    if len(data) > _MOST_BYTES:
        raise InputError(f"{mark}: is too large: a network may have {MOST_NETWORK_BYTES:,} bytes of numbers")
    try:
        network = read(data)
    except _UnreadableError as error:
        raise InputError(f"{mark}: {error}") from None
    except ImportError as error:
        raise InputError(f"{mark}: cannot be read: {error}") from None
    except ValidationError as error:
        raise InputError(f"{mark}: is no network: {error.errors(include_url=False)[0]['msg']}") from None
    fields = network.model_dump(mode="json", exclude_defaults=True)
    return _tree(fields, mark)


def _tree(value: Any, mark: Mark) -> Tree:
    if isinstance(value, Mapping):
        return Tree({name: _tree(part, mark) for name, part in value.items()}, mark)
    if isinstance(value, list | tuple):
        return Tree([_tree(part, mark) for part in value], mark)
    return Tree(value, mark)


def _of_npz(data: bytes) -> TrainedNetwork:
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
    except (ValueError, OSError, EOFError, KeyError, zipfile.BadZipFile):
        raise _UnreadableError("is not an .npz file of arrays") from None
    layers, k = _Layers(), 0
    while True:
        names = [name for name in arrays if name.endswith(f"_{k}")]
        if not names:
            break
        own = {name.removesuffix(f"_{k}"): arrays.pop(name) for name in names}
        if "weights" in own:
            layers.dense(*_numbers(own, "weights", "biases"), str(own.pop("activation", "identity")))
        else:
            of_input, of_memory = (_numbers(own, f"weights_{of}", f"biases_{of}") for of in ("input", "hidden"))
            layers.gru(of_input, of_memory, own.pop("initial", None))
        if own:
            raise _UnreadableError(f"has arrays that belong to no layer: {listed([f'{name}_{k}' for name in own])}")
        k += 1
    for name in ("offset", "scale"):
        if name in arrays:
            layers.prepared[name] = tuple(arrays.pop(name).astype(float).ravel().tolist())
    if "limit" in arrays:
        layers.prepared["limit"] = float(arrays.pop("limit"))
    if arrays:
        raise _UnreadableError(f"has arrays that belong to no layer: {listed([*arrays])}")
    return layers.network()


def _numbers(own: dict[str, np.ndarray], weights: str, biases: str) -> tuple[np.ndarray, np.ndarray]:
    for name in (weights, biases):
        if name not in own:
            raise _UnreadableError(f"has a layer without {name}")
        if own[name].dtype.kind not in "fiu":
            raise _UnreadableError(f"has {name} that are no numbers")
    return own.pop(weights).astype(float), own.pop(biases).astype(float)


def _of_onnx(data: bytes) -> TrainedNetwork:
    onnx = needed("onnx", "onnx")
    try:
        graph = onnx.load_from_string(data).graph
    except Exception:  # the parser's own, of several kinds
        raise _UnreadableError("is not an ONNX model") from None
    constants = {each.name: onnx.numpy_helper.to_array(each) for each in graph.initializer}
    layers = _Layers()
    for node in graph.node:
        attributes = {each.name: onnx.helper.get_attribute_value(each) for each in node.attribute}
        if node.op_type == "Constant":
            constants[node.output[0]] = onnx.numpy_helper.to_array(attributes["value"])
            continue
        given = [constants.get(name) for name in node.input]
        _add_node(layers, node.op_type, given, attributes)
    return layers.network()


def _add_node(layers: _Layers, kind: str, given: list[np.ndarray | None], attributes: Mapping[str, Any]) -> None:
    """Adds what a node of ONNX does to what comes in, the only one of its inputs that is no constant."""
    constants = [each for each in given if each is not None]
    match kind, constants:
        case "Gemm", [weights, *biases]:
            weights = weights * attributes.get("alpha", 1.0)
            weights = weights if attributes.get("transB", 0) else weights.T
            summand = attributes.get("beta", 1.0) * biases[0] if biases else np.zeros(1)
            layers.dense(weights, np.broadcast_to(summand, len(weights)))
        case "MatMul", [weights] if given[0] is None:
            layers.dense(weights.T, np.zeros(weights.shape[-1]))
        case "MatMul", [weights]:
            layers.dense(weights, np.zeros(len(weights)))
        case "Add", [constant]:
            layers.change(np.ones(1), constant)
        case "Sub", [constant] if given[0] is None:
            layers.change(np.ones(1), -constant)
        case "Mul", [constant]:
            layers.change(constant, np.zeros(1))
        case "Div", [constant] if given[0] is None:
            layers.change(1.0 / constant, np.zeros(1))
        case "GRU", [of_input, of_memory, *biases]:
            _add_gru(layers, of_input, of_memory, biases, attributes)
        case "Clip", [low, high] if not layers.layers and low == -high:
            layers.prepared["limit"] = float(high)
        case _ if kind in _ACTIVATIONS:
            layers.activate(_ACTIVATIONS[kind])
        case _ if kind in _SILENT:
            pass
        case _:
            raise _UnreadableError(
                f"has a node {kind} that is not known here; known are Gemm, MatMul, GRU, Add, Sub, Mul, Div, Clip of"
                f" the input, {listed([*_ACTIVATIONS])}"
            )


def _add_gru(
    layers: _Layers,
    of_input: np.ndarray,
    of_memory: np.ndarray,
    biases: list[np.ndarray],
    attributes: Mapping[str, Any],
) -> None:
    """Adds gated recurrent units, whose gates ONNX has in the order update, reset, new."""
    if attributes.get("linear_before_reset", 0) != 1 or len(of_input) != 1:
        raise _UnreadableError("has a GRU in two directions, or with the reset gate before the product")
    units = of_memory.shape[-1]
    both = biases[0][0] if biases else np.zeros(6 * units)
    order = np.r_[units : 2 * units, :units, 2 * units : 3 * units]
    inner, outer = np.split(both, 2)
    initial = biases[1] if len(biases) > 1 else None
    layers.gru((of_input[0][order], inner[order]), (of_memory[0][order], outer[order]), initial)
