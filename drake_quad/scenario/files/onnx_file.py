"""Reading of a policy network from an ONNX model, as a chain of nodes from the observation to the action.

Nodes that do not affect the action, such as the value function of an actor-critic network, are ignored. If the model
has several outputs, the action is the selected output. If none is selected, it is the output named `action` or
`actions`, or the first output if there is no such name.
"""

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from drake_quad.control.policy.network import GELU_CUBIC_COEFFICIENT, WITH_ALPHA, Network, evaluate_network
from drake_quad.errors import InputWarning, join_names, short_repr, shorten_text
from drake_quad.extras import import_extra
from drake_quad.scenario.policies.layers import Layers, UnreadableError
from drake_quad.scenario.policies.trained_network import TrainedNetwork

# Names of activation functions in the scenario language, by ONNX operator.
_ACTIVATIONS = {
    "Tanh": "tanh",
    "Relu": "relu",
    "Sigmoid": "sigmoid",
    "Elu": "elu",
    "LeakyRelu": "leaky_relu",
    "Swish": "silu",
    "Gelu": "gelu",
}
# Output names that identify the action if there are several outputs.
_ACTION_NAMES = ("action", "actions")
# ONNX domains of the standard operators. In other domains, such as that of onnxruntime's optimiser, the same names can
# have other meanings.
_STANDARD_DOMAINS = ("", "ai.onnx")
# Relative rounding error of a constant in single precision.
_CONSTANT_TOLERANCE = 1e-6
# A gate is the factor of x in an activation function x · gate(x), such as SiLU. Its formula is recognised with this
# relative tolerance, the rounding error of a product of several single-precision constants.
_GATE_TOLERANCE = 1e-5
# Largest depth of the arithmetic expression that forms a gate.
_MAX_GATE_DEPTH = 10
# Largest number of nodes that form a gate.
_MAX_GATE_NODES = 40
# Operators that leave a single observation unchanged.
_NEUTRAL_NODES = ("Identity", "Flatten", "Reshape", "Squeeze", "Unsqueeze", "Transpose", "Cast", "Dropout")
# Operators with at most one input whose result is computed in advance if the input is constant.
_UNARY_NODES = ("Constant", "Neg", "Sqrt", "Reciprocal", *_NEUTRAL_NODES)
# Operators with two inputs whose result is computed in advance if both inputs are constant.
_BINARY_NODES = ("Add", "Sub", "Mul", "Div")
# Python functions of the arithmetic operators that may form a gate.
_ARITHMETIC = {"Add": np.add, "Sub": np.subtract, "Mul": np.multiply, "Div": np.divide, "Pow": np.power}
# Bounds of at least this magnitude mean "no bound". Exporters write, for example, the largest single-precision number.
_MIN_UNBOUNDED = 3e38
# Number of random observations for which a network is compared with ONNX's reference evaluator.
_NUM_CHECKED_OBSERVATIONS = 2
# ONNX type codes of FLOAT and DOUBLE.
_FLOAT_TYPES = (1, 11)


class _GatedActivation(NamedTuple):
    """Activation function x · gate(x), which some exporters write as several nodes.

    The gate is proportional to offset + F(slope (x + cube x³)) with a function F such as tanh.

    Attributes:
        kind: operator of the single node that computes the same activation.
        attributes: attributes of this single node.
        slope: coefficient of x in the argument of F.
        cube: coefficient of x³ in the argument of F, divided by `slope`.
        offset: constant that is added to F.
    """

    kind: str
    attributes: Mapping[str, Any]
    slope: float
    cube: float
    offset: float


# Gated activations, by the operator that computes F.
_GATED_ACTIVATIONS = {
    "Sigmoid": _GatedActivation("Swish", {}, 1.0, 0.0, 0.0),
    "Erf": _GatedActivation("Gelu", {}, math.sqrt(0.5), 0.0, 1.0),
    "Tanh": _GatedActivation("Gelu", {"approximate": b"tanh"}, math.sqrt(2.0 / math.pi), GELU_CUBIC_COEFFICIENT, 1.0),
}


