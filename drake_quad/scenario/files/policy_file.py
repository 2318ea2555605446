"""Reading of a policy network from a NumPy .npz file or an ONNX file.

An .npz file contains, for each layer k (counted from 0), the arrays of one of two layer types:

- Dense layer: `weights_k` (outputs, inputs) and `biases_k` (outputs,), and optionally the name `activation_k` and its
  parameter `alpha_k`.
- Gated recurrent units: `weights_input_k` (3 units, inputs), `biases_input_k` (3 units,), `weights_hidden_k` (3 units,
  units) and `biases_hidden_k` (3 units,), with the reset, update and new gates in this order, and optionally
  `initial_k` (units,).

In addition the file may contain `offset` (inputs,), `scale` (inputs,) and `limit`.
"""

import io
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from drake_quad.errors import InputError, join_names
from drake_quad.files import read_arrays
from drake_quad.scenario.files.marked_tree import Mark, Tree
from drake_quad.scenario.files.onnx_file import network_of_onnx
from drake_quad.scenario.files.reading import read_bytes
from drake_quad.scenario.limits import MAX_NETWORK_BYTES
from drake_quad.scenario.policies.layers import Layers, UnreadableError
from drake_quad.scenario.policies.trained_network import TrainedNetwork

# A file may be larger than the policy network, since it may use double precision and contain other networks, such as a
# critic.
_MAX_FILE_BYTES = 8 * MAX_NETWORK_BYTES
# Kinds of layers. Pydantic adds them to the paths of its errors.
_LAYER_KINDS = ("dense", "gru")


def policy_network(path: Path, output: str | None = None) -> Tree:
    """Read a network as the mapping `policy` of a control.

    Args:
        path: path of an .npz or .onnx file.
        output: name of the output that is the action, for an .onnx file with several outputs.

    Raises:
        InputError: if the file cannot be read, has another format, or has unsupported layers.
    """
    mark = Mark(str(path), 0)
    readers: dict[str, Callable[[bytes], tuple[TrainedNetwork, str]]] = {
        ".npz": lambda data: (_of_npz(data), ""),
        ".onnx": partial(network_of_onnx, file=str(mark), output=output),
    }
    read = readers.get(path.suffix.lower())
    if read is None:
        raise InputError(f"{mark}: is not a readable network: its name must end in .npz or .onnx")
    data = read_bytes(path, _MAX_FILE_BYTES, f"the file of a network may have at most {_MAX_FILE_BYTES:,} bytes")
    try:
        # Arithmetic on the constants in a file may overflow. Validation later rejects numbers that are not finite.
        with np.errstate(all="ignore"):
            network, remark = read(data)
    except UnreadableError as error:
        raise InputError(f"{mark}: {error}") from None
    except ImportError as error:
        raise InputError(f"{mark}: cannot be read: {error}") from None
    except ValidationError as error:
        problem = error.errors(include_url=False)[0]
        steps = (*problem["loc"], *problem.get("ctx", {}).get("path", ()))
        location = ".".join([str(step) for step in steps if step not in _LAYER_KINDS])
        demand = problem["msg"].replace("Input should", "must")
        raise InputError(f"{mark}: the network cannot be flown: {location} {demand}".replace("  ", " ")) from None
    fields = network.model_dump(mode="json", exclude_defaults=True)
    return Tree.of(fields, mark._replace(remark=remark))


def _of_npz(data: bytes) -> TrainedNetwork:
    try:
        arrays = read_arrays(io.BytesIO(data), max_bytes=_MAX_FILE_BYTES)
    except ValueError as error:
        raise UnreadableError(str(error)) from None
    for name, array in arrays.items():
        if array.dtype.kind not in ("U" if name.startswith("activation_") else "fiu"):
            raise UnreadableError(f"has an array {name} of type {array.dtype}, which must be numeric")
    layers, k = Layers(), 0
    while True:
        names = [name for name in arrays if name.endswith(f"_{k}")]
        if not names:
            break
        layer_arrays = {name.removesuffix(f"_{k}"): arrays.pop(name) for name in names}
        if "weights" in layer_arrays:
            activation, alpha = str(layer_arrays.pop("activation", "identity")), layer_arrays.pop("alpha", None)
            parameter = None if alpha is None else _single(alpha, f"alpha_{k}")
            layers.dense(*_numbers(layer_arrays, "weights", "biases"), activation, parameter)
        else:
            input_gates, hidden_gates = (
                _numbers(layer_arrays, f"weights_{of}", f"biases_{of}") for of in ("input", "hidden")
            )
            initial = layer_arrays.pop("initial", None)
            layers.gru(input_gates, hidden_gates, None if initial is None else initial.astype(float))
        if layer_arrays:
            raise UnreadableError(f"has unknown arrays: {join_names([f'{name}_{k}' for name in layer_arrays])}")
        k += 1
    for name in ("offset", "scale"):
        if name in arrays:
            layers.preprocessing[name] = tuple(arrays.pop(name).astype(float).ravel().tolist())
    if "limit" in arrays:
        layers.preprocessing["limit"] = _single(arrays.pop("limit"), "limit")
    if arrays:
        raise UnreadableError(f"has unknown arrays: {join_names([*arrays])}")
    return layers.network()


def _single(array: np.ndarray, name: str) -> float:
    if array.size != 1:
        raise UnreadableError(f"has an array {name} with {array.size} numbers, but must contain one number")
    return float(array.item())


def _numbers(arrays: dict[str, np.ndarray], weights: str, biases: str) -> tuple[np.ndarray, np.ndarray]:
    for name in (weights, biases):
        if name not in arrays:
            raise UnreadableError(f"has a layer without {name}")
    return arrays.pop(weights).astype(float), arrays.pop(biases).astype(float)
