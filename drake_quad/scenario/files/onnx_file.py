"""Networks of policies from ONNX: a chain of nodes from the observation to the action.

Nodes that do not affect the action, such as the value function of an actor-critic network, are ignored. If there are
several outputs, the action is the chosen output, or else the one with this name, or else the first one.
"""

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from drake_quad.control.policy.network import GELU_CUBE, WITH_ALPHA
from drake_quad.errors import InputWarning, listed, shortened, shown
from drake_quad.extras import import_extra
from drake_quad.scenario.policies.layers import Layers, UnreadableError
from drake_quad.scenario.policies.trained_network import TrainedNetwork

_ACTIVATIONS = {
    "Tanh": "tanh",
    "Relu": "relu",
    "Sigmoid": "sigmoid",
    "Elu": "elu",
    "LeakyRelu": "leaky_relu",
    "Swish": "silu",
    "Gelu": "gelu",
}
# Names by which the action is found among several outputs.
_ACTIONS = ("action", "actions")
# Domains of the standard operators; those of other domains, such as onnxruntime's optimiser, have other definitions.
_DOMAINS = ("", "ai.onnx")
# Relative error of a constant in single precision, and of a product of several of them.
_SINGLE = 1e-6
_SPELLED_TOLERANCE = 1e-5
# Largest number of successive nodes, and of all nodes, that form a gate.
_MAX_LEVELS = 10
_MAX_GATE_NODES = 40
# Nodes that change no number of one observation.
_SILENT = ("Identity", "Flatten", "Reshape", "Squeeze", "Unsqueeze", "Transpose", "Cast", "Dropout")
# Of constants, what is computed.
_OF_ONE = ("Constant", "Neg", "Sqrt", "Reciprocal", *_SILENT)
_OF_TWO = ("Add", "Sub", "Mul", "Div")
# Arithmetic in gates.
_ARITHMETIC = {"Add": np.add, "Sub": np.subtract, "Mul": np.multiply, "Div": np.divide, "Pow": np.power}
# Bounds that exporters write for "none", such as the largest number in single precision, are not below this one.
_UNBOUNDED = 3e38
# Numbers that stand for themselves: FLOAT and DOUBLE of ONNX.
_FLOATS = (1, 11)


class _SpelledOut(NamedTuple):
    """Activation x · gate(x) that is exported as several nodes.

    Attributes:
        kind: kind of the single node with the same meaning.
        attributes: attributes of that node.
        slope: coefficient of x in the argument of the gate's function.
        cube: coefficient of x³ in that argument, divided by `slope`.
        offset: number that the gate adds to its function.
    """

    kind: str
    attributes: Mapping[str, Any]
    slope: float
    cube: float
    offset: float


# Activations by the function of their gate.
_SPELLED_OUT = {
    "Sigmoid": _SpelledOut("Swish", {}, 1.0, 0.0, 0.0),
    "Erf": _SpelledOut("Gelu", {}, math.sqrt(0.5), 0.0, 1.0),
    "Tanh": _SpelledOut("Gelu", {"approximate": b"tanh"}, math.sqrt(2.0 / math.pi), GELU_CUBE, 1.0),
}