def network_of_onnx(data: bytes, file: str, output: str | None = None) -> tuple[TrainedNetwork, str]:
    """Read a policy network from an ONNX model.

    If the model has several outputs and none is selected, a warning states which output is used as the action.

    Args:
        data: content of the file.
        file: name of the file in the warning.
        output: name of the output that is the action; None if none is selected.

    Returns:
        The network, and a remark for later error messages that names the assumed output; empty if there was no warning.

    Raises:
        UnreadableError: if the data are not an ONNX model, or the model lacks the selected output, has branches, or
            has unsupported nodes.
        ImportError: if the library onnx is not installed.
    """
    onnx = import_extra("onnx", "onnx")
    try:
        model = onnx.load_from_string(data)
    except Exception:  # the parser raises exceptions of several types
        raise UnreadableError("is not an ONNX model") from None
    if any(onnx.external_data_helper.uses_external_data(each) for each in model.graph.initializer):
        raise UnreadableError("stores its weights in another file; export it with external_data=False")
    known = onnx.defs.onnx_opset_version()
    for each in model.opset_import:
        if each.domain in _STANDARD_DOMAINS and not 1 <= each.version <= known:
            raise UnreadableError(f"has opset {each.version}, but onnx {onnx.__version__} supports 1 to {known}")
    try:
        onnx.checker.check_model(model)
    except Exception as error:  # the checker raises exceptions of several types
        raise UnreadableError(f"is not a valid ONNX model: {shorten_text(str(error), 120)}") from None
    layers, remark = Layers(), ""
    graph = _Graph(model, output)
    if output is None and len(graph.outputs) > 1:
        remark = f" (output {shorten_text(graph.action)}; FILE.onnx:NAME selects another)"
        warnings.warn(
            f"{file}: has the outputs {join_names(graph.outputs)}, of which {shorten_text(graph.action)} is used as the"
            f" action; {file}:NAME selects another",
            InputWarning,
            stacklevel=2,
        )
    for k, node in enumerate(chain := graph.chain()):
        _add(layers, node, is_last=all(each.kind in _NEUTRAL_NODES for each in chain[k + 1 :]))
    trained = layers.network()
    _check_result(model, graph, trained.network())
    return trained, remark


def _check_result(model: Any, graph: "_Graph", network: Network) -> None:
    """Compare a network with ONNX's reference evaluator, for random observations.

    Nodes that only change the shape of a single observation are skipped when a network is read. This comparison finds
    models in which such nodes also exchange values. Actions are compared between -1 and 1, to which they are limited.

    Raises:
        UnreadableError: if the results differ.
    """
    evaluator = import_extra("onnx", "onnx").reference.ReferenceEvaluator(model)
    observations = np.random.default_rng(0).normal(size=(_NUM_CHECKED_OBSERVATIONS, network.num_inputs))
    for observation in observations:
        try:
            expected = evaluator.run([graph.action], {graph.input: graph.shaped(observation)})[0]
        except Exception:  # the evaluator does not support all opsets, and raises exceptions of several types
            return
        actual = np.array(evaluate_network(network, observation.tolist(), network.memory).output)
        size = np.size(expected)
        if size != len(actual) or not np.allclose(
            np.clip(actual, -1.0, 1.0), np.clip(np.ravel(expected), -1.0, 1.0), rtol=1e-3, atol=1e-3
        ):
            raise UnreadableError(
                "exchanges values between its layers, or has an input or output of several rows, so that it is not a"
                " chain of layers for a single observation"
            )


class _Node:
    """Node in a chain of ONNX nodes.

    Attributes:
        kind: operator of the node, such as "Gemm".
        constants: constant inputs of the node; None for the output of the previous node in the chain, and for omitted
            inputs.
        chain_index: index of the input that is the output of the previous node.
        attributes: attributes of the node, by name.
    """

    def __init__(
        self, kind: str, constants: list[np.ndarray | None], chain_index: int, attributes: Mapping[str, Any]
    ) -> None:
        self.kind, self.constants, self.chain_index, self.attributes = kind, constants, chain_index, attributes


