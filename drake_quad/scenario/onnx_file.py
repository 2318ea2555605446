"""Networks of policies from ONNX: a chain of nodes from the observation to the action.

A file may have more, such as the value of an actor-critic behind the same layers: only what the output needs is read.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from drake_quad.errors import listed, shortened
from drake_quad.extras import needed
from drake_quad.scenario.policy import TrainedNetwork
from drake_quad.scenario.policy_layers import Layers, UnreadableError

_ACTIVATIONS = {"Tanh": "tanh", "Relu": "relu", "Sigmoid": "sigmoid", "Elu": "elu", "Swish": "silu"}
# Nodes that change no number of one observation.
_SILENT = ("Identity", "Flatten", "Reshape", "Squeeze", "Unsqueeze", "Transpose", "Cast", "Dropout")
# Of constants, what is computed.
_OF_ONE = ("Constant", "Neg", "Sqrt", "Reciprocal", *_SILENT)
_OF_TWO = ("Add", "Sub", "Mul", "Div")
# Numbers that stand for themselves: FLOAT and DOUBLE of ONNX.
_FLOATS = (1, 11)


def network_of_onnx(data: bytes) -> TrainedNetwork:
    """Reads a network.

    Args:
        data: of the file.

    Raises:
        UnreadableError: it is none, has branches, or nodes that are not known here.
        ImportError: the library onnx is not installed.
    """
    onnx = needed("onnx", "onnx")
    try:
        model = onnx.load_from_string(data)
    except Exception:  # the parser's own, of several kinds
        raise UnreadableError("is not an ONNX model") from None
    if any(onnx.external_data_helper.uses_external_data(each) for each in model.graph.initializer):
        raise UnreadableError("keeps its numbers in another file; export it with external_data=False")
    try:
        onnx.checker.check_model(model)
    except Exception as error:  # likewise
        raise UnreadableError(f"is not an ONNX model as it should be: {shortened(str(error), 120)}") from None
    layers = Layers()
    for k, node in enumerate(chain := _Graph(model.graph).chain()):
        _add(layers, node, is_last=all(each.kind in _SILENT for each in chain[k + 1 :]))
    return layers.network()


class _Node:
    """A node of a chain.

    Attributes:
        kind: what it does.
        given: its inputs; None stands for what comes along the chain, and for what is left out.
        place: of what comes along the chain among them.
        attributes: by their names.
    """

    def __init__(self, kind: str, given: list[np.ndarray | None], place: int, attributes: Mapping[str, Any]) -> None:
        self.kind, self.given, self.place, self.attributes = kind, given, place, attributes


class _Graph:
    """A graph of ONNX, whose numbers are known where they do not depend on its input."""

    def __init__(self, graph: Any) -> None:
        self._onnx = needed("onnx", "onnx")
        self._known = {each.name: self._array(each) for each in graph.initializer}
        self._makers = {name: node for node in graph.node for name in node.output if name}
        self._inputs = [each.name for each in graph.input if each.name not in self._known]
        self._outputs = [each.name for each in graph.output]
        for what, names in (("inputs", self._inputs), ("outputs", self._outputs)):
            if len(names) != 1:
                raise UnreadableError(
                    f"has the {what} {listed(names)}, but must have one" if names else f"has no {what}"
                )
        # In their order, in which what a node takes stands before it.
        for node in graph.node:
            given = [self._known.get(name) for name in node.input]
            if all(each is not None for each in given) and _stays_small(node.op_type, given):
                self._compute(node)

    def _array(self, tensor: Any) -> np.ndarray:
        try:
            array: np.ndarray = self._onnx.numpy_helper.to_array(tensor)
        except Exception:  # NumPy's and the parser's own, of several kinds
            raise UnreadableError(f"has an array {shortened(tensor.name)} that cannot be read") from None
        return array

    def _compute(self, node: Any) -> None:
        """Makes known what a node gives whose inputs are."""
        helper = self._onnx.helper
        names = [*dict.fromkeys(node.input)]
        arrays = [self._onnx.numpy_helper.from_array(self._known[name], name) for name in names]
        outputs = [helper.make_empty_tensor_value_info(name) for name in node.output]
        model = helper.make_model(helper.make_graph([node], "constant", [], outputs, arrays))
        try:
            found = self._onnx.reference.ReferenceEvaluator(model).run(None, {})
        except Exception as error:  # the evaluator's own, of several kinds
            raise UnreadableError(f"has a node {node.op_type} of constants that cannot be computed") from error
        self._known |= dict(zip(node.output, found, strict=False))

    def chain(self) -> list[_Node]:
        """The nodes from the input to the output.

        Raises:
            UnreadableError: there is no such chain.
        """
        (name,), (last,) = self._outputs, self._inputs
        nodes: list[_Node] = []
        while name != last:
            node = self._makers.get(name)
            if node is None:
                raise UnreadableError(f"has an output that does not depend on its input {last}")
            attributes = {each.name: self._onnx.helper.get_attribute_value(each) for each in node.attribute}
            coming = [k for k, each in enumerate(node.input) if each and each not in self._known]
            gated = self._gated(node)
            if gated is not None:
                nodes.append(_Node("Swish", [None], 0, {}))
                name = gated
                continue
            if not coming:
                raise UnreadableError(f"has an output that does not depend on its input {last}")
            if len(coming) > 1 or (name != node.output[0] and node.op_type != "GRU"):
                raise UnreadableError(f"has branches that meet in a node {node.op_type}, but must be a chain of layers")
            given = [self._known.get(each) for each in node.input]
            nodes.append(_Node(node.op_type, given, coming[0], attributes))
            name = node.input[coming[0]]
        return nodes[::-1]

    def _gated(self, node: Any) -> str | None:
        """The name of x if a node is x sigmoid(x), as PyTorch writes SiLU."""
        if node.op_type != "Mul":
            return None
        for x, gate in (node.input, node.input[::-1]):
            maker = self._makers.get(gate)
            if maker is not None and maker.op_type == "Sigmoid" and [*maker.input] == [x]:
                return str(x)
        return None


def _stays_small(kind: str, given: Sequence[Any]) -> bool:
    """Whether what a node makes of constants is known to be no larger than these, and so is computed."""
    if kind in _OF_TWO:
        return min(each.size for each in given) == 1 or len({each.shape for each in given}) == 1
    return kind in _OF_ONE


def _add(layers: Layers, node: _Node, *, is_last: bool) -> None:
    """Adds what a node does to what comes along the chain."""
    rule = _RULES.get(node.kind)
    if rule is not None:
        rule(layers, node)
    elif node.kind == "Clip":
        _clip(layers, node, is_last=is_last)
    elif node.kind in _ACTIVATIONS:
        if node.attributes.get("alpha", 1.0) != 1.0:
            raise UnreadableError(f"has an activation {node.kind} with an alpha of {node.attributes['alpha']:g}, not 1")
        layers.activate(_ACTIVATIONS[node.kind])
    elif node.kind not in _SILENT:
        known = [*_RULES, "Clip of the input", *_ACTIVATIONS]
        raise UnreadableError(f"has a node {node.kind} that is not known here; known are {listed(known)}")
    elif node.kind == "Cast" and node.attributes["to"] not in _FLOATS:
        raise UnreadableError("has a Cast to numbers that are not of single or double precision")


def _gemm(layers: Layers, node: _Node) -> None:
    attributes = node.attributes
    _, weights, *biases = [*node.given, None]
    if node.place or weights is None or attributes.get("transA", 0):
        raise UnreadableError("has a Gemm that multiplies no matrix by what comes in")
    weights = _matrix(weights) * attributes.get("alpha", 1.0)
    weights = weights if attributes.get("transB", 0) else weights.T
    summand = np.zeros(1) if biases[0] is None else attributes.get("beta", 1.0) * np.ravel(biases[0])
    layers.dense(weights, np.zeros(len(weights)))
    layers.change(np.ones(1), summand)


def _matmul(layers: Layers, node: _Node) -> None:
    (constant,) = (_matrix(each) for each in node.given if each is not None)
    weights = constant if node.place else constant.T
    layers.dense(weights, np.zeros(len(weights)))


def _matrix(array: np.ndarray) -> np.ndarray:
    if array.ndim != 2:
        raise UnreadableError(f"has weights of shape {array.shape}, but they must be a matrix")
    return array.astype(float)


def _arithmetic(layers: Layers, node: _Node) -> None:
    (constant,) = (np.ravel(each).astype(float) for each in node.given if each is not None)
    one, none = np.ones(1), np.zeros(1)
    match node.kind, node.place:
        case "Add", _:
            layers.change(one, constant)
        case "Sub", 0:
            layers.change(one, -constant)
        case "Sub", _:
            layers.change(-one, constant)
        case "Mul", _:
            layers.change(constant, none)
        case "Div", 0 if constant.all():
            layers.change(1.0 / constant, none)
        case _:
            raise UnreadableError("divides by zero, or by what comes in")


def _gru(layers: Layers, node: _Node) -> None:
    """Adds gated recurrent units, whose gates ONNX has in the order update, reset, new."""
    attributes = node.attributes
    _, of_input, of_memory, both, lengths, initial = [*node.given, None, None, None][:6]
    if attributes.get("linear_before_reset", 0) != 1 or attributes.get("direction", b"forward") != b"forward":
        raise UnreadableError("has a GRU that runs backwards, or with the reset gate before the product")
    usual = [each.decode().lower() for each in attributes.get("activations", [b"sigmoid", b"tanh"])]
    if usual != ["sigmoid", "tanh"] or "clip" in attributes or lengths is not None:
        raise UnreadableError("has a GRU with activations of its own, a clip, or lengths of sequences")
    if node.place or of_input is None or of_memory is None or of_input.ndim != 3 or of_memory.ndim != 3:
        raise UnreadableError("has a GRU without weights")
    units = of_memory.shape[-1]
    both = np.zeros((1, 6 * units)) if both is None else both
    if of_input.shape[:2] != (1, 3 * units) or both.shape != (1, 6 * units):
        raise UnreadableError("has a GRU whose weights and biases do not fit together")
    order = np.r_[units : 2 * units, :units, 2 * units : 3 * units]
    inner, outer = np.split(both[0], 2)
    layers.gru((of_input[0][order], inner[order]), (of_memory[0][order], outer[order]), initial)


def _clip(layers: Layers, node: _Node, *, is_last: bool) -> None:
    """Takes over a limit of the input; actions have theirs, from -1 to 1, anyway."""
    bounds = [*node.given[1:], None, None][:2]
    low, high = (None if each is None or each.size != 1 else float(each.item()) for each in bounds)
    if node.place or low is None or high is None:
        raise UnreadableError("has a Clip without two bounds")
    if not layers.layers and low == -high:
        layers.clip(high)
    elif not (layers.layers and is_last and low <= -1.0 and high >= 1.0):
        raise UnreadableError("has a Clip that is neither of the input, to as much on both sides, nor of actions")


_RULES: dict[str, Callable[[Layers, _Node], None]] = {
    "Gemm": _gemm,
    "MatMul": _matmul,
    "GRU": _gru,
    "Add": _arithmetic,
    "Sub": _arithmetic,
    "Mul": _arithmetic,
    "Div": _arithmetic,
}