def network_of_onnx(data: bytes, file: str, output: str | None = None) -> tuple[TrainedNetwork, str]:
    """Read a network; if none of several outputs is chosen, a warning names the one that is the action.

    The network is returned with a remark for messages on it, which names that output, or is empty.

    Args:
        data: content of the file.
        file: name of the file in the warning.
        output: name of the output that is the action.

    Raises:
        UnreadableError: if the data are not a network, or the network has no such output, branches, or unsupported
            nodes.
        ImportError: the library onnx is not installed.
    """
    onnx = import_extra("onnx", "onnx")
    try:
        model = onnx.load_from_string(data)
    except Exception:  # the parser's own, of several kinds
        raise UnreadableError("is not an ONNX model") from None
    if any(onnx.external_data_helper.uses_external_data(each) for each in model.graph.initializer):
        raise UnreadableError("keeps its numbers in another file; export it with external_data=False")
    known = onnx.defs.onnx_opset_version()
    for each in model.opset_import:
        if each.domain in _DOMAINS and not 1 <= each.version <= known:
            raise UnreadableError(f"has opset {each.version}, while onnx {onnx.__version__} knows 1 to {known}")
    try:
        onnx.checker.check_model(model)
    except Exception as error:  # likewise
        raise UnreadableError(f"is not an ONNX model as it should be: {shortened(str(error), 120)}") from None
    layers, remark = Layers(), ""
    graph = _Graph(model, output)
    if output is None and len(graph.outputs) > 1:
        names = f"of its outputs {listed(graph.outputs)}, {shortened(graph.action)} is taken for the action"
        remark = f" (output {shortened(graph.action)}; FILE.onnx:NAME chooses another)"
        warnings.warn(f"{file}: {names}; {file}:NAME chooses another", InputWarning, stacklevel=2)
    for k, node in enumerate(chain := graph.chain()):
        _add(layers, node, is_last=all(each.kind in _SILENT for each in chain[k + 1 :]))
    return layers.network(), remark


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
    """ONNX graph in which all values that do not depend on the input are computed.

    Args:
        model: ONNX model that contains the graph.
        output: name of the output that is the action; None if none is chosen.

    Attributes:
        outputs: names of the outputs.
        action: name of the output that is the action.

    Raises:
        UnreadableError: if the graph has several inputs, no outputs or not the chosen one, or operators of another
            domain.
    """

    def __init__(self, model: Any, output: str | None) -> None:
        self._onnx, self._opsets, graph = import_extra("onnx", "onnx"), model.opset_import, model.graph
        self._known = {each.name: self._array(each) for each in graph.initializer}
        self._makers = {name: node for node in graph.node for name in node.output if name}
        self._inputs = [each.name for each in graph.input if each.name not in self._known]
        self.outputs = [each.name for each in graph.output]
        if not self.outputs:
            raise UnreadableError("has no outputs")
        if output is not None and output not in self.outputs:
            raise UnreadableError(f"has no output {shown(output)}; it has {listed(self.outputs)}")
        self.action = output or min(self.outputs, key=lambda name: name.lower() not in _ACTIONS)
        if len(self._inputs) != 1:
            names = listed(self._inputs)
            raise UnreadableError(f"has the inputs {names}, but must have one" if names else "has no inputs")
        other = next((node for node in graph.node if node.domain not in _DOMAINS), None)
        if other is not None:
            raise UnreadableError(
                f"has a node {shortened(other.op_type)} of {shortened(other.domain)}; export it without optimisation"
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
        """Compute the outputs of a node whose inputs are known."""
        helper = self._onnx.helper
        names = [*dict.fromkeys(node.input)]
        arrays = [self._onnx.numpy_helper.from_array(self._known[name], name) for name in names]
        outputs = [helper.make_empty_tensor_value_info(name) for name in node.output]
        graph = helper.make_graph([node], "constant", [], outputs, arrays)
        model = helper.make_model(graph, opset_imports=self._opsets)
        try:
            found = self._onnx.reference.ReferenceEvaluator(model).run(None, {})
        except Exception as error:  # the evaluator's own, of several kinds
            raise UnreadableError(f"has a node {node.op_type} of constants that cannot be computed") from error
        self._known |= dict(zip(node.output, found, strict=False))

    def chain(self) -> list[_Node]:
        """Return the nodes from the input to the action.

        Raises:
            UnreadableError: if the nodes do not form a chain.
        """
        name, (last,) = self.action, self._inputs
        nodes: list[_Node] = []
        while name != last:
            node = self._makers.get(name)
            if node is None:
                raise UnreadableError(f"has an output that does not depend on its input {last}")
            attributes = {each.name: self._onnx.helper.get_attribute_value(each) for each in node.attribute}
            coming = [k for k, each in enumerate(node.input) if each and each not in self._known]
            gated = self._gated(node) if node.op_type == "Mul" and len(coming) == 2 else None
            if gated is not None:
                found, name = gated
                nodes += found[::-1]
                continue
            if not coming:
                raise UnreadableError(f"has an output that does not depend on its input {last}")
            if len(coming) > 1 or (name != node.output[0] and node.op_type != "GRU"):
                spelled = "; export activations as nodes, with opset 20 or later" if node.op_type in _OF_TWO else ""
                raise UnreadableError(
                    f"has branches that meet in a node {node.op_type}, but must be a chain of layers{spelled}"
                )
            given = [self._known.get(each) for each in node.input]
            nodes.append(_Node(node.op_type, given, coming[0], attributes))
            name = node.input[coming[0]]
        return nodes[::-1]

    def _gated(self, node: Any) -> tuple[list[_Node], str] | None:
        """Return the nodes that a product of a value and its gate represents, and the name of their input.

        Exporters write SiLU and GELU in this form for opsets that have no node for them. With u = s z, the product
        k z (offset + F(slope (u + cube u³))) is (1 + offset) k / s times the activation of u. F is the function of the
        gate, and `_SPELLED_OUT` contains the three numbers of the activation. The order of arithmetic with constants
        does not matter, since the product and the argument of F are compared with these formulas at a few points. The
        result is None for any other product.
        """
        names = [node.output[0]]
        for name in names:
            maker = self._makers.get(name)
            if maker is not None and maker.op_type in _ARITHMETIC and len(names) < _MAX_GATE_NODES:
                names += [each for each in maker.input if each not in self._known and each not in names]
        kinds = {name: self._makers[name].op_type for name in names if name in self._makers}
        gate = next((name for name, kind in kinds.items() if kind in _SPELLED_OUT), None)
        if gate is None:
            return None
        spelled, argument = _SPELLED_OUT[kinds[gate]], self._makers[gate].input[0]
        z, g = np.array([1.0, 2.0, -1.0, 3.0]), np.array([1.0, 0.5, 0.25, -1.0])
        for base in names:
            inside = np.broadcast_to(self._value(argument, {base: z}), z.shape)
            product = np.broadcast_to(self._value(node.output[0], {base: z, gate: g}), z.shape)
            scale = ((8.0 * inside[0] - inside[1]) / 6.0 if spelled.cube else inside[0]) / spelled.slope
            factor = product[0] / (g[0] + spelled.offset)
            pairs = (
                (inside, spelled.slope * (scale * z + spelled.cube * (scale * z) ** 3)),
                (product, factor * z * (g + spelled.offset)),
            )
            if scale and all(np.allclose(*pair, rtol=_SPELLED_TOLERANCE, atol=0.0) for pair in pairs):
                scale = 1.0 if abs(scale - 1.0) < _SINGLE else scale
                factors = scale, (1.0 + spelled.offset) * factor / scale
                numbers = [_Node("Mul", [None, np.array(each)], 0, {}) for each in factors]
                before, after = ([each] if each.given[1] != 1.0 else [] for each in numbers)
                return [*before, _Node(spelled.kind, [None], 0, spelled.attributes), *after], base
        return None

    def _value(self, name: str, given: Mapping[str, Any], levels: int = _MAX_LEVELS) -> Any:
        """Return the numbers of a value, given those of other values; NaN if it is no arithmetic of these.

        Args:
            name: name of the value.
            given: numbers by name.
            levels: largest number of nodes in between.
        """
        if name in given:
            return given[name]
        if name in self._known:
            number = self._known[name]
            return float(number.item()) if number.size == 1 else math.nan
        maker = self._makers.get(name)
        if levels == 0 or maker is None or maker.op_type not in _ARITHMETIC:
            return math.nan
        return _ARITHMETIC[maker.op_type](*(self._value(each, given, levels - 1) for each in maker.input))


def _stays_small(kind: str, given: Sequence[Any]) -> bool:
    """Return whether the result of a node is certainly not larger than the constants that it takes."""
    if kind in _OF_TWO:
        return min(each.size for each in given) == 1 or len({each.shape for each in given}) == 1
    return kind in _OF_ONE


def _add(layers: Layers, node: _Node, *, is_last: bool) -> None:
    """Add the operation of a node to the layers."""
    rule = _RULES.get(node.kind)
    if rule is not None:
        rule(layers, node)
    elif node.kind == "Clip":
        _clip(layers, node, is_last=is_last)
    elif node.kind in _ACTIVATIONS:
        layers.activate(*_activation(node))
    elif node.kind not in _SILENT:
        known = [*_RULES, "Clip", *_ACTIVATIONS]
        raise UnreadableError(f"has a node {node.kind} that is not known here; known are {listed(known)}")
    elif node.kind == "Cast" and node.attributes["to"] not in _FLOATS:
        raise UnreadableError("has a Cast to numbers that are not of single or double precision")


def _activation(node: _Node) -> tuple[str, float | None]:
    """Return the name of an activation, and its parameter if that is not the default."""
    name, alpha = _ACTIVATIONS[node.kind], node.attributes.get("alpha")
    if name == "gelu":
        approximated = node.attributes.get("approximate", b"none")
        if approximated not in (b"none", b"tanh"):
            raise UnreadableError(f"has a Gelu with an approximation {shown(approximated)}; it must be none or tanh")
        return "gelu_tanh" if approximated == b"tanh" else "gelu", None
    if alpha is not None and name not in WITH_ALPHA and alpha != 1.0:
        raise UnreadableError(f"has an activation {node.kind} with an alpha of {alpha:g}, not 1")
    return name, float(alpha) if name in WITH_ALPHA and alpha is not None else None


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
    """Add gated recurrent units, whose gates ONNX has in the order update, reset, new."""
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
    """Add a limit; a limit of the action at or beyond -1 and 1 is ignored, since actions are always within [-1, 1]."""
    attributes = [node.attributes.get(name) for name in ("min", "max")]  # up to opset 10 the limits are attributes
    bounds = attributes if len(node.given) == 1 else [*node.given[1:], None][:2]
    if node.place or any(np.size(each) != 1 for each in bounds if each is not None):
        raise UnreadableError("has a Clip whose bounds are not constant numbers")
    low, high = (
        side * math.inf if each is None or abs(float(np.ravel(each)[0])) >= _UNBOUNDED else float(np.ravel(each)[0])
        for side, each in zip((-1.0, 1.0), bounds, strict=True)
    )
    if not layers.layers:
        if low != -high or not math.isfinite(high):
            raise UnreadableError(
                f"has a Clip of the input to {low:g} and {high:g}; only limits of the same size on both sides of zero"
                " are supported"
            )
        layers.clip(high)
    elif not (is_last and low <= -1.0 and high >= 1.0):
        layers.hold(low, high)


_RULES: dict[str, Callable[[Layers, _Node], None]] = {
    "Gemm": _gemm,
    "MatMul": _matmul,
    "GRU": _gru,
    "Add": _arithmetic,
    "Sub": _arithmetic,
    "Mul": _arithmetic,
    "Div": _arithmetic,
}