class _Graph:
    """ONNX graph whose constant expressions have been computed.

    Args:
        model: ONNX model that contains the graph.
        output: name of the output that is the action; None if none is selected.

    Attributes:
        outputs: names of the outputs.
        action: name of the output that is the action.

    Raises:
        UnreadableError: if the graph has several inputs or no outputs, lacks the selected output, or contains operators
            outside `_STANDARD_DOMAINS`.
    """

    def __init__(self, model: Any, output: str | None) -> None:
        self._onnx, self._opsets, graph = import_extra("onnx", "onnx"), model.opset_import, model.graph
        self._constants = {each.name: self._array(each) for each in graph.initializer}
        self._producers = {name: node for node in graph.node for name in node.output if name}
        self._graph = graph
        self._inputs = [each.name for each in graph.input if each.name not in self._constants]
        self.outputs = [each.name for each in graph.output]
        if not self.outputs:
            raise UnreadableError("has no outputs")
        if output is not None and output not in self.outputs:
            raise UnreadableError(f"has no output {short_repr(output)}; its outputs are {join_names(self.outputs)}")
        self.action = output or min(self.outputs, key=lambda name: name.lower() not in _ACTION_NAMES)
        if len(self._inputs) != 1:
            names = join_names(self._inputs)
            raise UnreadableError(f"has the inputs {names}, but must have only one" if names else "has no inputs")
        other = next((node for node in graph.node if node.domain not in _STANDARD_DOMAINS), None)
        if other is not None:
            raise UnreadableError(
                f"has a node {shorten_text(other.op_type)} of {shorten_text(other.domain)}; export it without"
                " optimisation"
            )
        # ONNX sorts nodes topologically, so that the inputs of a node are computed before it.
        for node in graph.node:
            inputs = [self._constants.get(name) for name in node.input]
            if all(each is not None for each in inputs) and _does_not_grow(node.op_type, inputs):
                self._compute(node)

    @property
    def input(self) -> str:
        """Name of the input."""
        return self._inputs[0]

    def shaped(self, observation: np.ndarray) -> np.ndarray:
        """Return an observation (n,) with the declared type and shape of the input; unknown lengths are 1.

        A GRU whose input is the observation has the shape that its operator requires: steps, batch, n.

        Raises:
            ValueError: if the observation does not have this shape.
        """
        declared = next(each for each in self._graph.input if each.name == self.input).type.tensor_type
        shape = [each.dim_value or 1 for each in declared.shape.dim] or [1, -1]
        if any(node.op_type == "GRU" and node.input[0] == self.input for node in self._graph.node):
            shape = [1, 1, -1]
        elif math.prod(shape) == 1:
            shape[-1] = -1
        return observation.reshape(shape).astype(self._onnx.helper.tensor_dtype_to_np_dtype(declared.elem_type))

    def _array(self, tensor: Any) -> np.ndarray:
        try:
            array: np.ndarray = self._onnx.numpy_helper.to_array(tensor)
        except Exception:  # NumPy and the parser raise exceptions of several types
            raise UnreadableError(f"has an array {shorten_text(tensor.name)} that cannot be read") from None
        return array

    def _compute(self, node: Any) -> None:
        """Compute the outputs of a node whose inputs are constant, and add them to the constants."""
        helper = self._onnx.helper
        names = [*dict.fromkeys(node.input)]
        arrays = [self._onnx.numpy_helper.from_array(self._constants[name], name) for name in names]
        outputs = [helper.make_empty_tensor_value_info(name) for name in node.output]
        graph = helper.make_graph([node], "constant", [], outputs, arrays)
        model = helper.make_model(graph, opset_imports=self._opsets)
        try:
            results = self._onnx.reference.ReferenceEvaluator(model).run(None, {})
        except Exception as error:  # the evaluator raises exceptions of several types
            raise UnreadableError(f"has a node {node.op_type} with constant inputs that cannot be computed") from error
        self._constants |= dict(zip(node.output, results, strict=False))

    def chain(self) -> list[_Node]:
        """Return the nodes from the input to the action.

        Raises:
            UnreadableError: if the nodes do not form a chain.
        """
        name, (last,) = self.action, self._inputs
        nodes: list[_Node] = []
        while name != last:
            node = self._producers.get(name)
            if node is None:
                raise UnreadableError(f"has an output that does not depend on its input {last}")
            attributes = {each.name: self._onnx.helper.get_attribute_value(each) for each in node.attribute}
            variable = [k for k, each in enumerate(node.input) if each and each not in self._constants]
            gated = self._gated_activation(node) if node.op_type == "Mul" and len(variable) == 2 else None
            if gated is not None:
                gate_nodes, name = gated
                nodes += gate_nodes[::-1]
                continue
            if not variable:
                raise UnreadableError(f"has an output that does not depend on its input {last}")
            if len(variable) > 1 or (name != node.output[0] and node.op_type != "GRU"):
                hint = "; export activations as nodes, with opset 20 or later" if node.op_type in _BINARY_NODES else ""
                raise UnreadableError(
                    f"has branches that meet in a node {node.op_type}, but must be a chain of layers{hint}"
                )
            constants = [self._constants.get(each) for each in node.input]
            nodes.append(_Node(node.op_type, constants, variable[0], attributes))
            name = node.input[variable[0]]
        return nodes[::-1]

    def _gated_activation(self, node: Any) -> tuple[list[_Node], str] | None:
        """Return nodes that replace a gated activation, and the name of their input; None for any other product.

        For opsets without nodes for SiLU and GELU, exporters write these activations as the product of a value and a
        gate. F, `slope`, `cube` and `offset` are defined in `_GatedActivation`. If u = s z, the product
        k z (offset + F(slope (u + cube u³))) is (1 + offset) k / s times the activation of u. The product and the
        argument of F are compared with these formulas at a few points, so the order of arithmetic with constants does
        not matter.
        """
        names = [node.output[0]]
        for name in names:
            producer = self._producers.get(name)
            if producer is not None and producer.op_type in _ARITHMETIC and len(names) < _MAX_GATE_NODES:
                names += [each for each in producer.input if each not in self._constants and each not in names]
        kinds = {name: self._producers[name].op_type for name in names if name in self._producers}
        gate = next((name for name, kind in kinds.items() if kind in _GATED_ACTIVATIONS), None)
        if gate is None:
            return None
        activation, argument = _GATED_ACTIVATIONS[kinds[gate]], self._producers[gate].input[0]
        z, g = np.array([1.0, 2.0, -1.0, 3.0]), np.array([1.0, 0.5, 0.25, -1.0])
        for base in names:
            inside = np.broadcast_to(self._value(argument, {base: z}), z.shape)
            product = np.broadcast_to(self._value(node.output[0], {base: z, gate: g}), z.shape)
            scale = ((8.0 * inside[0] - inside[1]) / 6.0 if activation.cube else inside[0]) / activation.slope
            factor = product[0] / (g[0] + activation.offset)
            pairs = (
                (inside, activation.slope * (scale * z + activation.cube * (scale * z) ** 3)),
                (product, factor * z * (g + activation.offset)),
            )
            if scale and all(np.allclose(*pair, rtol=_GATE_TOLERANCE, atol=0.0) for pair in pairs):
                scale = 1.0 if abs(scale - 1.0) < _CONSTANT_TOLERANCE else scale
                factors = scale, (1.0 + activation.offset) * factor / scale
                scalings = [_Node("Mul", [None, np.array(each)], 0, {}) for each in factors]
                before, after = ([each] if each.constants[1] != 1.0 else [] for each in scalings)
                return [*before, _Node(activation.kind, [None], 0, activation.attributes), *after], base
        return None

    def _value(self, name: str, known: Mapping[str, Any], depth: int = _MAX_GATE_DEPTH) -> Any:
        """Return a value of the graph, computed from known values by arithmetic; NaN if this is not possible.

        Args:
            name: name of the value.
            known: known values by name.
            depth: largest number of successive nodes between the known values and this value.
        """
        if name in known:
            return known[name]
        if name in self._constants:
            number = self._constants[name]
            return float(number.item()) if number.size == 1 else math.nan
        producer = self._producers.get(name)
        if depth == 0 or producer is None or producer.op_type not in _ARITHMETIC:
            return math.nan
        return _ARITHMETIC[producer.op_type](*(self._value(each, known, depth - 1) for each in producer.input))


def _does_not_grow(kind: str, inputs: Sequence[Any]) -> bool:
    """Return whether the result of a node is certain to have no more elements than its constant inputs."""
    if kind in _BINARY_NODES:
        return min(each.size for each in inputs) == 1 or len({each.shape for each in inputs}) == 1
    return kind in _UNARY_NODES


def _add(layers: Layers, node: _Node, *, is_last: bool) -> None:
    """Append the operation of a node to the layers.

    Args:
        layers: layers of the preceding nodes.
        node: node to add.
        is_last: True if no later node changes the output.
    """
    handler = _NODE_HANDLERS.get(node.kind)
    if handler is not None:
        handler(layers, node)
    elif node.kind == "Clip":
        _clip(layers, node, is_last=is_last)
    elif node.kind in _ACTIVATIONS:
        layers.activate(*_activation(node))
    elif node.kind not in _NEUTRAL_NODES:
        supported = [*_NODE_HANDLERS, "Clip", *_ACTIVATIONS]
        raise UnreadableError(f"has an unsupported node {node.kind}; supported are {join_names(supported)}")
    elif node.kind == "Cast" and node.attributes["to"] not in _FLOAT_TYPES:
        raise UnreadableError("has a Cast to a type other than single or double precision")


def _activation(node: _Node) -> tuple[str, float | None]:
    """Return the name of an activation function and its parameter alpha, which is None if it is not given."""
    name, alpha = _ACTIVATIONS[node.kind], node.attributes.get("alpha")
    if name == "gelu":
        approximated = node.attributes.get("approximate", b"none")
        if approximated not in (b"none", b"tanh"):
            raise UnreadableError(
                f"has a Gelu with approximation {short_repr(approximated)}, which must be none or tanh"
            )
        return "gelu_tanh" if approximated == b"tanh" else "gelu", None
    if alpha is not None and name not in WITH_ALPHA and alpha != 1.0:
        raise UnreadableError(f"has an activation {node.kind} with an alpha of {alpha:g}, which must be 1")
    return name, float(alpha) if name in WITH_ALPHA and alpha is not None else None


def _gemm(layers: Layers, node: _Node) -> None:
    attributes = node.attributes
    _, weights, *biases = [*node.constants, None]
    if node.chain_index or weights is None or attributes.get("transA", 0):
        raise UnreadableError("has a Gemm that does not multiply its input by a constant matrix")
    weights = _matrix(weights) * attributes.get("alpha", 1.0)
    weights = weights if attributes.get("transB", 0) else weights.T
    summand = np.zeros(1) if biases[0] is None else attributes.get("beta", 1.0) * np.ravel(biases[0])
    layers.dense(weights, np.zeros(len(weights)))
    layers.scale_and_shift(np.ones(1), summand)


def _matmul(layers: Layers, node: _Node) -> None:
    (constant,) = (_matrix(each) for each in node.constants if each is not None)
    weights = constant if node.chain_index else constant.T
    layers.dense(weights, np.zeros(len(weights)))


def _matrix(array: np.ndarray) -> np.ndarray:
    if array.ndim != 2:
        raise UnreadableError(f"has weights of shape {array.shape}, which must be a matrix")
    return array.astype(float)


def _arithmetic(layers: Layers, node: _Node) -> None:
    (constant,) = (np.ravel(each).astype(float) for each in node.constants if each is not None)
    one, zero = np.ones(1), np.zeros(1)
    match node.kind, node.chain_index:
        case "Add", _:
            layers.scale_and_shift(one, constant)
        case "Sub", 0:
            layers.scale_and_shift(one, -constant)
        case "Sub", _:
            layers.scale_and_shift(-one, constant)
        case "Mul", _:
            layers.scale_and_shift(constant, zero)
        case "Div", 0 if constant.all():
            layers.scale_and_shift(1.0 / constant, zero)
        case _:
            raise UnreadableError("has a Div by zero or by its input")


def _gru(layers: Layers, node: _Node) -> None:
    """Append gated recurrent units. ONNX stores their gates in the order update, reset, new."""
    attributes = node.attributes
    _, input_gates, hidden_gates, both, lengths, initial = [*node.constants, None, None, None][:6]
    if attributes.get("linear_before_reset", 0) != 1 or attributes.get("direction", b"forward") != b"forward":
        raise UnreadableError("has an unsupported GRU: direction must be forward, and linear_before_reset must be 1")
    activations = [each.decode().lower() for each in attributes.get("activations", [b"sigmoid", b"tanh"])]
    if activations != ["sigmoid", "tanh"] or "clip" in attributes or lengths is not None:
        raise UnreadableError(
            "has a GRU with non-default activations, a clip, or sequence lengths, which are not supported"
        )
    if (
        node.chain_index
        or input_gates is None
        or hidden_gates is None
        or input_gates.ndim != 3
        or hidden_gates.ndim != 3
    ):
        raise UnreadableError("has a GRU without constant weights")
    units = hidden_gates.shape[-1]
    both = np.zeros((1, 6 * units)) if both is None else both
    if input_gates.shape[:2] != (1, 3 * units) or both.shape != (1, 6 * units):
        raise UnreadableError("has a GRU with weights and biases of inconsistent shapes")
    order = np.r_[units : 2 * units, :units, 2 * units : 3 * units]
    inner, outer = np.split(both[0], 2)
    layers.gru((input_gates[0][order], inner[order]), (hidden_gates[0][order], outer[order]), initial)


def _clip(layers: Layers, node: _Node, *, is_last: bool) -> None:
    """Append a clipping layer, unless it clips the final output to limits that contain [-1, 1].

    Such a layer has no effect, since actions are limited to [-1, 1] in any case.
    """
    attributes = [node.attributes.get(name) for name in ("min", "max")]  # the limits are attributes up to opset 10
    bounds = attributes if len(node.constants) == 1 else [*node.constants[1:], None][:2]
    if node.chain_index or any(np.size(each) != 1 for each in bounds if each is not None):
        raise UnreadableError("has a Clip whose bounds are not constant numbers")
    low, high = (
        sign * math.inf if each is None or abs(float(np.ravel(each)[0])) >= _MIN_UNBOUNDED else float(np.ravel(each)[0])
        for sign, each in zip((-1.0, 1.0), bounds, strict=True)
    )
    if not layers.layers:
        if low != -high or not math.isfinite(high):
            raise UnreadableError(
                f"has a Clip of the input to {low:g} and {high:g}; only limits that are symmetric about zero are"
                " supported"
            )
        layers.limit_input(high)
    elif not (is_last and low <= -1.0 and high >= 1.0):
        layers.limit_output(low, high)


# Functions that append a node to the layers, by operator.
_NODE_HANDLERS: dict[str, Callable[[Layers, _Node], None]] = {
    "Gemm": _gemm,
    "MatMul": _matmul,
    "GRU": _gru,
    "Add": _arithmetic,
    "Sub": _arithmetic,
    "Mul": _arithmetic,
    "Div": _arithmetic,
}
