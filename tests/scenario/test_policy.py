"""Tests of policies in the scenario language, and of their network files."""

import base64
import sys

import numpy as np
import onnx
import onnx.reference
import pytest
import scipy
from onnx import TensorProto, helper

from drake_quad import InputError, load_scenario, save_scenario
from drake_quad.control.policy.network import evaluate_network
from drake_quad.errors import InputWarning
from drake_quad.scenario.files.policy_file import policy_network
from drake_quad.scenario.policies.layers import Layers

POLICY_SCENARIO = """
mine:
  extends: figure_eight
  control:
    kind: policy
    policy: {file}
    action: {{kind: acceleration}}
    observation: {{signals: [position_error, velocity_error]}}
    attitude: {{k_p: [8, 8, 8], k_d: [4, 4, 4]}}
"""
RNG = np.random.default_rng(5)
NETWORK_ARRAYS = {
    "weights_0": RNG.normal(size=(4, 6)),
    "biases_0": RNG.normal(size=4),
    "activation_0": np.array("tanh"),
    "weights_1": RNG.normal(size=(3, 4)).astype(np.float32),
    "biases_1": RNG.normal(size=3).astype(np.float32),
}
OBSERVATION = RNG.normal(size=6)


def layer(activation, weights, biases, x):
    return activation(weights @ x + biases)


def identity(x):
    return x


@pytest.fixture
def load_arrays(tmp_path):
    """Return a function that saves arrays as a network and returns a scenario with it."""

    def write(arrays, **control):
        np.savez(tmp_path / "net.npz", **arrays)
        (tmp_path / "mine.yaml").write_text(POLICY_SCENARIO.format(file="net.npz"), encoding="utf-8")
        return load_scenario(tmp_path / "mine.yaml", {f"control.{name}": value for name, value in control.items()})

    return write


def output(scenario, inputs=OBSERVATION):
    network = scenario.control.policy.network()
    return np.array(evaluate_network(network, inputs.tolist(), network.memory).output)


def test_the_layers_of_a_network_are_read_from_arrays(load_arrays):
    expected = layer(
        identity,
        NETWORK_ARRAYS["weights_1"],
        NETWORK_ARRAYS["biases_1"],
        layer(np.tanh, *list(NETWORK_ARRAYS.values())[:2], OBSERVATION),
    )
    scenario = load_arrays(NETWORK_ARRAYS)
    np.testing.assert_allclose(output(scenario), expected, rtol=1e-12)
    assert scenario.control.policy.precision == "double"
    assert repr(scenario).count("control policy") == 1


@pytest.mark.parametrize(
    ("arrays", "activation"),
    [
        ({"activation_0": "leaky_relu", "alpha_0": 0.2}, lambda x: np.where(x > 0.0, x, 0.2 * x)),
        ({"activation_0": "leaky_relu"}, lambda x: np.where(x > 0.0, x, 0.01 * x)),
        ({"activation_0": "elu", "alpha_0": 0.5}, lambda x: np.where(x > 0.0, x, 0.5 * np.expm1(x))),
        ({"activation_0": "gelu"}, lambda x: x * scipy.stats.norm.cdf(x)),
        (
            {"activation_0": "gelu_tanh"},
            lambda x: 0.5 * x * (1.0 + np.tanh(np.sqrt(2 / np.pi) * (x + 0.044715 * x**3))),
        ),
    ],
)
def test_activations_are_read_and_written_with_their_parameters(load_arrays, tmp_path, arrays, activation):
    scenario = load_arrays({**NETWORK_ARRAYS, **{name: np.array(each) for name, each in arrays.items()}})
    hidden = layer(activation, NETWORK_ARRAYS["weights_0"], NETWORK_ARRAYS["biases_0"], OBSERVATION)
    expected = layer(identity, NETWORK_ARRAYS["weights_1"], NETWORK_ARRAYS["biases_1"], hidden)
    np.testing.assert_allclose(output(scenario), expected, rtol=1e-12)
    save_scenario(scenario, tmp_path / "again.yaml")
    assert load_scenario(tmp_path / "again.yaml") == scenario


def test_values_that_are_exact_in_single_precision_are_saved_in_single_precision(load_arrays):
    single = {
        name: values.astype(np.float32) if values.dtype.kind == "f" else values
        for name, values in NETWORK_ARRAYS.items()
    }
    scenario = load_arrays(single)
    assert scenario.control.policy.precision == "single"
    hidden = layer(np.tanh, single["weights_0"].astype(float), single["biases_0"], OBSERVATION)
    expected = layer(identity, single["weights_1"].astype(float), single["biases_1"], hidden)
    np.testing.assert_allclose(output(scenario), expected, rtol=1e-12)


def test_numbers_beyond_single_precision_are_saved_in_double_precision_without_a_warning():
    layers = Layers()
    layers.dense(np.full((1, 6), 1e300), np.zeros(1))
    network = layers.network()
    assert network.precision == "double"
    outputs = evaluate_network(network.network(), OBSERVATION.tolist(), ()).output
    np.testing.assert_allclose(outputs, [1e300 * OBSERVATION.sum()], rtol=1e-12)


def test_numbers_beyond_double_precision_are_refused_without_a_warning(load_arrays):
    with pytest.raises(InputError, match="net.npz: has numbers that are not finite"):
        load_arrays({**NETWORK_ARRAYS, "weights_1": np.full((3, 4), np.longdouble("1e4000"))})


def test_a_scenario_is_written_with_its_network_and_read_again(load_arrays, tmp_path):
    preprocessing = {"offset": RNG.normal(size=6), "scale": RNG.uniform(0.5, 2.0, 6), "limit": np.array(1.5)}
    scenario = load_arrays({**NETWORK_ARRAYS, **preprocessing})
    save_scenario(scenario, tmp_path / "again.yaml")
    loaded_scenario = load_scenario(tmp_path / "again.yaml")
    assert loaded_scenario == scenario
    rows = np.clip((OBSERVATION - preprocessing["offset"]) * preprocessing["scale"], -1.5, 1.5)
    np.testing.assert_allclose(output(loaded_scenario), output(load_arrays(NETWORK_ARRAYS), rows), rtol=1e-12)


def test_invalid_numbers_of_a_saved_network_are_refused(load_arrays, tmp_path):
    scenario = load_arrays(NETWORK_ARRAYS)
    numbers = np.frombuffer(base64.b64decode("".join(scenario.control.policy.numbers)))
    save_scenario(scenario, tmp_path / "again.yaml")
    field = "control.policy.numbers"
    for network_fields, words in [
        (base64.b64encode(np.append(numbers[1:], np.inf)).decode(), f"{field} .*must be finite"),
        (base64.b64encode(numbers[1:]).decode(), f"{field} .*must have 43 numbers for these layers, not 42"),
        ("@", f"{field} .*must be numbers in base 64"),
    ]:
        with pytest.raises(InputError, match=words):
            load_scenario(tmp_path / "again.yaml", {field: [network_fields]})


def test_recurrent_units_are_read_from_arrays(load_arrays):
    gru = {
        "weights_input_0": RNG.normal(size=(9, 6)),
        "biases_input_0": RNG.normal(size=9),
        "weights_hidden_0": RNG.normal(size=(9, 3)),
        "biases_hidden_0": RNG.normal(size=9),
    }
    for initial in ({}, {"initial_0": np.array([0.1, -0.2, 0.3])}):
        network = load_arrays({**gru, **initial}).control.policy.network()
        assert network.memory == (tuple(initial.get("initial_0", np.zeros(3)).tolist()),)
        h = np.array(network.memory[0])
        new = (gru["weights_input_0"] @ OBSERVATION + gru["biases_input_0"]).reshape(3, 3)
        old = (gru["weights_hidden_0"] @ h + gru["biases_hidden_0"]).reshape(3, 3)
        r, z = 1.0 / (1.0 + np.exp(-(new[:2] + old[:2])))
        expected = z * h + (1.0 - z) * np.tanh(new[2] + r * old[2])
        np.testing.assert_allclose(
            evaluate_network(network, OBSERVATION.tolist(), network.memory).output, expected, rtol=1e-12
        )


INVALID_NETWORKS = {
    "no layers": ({}, "has no layers"),
    "another array": ({**NETWORK_ARRAYS, "w": np.zeros(2)}, "has unknown arrays: w"),
    "an unknown part of a layer": ({**NETWORK_ARRAYS, "momentum_1": np.zeros(2)}, "has unknown arrays: momentum_1"),
    "no biases": ({"weights_0": np.zeros((3, 6))}, "has a layer without biases"),
    "biases of another layer": (
        {"weights_0": np.zeros((3, 6)), "biases_0": np.zeros(4)},
        r"and biases of shape \(4,\)",
    ),
    "text instead of weights": (
        {"weights_0": np.array("many"), "biases_0": np.zeros(4)},
        "has an array weights_0 of type <U4, which must be numeric",
    ),
    "text instead of a limit": (
        {**NETWORK_ARRAYS, "limit": np.array("much")},
        "has an array limit of type <U4, which must be numeric",
    ),
    "two limits": (
        {**NETWORK_ARRAYS, "limit": np.ones(2)},
        "has an array limit with 2 numbers, but must contain one number",
    ),
    "an alpha for tanh": (
        {**NETWORK_ARRAYS, "alpha_0": np.array(0.2)},
        "alpha .*must be left out with the activation tanh",
    ),
    "two alphas": (
        {**NETWORK_ARRAYS, "activation_0": np.array("elu"), "alpha_0": np.ones(2)},
        "has an array alpha_0 with 2 numbers, but must contain one number",
    ),
    "a complex scale": (
        {**NETWORK_ARRAYS, "scale": np.full(6, 1j)},
        "has an array scale of type complex128, which must be numeric",
    ),
    "a scalar for a matrix": (
        {
            "weights_input_0": np.array(1.0),
            "biases_input_0": np.zeros(9),
            "weights_hidden_0": np.zeros((9, 3)),
            "biases_hidden_0": np.zeros(9),
        },
        "has gated recurrent units with weights and biases of inconsistent shapes",
    ),
    "not finite": ({**NETWORK_ARRAYS, "biases_1": np.array([1.0, np.nan, 0.0])}, "not finite"),
    "an unknown activation": (
        {**NETWORK_ARRAYS, "activation_0": np.array("sine")},
        "layers.0.activation must be 'identity'",
    ),
    "too few rows": (
        {"weights_0": np.zeros((3, 5)), "biases_0": np.zeros(3)},
        r"control.policy.layers.0.inputs is 5, but must be 6, the number of elements of this control's",
    ),
    "too many actions": (
        {"weights_0": np.zeros((4, 6)), "biases_0": np.zeros(4)},
        r"control.policy.layers.0.outputs is 4, but must be 3, the number of elements of this control's",
    ),
    "layers whose sizes do not match": (
        {**NETWORK_ARRAYS, "weights_1": np.zeros((3, 5))},
        "must be 4, the number of outputs of the preceding layer",
    ),
    "an offset of another size": (
        {**NETWORK_ARRAYS, "offset": np.zeros(5)},
        "must have 6 numbers, one for each element of the input",
    ),
    "too large": (
        {
            "weights_0": np.zeros((400, 6)),
            "biases_0": np.zeros(400),
            "weights_1": np.zeros((400, 400)),
            "biases_1": np.zeros(400),
        },
        "must have at most 75000 numbers in single precision, not 163200",
    ),
}


@pytest.mark.parametrize(("arrays", "words"), INVALID_NETWORKS.values(), ids=INVALID_NETWORKS)
def test_the_error_for_an_invalid_network_is_one_sentence(load_arrays, arrays, words):
    with pytest.raises(InputError, match=words) as error:
        load_arrays(arrays)
    assert "\n" not in str(error.value)


def test_a_layer_has_no_more_than_4096_outputs(load_arrays):
    def arrays(rows):
        weights = {"weights_0": np.zeros((rows, 6)), "weights_1": np.zeros((3, rows))}
        return weights | {"biases_0": np.zeros(rows), "biases_1": np.zeros(3)}

    assert load_arrays(arrays(4096)).control.policy.layers[0].outputs == 4096
    with pytest.raises(InputError, match=r"layers\.0\.outputs must be less than or equal to 4096"):
        load_arrays(arrays(4097))


@pytest.mark.parametrize(
    ("name", "data", "words"),
    [
        ("net.npz", b"PK\x03\x04 and nothing more", "net.npz: is not an .npz file of arrays"),
        ("net.npz", np.arange(3).tobytes(), "is not an .npz file of arrays"),
        ("net.onnx", b"\x00\x01", "is not an ONNX model"),
        ("net.npz", bytes(3_000_000), "is too large: the file of a network may have at most 2,400,000 bytes"),
    ],
)
def test_a_file_that_is_not_a_network_is_refused(tmp_path, name, data, words):
    (tmp_path / name).write_bytes(data)
    (tmp_path / "mine.yaml").write_text(POLICY_SCENARIO.format(file=name), encoding="utf-8")
    with pytest.raises(InputError, match=words):
        load_scenario(tmp_path / "mine.yaml")
    (tmp_path / name).unlink()
    with pytest.raises(InputError, match=rf"mine.yaml:6: control.policy refers to .*{name}, which does not exist$"):
        load_scenario(tmp_path / "mine.yaml")
    (tmp_path / "net.pt").touch()
    (tmp_path / "mine.yaml").write_text(POLICY_SCENARIO.format(file="net.pt"), encoding="utf-8")
    with pytest.raises(InputError, match="its name must end in .npz or .onnx"):
        load_scenario(tmp_path / "mine.yaml")


def test_an_npz_file_that_expands_beyond_the_size_limit_is_refused(tmp_path):
    np.savez_compressed(tmp_path / "net.npz", weights_0=np.zeros((1000, 1000)), biases_0=np.zeros(1000))
    assert (tmp_path / "net.npz").stat().st_size < 20_000
    (tmp_path / "mine.yaml").write_text(POLICY_SCENARIO.format(file="net.npz"), encoding="utf-8")
    with pytest.raises(InputError, match="is too large: its arrays have more than 2,400,000 bytes"):
        load_scenario(tmp_path / "mine.yaml")
    np.save(tmp_path / "net.npy", np.zeros(3))
    (tmp_path / "net.npy").rename(tmp_path / "net.npz")
    with pytest.raises(InputError, match="is not an .npz file of arrays"):
        load_scenario(tmp_path / "mine.yaml")


@pytest.mark.parametrize("kind", ["npz", "packed", "onnx"])
def test_a_file_that_is_damaged_is_read_or_refused_in_a_sentence(kind, tmp_path):
    path = tmp_path / f"whole.{kind[:4] if kind == 'onnx' else 'npz'}"
    if kind == "onnx":
        onnx.save(model_of(two_layers(), GRAPH_CONSTANTS), path)
    else:
        (np.savez_compressed if kind == "packed" else np.savez)(path, **NETWORK_ARRAYS)
    data, rng = path.read_bytes(), np.random.default_rng(8)
    counts = {"read": 0, "refused": 0}
    for _ in range(300):
        damaged = bytearray(data)
        for index in rng.integers(len(data), size=rng.integers(1, 4)).tolist():
            damaged[index] = rng.integers(256)
        path.write_bytes(bytes(damaged[: rng.integers(len(data))]) if rng.random() < 0.1 else bytes(damaged))
        try:
            policy_network(path)
            counts["read"] += 1
        except InputError as error:
            assert "\n" not in str(error)
            counts["refused"] += 1
    assert min(counts.values()) > 10


def model_of(nodes, constants):
    value = helper.make_tensor_value_info
    graph = helper.make_graph(
        nodes,
        "policy",
        [value("seen", TensorProto.FLOAT, [1, 6])],
        [value("done", TensorProto.FLOAT, [1, 3])],
        [
            onnx.numpy_helper.from_array(values if values.dtype == np.int64 else values.astype(np.float32), name)
            for name, values in constants.items()
        ],
    )
    return helper.make_model(graph)


@pytest.fixture
def load_onnx(tmp_path):
    def load(nodes, constants):
        onnx.save(model_of(nodes, constants), tmp_path / "net.onnx")
        (tmp_path / "mine.yaml").write_text(POLICY_SCENARIO.format(file="net.onnx"), encoding="utf-8")
        return load_scenario(tmp_path / "mine.yaml")

    return load


W = NETWORK_ARRAYS["weights_0"].astype(np.float32)
B = NETWORK_ARRAYS["biases_0"].astype(np.float32)
V = NETWORK_ARRAYS["weights_1"]
C = NETWORK_ARRAYS["biases_1"]


def test_an_onnx_network_has_the_output_of_the_onnx_evaluator(load_onnx):
    """The network consists of Sub, Div and Clip on the input, two layers with arithmetic, and nodes without effect."""
    constants = {
        "mean": RNG.normal(size=6),
        "deviation": RNG.uniform(0.5, 2.0, 6),
        "low": np.array(-0.9),
        "high": np.array(0.9),
        "W": W,
        "B": B,
        "V": V.T,
        "C": C,
        "gain": np.array([2.0, 3.0, 4.0]),
        "half": np.array(0.5),
    }
    node = helper.make_node
    nodes = [
        node("Identity", ["seen"], ["same"]),
        node("Sub", ["same", "mean"], ["centred"]),
        node("Div", ["centred", "deviation"], ["normal"]),
        node("Clip", ["normal", "low", "high"], ["within"]),
        node("Gemm", ["within", "W", "B"], ["hidden"], transB=1, alpha=1.5, beta=0.5),
        node("Relu", ["hidden"], ["active"]),
        node("MatMul", ["active", "V"], ["product"]),
        node("Add", ["product", "C"], ["sum"]),
        node("Mul", ["sum", "gain"], ["scaled"]),
        node("Sub", ["scaled", "half"], ["shifted"]),
        node("Tanh", ["shifted"], ["done"]),
    ]
    action = output(load_onnx(nodes, constants))
    evaluator = onnx.reference.ReferenceEvaluator(model_of(nodes, constants))
    (expected,) = evaluator.run(None, {"seen": OBSERVATION[None].astype(np.float32)})
    np.testing.assert_allclose(action, expected[0], rtol=2e-5)


def two_layers(*, first=("seen", "hidden"), activation=(("Tanh", ["hidden"], ["active"]),), last="done"):
    """Return the nodes of two dense layers and of the activation between them.

    Args:
        first: names of the input and the output of the first layer.
        activation: nodes of the activation, each as a node or as the arguments of `make_node`.
        last: name of the output of the second layer.
    """
    begin = helper.make_node("Gemm", [first[0], "W", "B"], [first[1]], transB=1)
    between = [each if not isinstance(each, tuple) else helper.make_node(*each) for each in activation]
    return [begin, *between, helper.make_node("Gemm", ["active", "V", "C"], [last], transB=1)]


def approximated_gelu(power, coefficient):
    """Return two layers with the activation 4 GELU(x / 2), which is written as arithmetic with named constants."""
    return two_layers(
        activation=[
            ("Mul", ["hidden", "half"], ["u"]),
            ("Pow", ["u", power], ["raised"]),
            ("Mul", ["raised", coefficient], ["little"]),
            ("Add", ["u", "little"], ["more"]),
            ("Mul", ["more", "root_of_2_over_pi"], ["inner"]),
            ("Tanh", ["inner"], ["a"]),
            ("Add", ["a", "one"], ["b"]),
            ("Mul", ["b", "two"], ["c"]),
            ("Mul", ["c", "u"], ["active"]),
        ]
    )


make_node = helper.make_node
GRAPH_CONSTANTS = {
    "W": W,
    "B": B,
    "V": V,
    "C": C,
    "one": np.array(1.0),
    "two": np.array([2.0]),
    "minus": np.array(-1.0),
    "half": np.array(0.5),
    "root_of_2": np.array(np.sqrt(2.0)),
    "root_of_2_over_pi": np.array(np.sqrt(2.0 / np.pi)),
    "cube": np.array(0.044715),
    "three": np.array(3.0),
    "spread": np.array([0.3, 0.5, 0.7]),
    "U": RNG.normal(size=(6, 6)),
    "D": RNG.normal(size=6),
}


@pytest.mark.parametrize(
    "nodes",
    [
        # The value function of an actor-critic network may branch off before or after a layer.
        [*two_layers(), make_node("Gemm", ["active", "V", "C"], ["value"], transB=1)],
        [
            make_node("Gemm", ["seen", "U", "D"], ["other"], transB=1),
            make_node("Tanh", ["other"], ["value"]),
            *two_layers(),
        ],
        # PyTorch writes SiLU as in the first of these networks. In the second, the factors are exchanged.
        two_layers(activation=[("Sigmoid", ["hidden"], ["gate"]), ("Mul", ["hidden", "gate"], ["active"])]),
        two_layers(activation=[("Sigmoid", ["hidden"], ["gate"]), ("Mul", ["gate", "hidden"], ["active"])]),
        # Arithmetic with scalars may be applied to the input.
        [
            make_node("Sub", ["one", "seen"], ["a"]),
            make_node("Mul", ["two", "a"], ["b"]),
            *two_layers(first=("b", "hidden")),
        ],
        # Weights may be computed from constants.
        [
            make_node("Transpose", ["W"], ["W_turned"], perm=[1, 0]),
            make_node("Constant", [], ["quarter"], value_float=0.25),
            make_node("Mul", ["seen", "quarter"], ["less"]),
            make_node("MatMul", ["less", "W_turned"], ["product"]),
            make_node("Add", ["B", "product"], ["hidden"]),
            *two_layers()[1:],
        ],
        # LeakyRelu and Elu have one parameter, and Gelu has two forms.
        two_layers(activation=[make_node("LeakyRelu", ["hidden"], ["active"], alpha=0.3)]),
        two_layers(activation=[("LeakyRelu", ["hidden"], ["active"])]),
        two_layers(activation=[make_node("Elu", ["hidden"], ["active"], alpha=0.5)]),
        two_layers(activation=[("Gelu", ["hidden"], ["active"])]),
        two_layers(activation=[make_node("Gelu", ["hidden"], ["active"], approximate="tanh")]),
        # PyTorch writes GELU as arithmetic in older opsets, and so do other exporters.
        two_layers(
            activation=[
                ("Div", ["hidden", "root_of_2"], ["a"]),
                ("Erf", ["a"], ["b"]),
                ("Add", ["b", "one"], ["c"]),
                ("Mul", ["hidden", "c"], ["d"]),
                ("Mul", ["d", "half"], ["active"]),
            ]
        ),
        two_layers(
            activation=[
                ("Mul", ["half", "hidden"], ["z"]),
                ("Mul", ["hidden", "two"], ["y"]),
                ("Erf", ["y"], ["b"]),
                ("Add", ["one", "b"], ["c"]),
                ("Mul", ["c", "two"], ["e"]),
                ("Mul", ["e", "z"], ["active"]),
            ]
        ),
        # The approximation of GELU may be written with products or with a node Pow.
        two_layers(
            activation=[
                ("Mul", ["hidden", "hidden"], ["square"]),
                ("Mul", ["hidden", "square"], ["third"]),
                ("Mul", ["cube", "third"], ["little"]),
                ("Add", ["hidden", "little"], ["more"]),
                ("Mul", ["root_of_2_over_pi", "more"], ["inner"]),
                ("Tanh", ["inner"], ["a"]),
                ("Add", ["one", "a"], ["b"]),
                ("Mul", ["hidden", "b"], ["c"]),
                ("Mul", ["half", "c"], ["active"]),
            ]
        ),
        # The same approximation may contain a difference instead of a sum.
        two_layers(
            activation=[
                ("Pow", ["hidden", "three"], ["third"]),
                ("Mul", ["cube", "third"], ["little"]),
                ("Mul", ["minus", "little"], ["less"]),
                ("Sub", ["hidden", "less"], ["more"]),
                ("Mul", ["root_of_2_over_pi", "more"], ["inner"]),
                ("Tanh", ["inner"], ["a"]),
                ("Add", ["one", "a"], ["b"]),
                ("Mul", ["hidden", "b"], ["c"]),
                ("Mul", ["half", "c"], ["active"]),
            ]
        ),
        # The factors of SiLU may be divided by numbers.
        two_layers(
            activation=[
                ("Sigmoid", ["hidden"], ["a"]),
                ("Div", ["a", "three"], ["b"]),
                ("Div", ["hidden", "two"], ["c"]),
                ("Mul", ["c", "b"], ["active"]),
            ]
        ),
        approximated_gelu("three", "cube"),
        # SiLU of a multiple of its input also approximates GELU.
        two_layers(
            activation=[
                ("Div", ["hidden", "half"], ["u"]),
                ("Sigmoid", ["u"], ["a"]),
                ("Mul", ["hidden", "a"], ["active"]),
            ]
        ),
        # Arithmetic may follow an activation or a limit, also at the end of the network.
        two_layers(
            activation=[("Tanh", ["hidden"], ["a"]), ("Mul", ["a", "two"], ["b"]), ("Sub", ["half", "b"], ["active"])]
        ),
        [
            *two_layers(last="sum"),
            make_node("Tanh", ["sum"], ["a"]),
            make_node("Mul", ["a", "spread"], ["b"]),
            make_node("Add", ["b", "C"], ["c"]),
            make_node("Div", ["c", "two"], ["done"]),
        ],
        two_layers(
            activation=[("Tanh", ["hidden"], ["a"]), ("Sub", ["a", "half"], ["b"]), ("Relu", ["b"], ["active"])]
        ),
        [
            make_node("Clip", ["seen", "minus", "one"], ["a"]),
            make_node("Mul", ["a", "two"], ["b"]),
            make_node("Add", ["b", "D"], ["c"]),
            *two_layers(first=("c", "hidden")),
        ],
        # Limits of the action to [-1, 1] have no effect, since every action is limited to this range.
        [*two_layers(last="sum"), make_node("Clip", ["sum", "minus", "one"], ["done"])],
    ],
)
def test_all_supported_forms_of_onnx_networks_have_the_output_of_the_evaluator(load_onnx, nodes):
    constants = {**GRAPH_CONSTANTS, "V": 0.1 * V, "C": 0.1 * C}
    action = output(load_onnx(nodes, constants))
    evaluator = onnx.reference.ReferenceEvaluator(model_of(nodes, constants))
    (expected,) = evaluator.run(None, {"seen": OBSERVATION[None].astype(np.float32)})
    np.testing.assert_allclose(action, expected[0], rtol=2e-5)


@pytest.mark.parametrize(
    ("nodes", "words"),
    [
        (
            two_layers(activation=[("Tanh", ["hidden"], ["a"]), ("Add", ["a", "hidden"], ["active"])]),
            "has branches that meet in a node Add.*; export activations as nodes, with opset 20 or later",
        ),
        # In these networks, the exponent or the coefficient differs from the GELU approximation.
        (approximated_gelu("two", "cube"), "has branches that meet in a node Mul"),
        (approximated_gelu("three", "half"), "has branches that meet in a node Mul"),
        (
            two_layers(activation=[make_node("Gelu", ["hidden"], ["active"], approximate="erf")]),
            "has a Gelu with approximation b'erf', which must be none or tanh",
        ),
        (
            two_layers(activation=[("Tanh", ["hidden"], ["a"]), ("Mul", ["a", "D"], ["active"])]),
            "has arithmetic of 4 neurons with . numbers",
        ),
        (
            two_layers(
                activation=[
                    ("Erf", ["hidden"], ["b"]),
                    ("Add", ["b", "two"], ["c"]),
                    ("Mul", ["hidden", "c"], ["active"]),
                ]
            ),
            "has branches that meet in a node Mul",
        ),
        (
            two_layers(activation=[make_node("Cast", ["hidden"], ["active"], to=TensorProto.INT32)]),
            "has a Cast to a type other than single or double precision",
        ),
        (
            [
                make_node("Clip", ["seen", "minus", "one"], ["a"]),
                make_node("Clip", ["a", "minus", "one"], ["b"]),
                *two_layers(first=("b", "hidden")),
            ],
            "limits its input twice",
        ),
        (
            [make_node("Clip", ["seen", "minus", "half"], ["a"]), *two_layers(first=("a", "hidden"))],
            "has a Clip of the input to -1 and 0.5; only limits that are symmetric about zero",
        ),
        (two_layers(activation=[("Add", ["hidden", "C"], ["active"])]), "arithmetic of 4 neurons with . numbers"),
        (
            [make_node("Add", ["seen", "C"], ["a"]), *two_layers(first=("a", "hidden"))],
            "3 rows|different sizes|must have 6",
        ),
        (
            [make_node("Div", ["one", "seen"], ["a"]), *two_layers(first=("a", "hidden"))],
            "has a Div by zero or by its input",
        ),
        ([make_node("MatMul", ["seen", "D"], ["done"])], r"weights of shape \(6,\), which must be a matrix"),
        ([make_node("Identity", ["C"], ["done"])], "has an output that does not depend on its input seen"),
        (
            [make_node("Sub", ["one", "root_of_2"], ["number"]), make_node("Identity", ["number"], ["done"])],
            "has an output that does not depend on its input seen",
        ),
        ([], "has an output that does not depend on its input seen"),
        (
            two_layers(activation=[("Clip", ["hidden", "D"], ["active"])]),
            "a Clip whose bounds are not constant numbers",
        ),
        (two_layers(activation=[("Clip", ["one", "hidden"], ["active"])]), "a Clip whose bounds are not constant"),
        (
            two_layers(activation=[("Clip", ["hidden", "", "million"], ["active"])]),
            r"has a limit larger than 1e\+06 on the output of a layer",
        ),
        ([make_node("Nonsense", ["C"], ["done"])], "is not a valid ONNX model: No Op registered for Nonsense"),
        (
            [
                make_node(
                    "GRU", ["seen", "W", "B"], ["", "done"], linear_before_reset=1, activations=["Sigmoid", "Relu"]
                )
            ],
            "has a GRU with non-default activations",
        ),
        (
            [make_node("GRU", ["seen", "W", "B"], ["", "done"], linear_before_reset=1)],
            "has a GRU without constant weights",
        ),
    ],
)
def test_unsupported_onnx_models_are_refused(load_onnx, nodes, words):
    with pytest.raises(InputError, match=words) as error:
        load_onnx(nodes, {**GRAPH_CONSTANTS, "million": np.array(1.1e6)} | ({} if nodes else {"done": C}))
    assert "\n" not in str(error.value)


def test_an_onnx_graph_with_a_cycle_is_refused(load_onnx):
    nodes = [make_node("Relu", ["b"], ["a"]), make_node("Relu", ["a"], ["b"]), make_node("Identity", ["a"], ["done"])]
    with pytest.raises(InputError, match="is not a valid ONNX model"):
        load_onnx(nodes, {})


def test_an_onnx_file_with_weights_in_another_file_is_refused(tmp_path):
    model = model_of(two_layers(), GRAPH_CONSTANTS)
    onnx.save(model, tmp_path / "net.onnx", save_as_external_data=True, location="net.onnx.data", size_threshold=0)
    (tmp_path / "mine.yaml").write_text(POLICY_SCENARIO.format(file="net.onnx"), encoding="utf-8")
    with pytest.raises(InputError, match="stores its weights in another file; export it with external_data=False"):
        load_scenario(tmp_path / "mine.yaml")


@pytest.mark.parametrize(
    ("names", "chosen"), [(("done", "value"), 0), (("value", "done"), 0), (("value", "Actions"), 1)]
)
def test_the_action_is_the_output_named_actions_or_the_first_output(tmp_path, names, chosen):
    model = model_of([*two_layers(last=names[0]), make_node("Tanh", [names[0]], [names[1]])], GRAPH_CONSTANTS)
    del model.graph.output[:]
    for name in names:
        model.graph.output.append(helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, 3]))
    onnx.save(model, tmp_path / "net.onnx")
    (tmp_path / "mine.yaml").write_text(POLICY_SCENARIO.format(file="net.onnx"), encoding="utf-8")
    words = f"net.onnx: has the outputs {names[0]}, {names[1]}, of which {names[chosen]} is used as the action"
    with pytest.warns(InputWarning, match=words):
        action = output(load_scenario(tmp_path / "mine.yaml"))
    expected = onnx.reference.ReferenceEvaluator(model).run(None, {"seen": OBSERVATION[None].astype(np.float32)})
    np.testing.assert_allclose(action, expected[chosen][0], rtol=2e-5)
    # Each output can be selected by name. Then there is no warning.
    for name, numbers in zip(names, expected, strict=True):
        (tmp_path / "mine.yaml").write_text(POLICY_SCENARIO.format(file=f"net.onnx:{name}"), encoding="utf-8")
        np.testing.assert_allclose(output(load_scenario(tmp_path / "mine.yaml")), numbers[0], rtol=2e-5)
    with pytest.raises(InputError, match=f"net.onnx: has no output 'none'; its outputs are {names[0]}, {names[1]}$"):
        load_scenario(tmp_path / "mine.yaml", [f"control.policy={tmp_path / 'net.onnx:none'}"])


@pytest.mark.parametrize("bounds", [(-0.05, 0.05), (0.0, 1.0), (-0.02, 0.03), (-1.0, 1.0), (0.01, None), (None, 0.02)])
@pytest.mark.parametrize("position", ["hidden", "action", "scaled action", "activated action"])
def test_a_network_with_clipped_layers_has_the_output_of_the_onnx_evaluator(load_onnx, position, bounds):
    names = [name if each is not None else "" for name, each in zip(("low", "high"), bounds, strict=True)]
    limits = {name: np.array(each) for name, each in zip(names, bounds, strict=True) if each is not None}
    nodes = {
        "hidden": two_layers(activation=[("Clip", ["hidden", *names], ["active"])]),
        "action": [*two_layers(last="sum"), make_node("Clip", ["sum", *names], ["done"])],
        "scaled action": [
            *two_layers(last="sum"),
            make_node("Clip", ["sum", *names], ["clipped"]),
            make_node("Mul", ["clipped", "half"], ["done"]),
        ],
        "activated action": [
            *two_layers(last="sum"),
            make_node("Tanh", ["sum"], ["tanh"]),
            make_node("Clip", ["tanh", *names], ["done"]),
        ],
    }[position]
    constants = {**GRAPH_CONSTANTS, "V": 0.1 * V, "C": 0.1 * C, **limits}
    (expected,) = onnx.reference.ReferenceEvaluator(model_of(nodes, constants)).run(
        None, {"seen": OBSERVATION[None].astype(np.float32)}
    )
    np.testing.assert_allclose(output(load_onnx(nodes, constants)), expected[0], rtol=2e-5, atol=1e-9)


def test_the_error_for_an_action_of_the_wrong_size_names_the_assumed_output(tmp_path):
    nodes = [make_node("Gemm", ["seen", "W_value", "b_value"], ["value"]), *two_layers(last="mean")]
    model = model_of(nodes, {**GRAPH_CONSTANTS, "W_value": np.ones((6, 1)), "b_value": np.ones(1)})
    del model.graph.output[:]
    for name, rows in (("value", 1), ("mean", 3)):
        model.graph.output.append(helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, rows]))
    onnx.save(model, tmp_path / "net.onnx")
    (tmp_path / "mine.yaml").write_text(POLICY_SCENARIO.format(file="net.onnx"), encoding="utf-8")
    words = r"net.onnx \(output value; FILE.onnx:NAME selects another\): .* is 1, but must be 3"
    with pytest.warns(InputWarning), pytest.raises(InputError, match=words):
        load_scenario(tmp_path / "mine.yaml")


def test_clip_bounds_given_as_attributes_are_read(tmp_path):
    """In opset 10 the bounds are attributes. A clip may limit the observations or, as the last node, the actions."""
    clip = make_node("Clip", ["seen"], ["within"], min=-0.5, max=0.5)
    nodes = [
        clip,
        *two_layers(first=("within", "hidden"), last="sum"),
        make_node("Clip", ["sum"], ["done"], min=-1.0, max=1.0),
    ]
    model = model_of(nodes, {**GRAPH_CONSTANTS, "V": 0.1 * V, "C": 0.1 * C})
    del model.opset_import[:]
    model.opset_import.append(helper.make_opsetid("", 10))
    model.ir_version = 5
    onnx.save(model, tmp_path / "net.onnx")
    (tmp_path / "mine.yaml").write_text(POLICY_SCENARIO.format(file="net.onnx"), encoding="utf-8")
    (expected,) = onnx.reference.ReferenceEvaluator(model).run(None, {"seen": OBSERVATION[None].astype(np.float32)})
    np.testing.assert_allclose(output(load_scenario(tmp_path / "mine.yaml")), expected[0], rtol=2e-5)
    model.graph.node[0].attribute.pop()
    onnx.save(model, tmp_path / "net.onnx")
    with pytest.raises(
        InputError, match="has a Clip of the input to -inf and 0.5; only limits that are symmetric about zero"
    ):
        load_scenario(tmp_path / "mine.yaml")


def test_operators_of_another_library_are_refused(tmp_path):
    """The optimiser of onnxruntime writes operators that have ONNX names but may have other meanings."""
    model = model_of(
        two_layers(activation=[make_node("Gelu", ["hidden"], ["active"], domain="com.microsoft")]), GRAPH_CONSTANTS
    )
    model.opset_import.append(helper.make_opsetid("com.microsoft", 1))
    onnx.save(model, tmp_path / "net.onnx")
    (tmp_path / "mine.yaml").write_text(POLICY_SCENARIO.format(file="net.onnx"), encoding="utf-8")
    with pytest.raises(InputError, match="has a node Gelu of com.microsoft; export it without optimisation"):
        load_scenario(tmp_path / "mine.yaml")


@pytest.mark.parametrize("version", [2147483647, 0, 10_000])
def test_an_unknown_opset_is_refused(tmp_path, version):
    model = model_of(two_layers(), GRAPH_CONSTANTS)
    model.opset_import[0].version = version
    onnx.save(model, tmp_path / "net.onnx")
    (tmp_path / "mine.yaml").write_text(POLICY_SCENARIO.format(file="net.onnx"), encoding="utf-8")
    words = rf"net.onnx: has opset {version}, but onnx [\d.]+ supports 1 to {onnx.defs.onnx_opset_version()}$"
    with pytest.raises(InputError, match=words):
        load_scenario(tmp_path / "mine.yaml")


def test_recurrent_units_have_the_output_of_the_onnx_evaluator(load_onnx):
    units, shapes = 3, {"W": (1, 9, 6), "R": (1, 9, 3), "B": (1, 18)}
    constants = {name: RNG.normal(size=shape) for name, shape in shapes.items()}
    nodes = [helper.make_node("GRU", ["seen", "W", "R", "B"], ["", "done"], hidden_size=units, linear_before_reset=1)]
    action = output(load_onnx(nodes, constants))
    evaluator = onnx.reference.ReferenceEvaluator(model_of(nodes, constants))
    (expected,) = evaluator.run(None, {"seen": OBSERVATION[None, None].astype(np.float32)})
    np.testing.assert_allclose(action, expected.ravel(), rtol=1e-5)


def reshaped(name, source, target, *shape):
    """Return a node that reshapes a value, and the constant with the shape."""
    return helper.make_node("Reshape", [source, f"{name}_shape"], [target]), {f"{name}_shape": np.array(shape)}


@pytest.mark.parametrize("exchanges", [True, False])
def test_a_model_that_exchanges_observations_is_refused(load_onnx, exchanges):
    """A transposition exchanges values unless one of the two lengths is 1."""
    lengths = (3, 2) if exchanges else (6, 1)
    first, first_shape = reshaped("first", "seen", "a", *lengths)
    last, last_shape = reshaped("last", "b", "c", 1, 6)
    nodes = [first, helper.make_node("Transpose", ["a"], ["b"]), last, helper.make_node("MatMul", ["c", "W"], ["done"])]
    constants = {"W": 0.1 * RNG.normal(size=(6, 3)), **first_shape, **last_shape}
    if exchanges:
        with pytest.raises(InputError, match="exchanges values between its layers"):
            load_onnx(nodes, constants)
    else:
        np.testing.assert_allclose(output(load_onnx(nodes, constants)), OBSERVATION @ constants["W"], rtol=1e-5)


def test_a_constant_that_adds_rows_is_refused(load_onnx):
    nodes = [helper.make_node("MatMul", ["seen", "W"], ["a"]), helper.make_node("Add", ["a", "b"], ["done"])]
    with pytest.raises(InputError, match="input or output of several rows|numbers"):
        load_onnx(nodes, {"W": 0.1 * RNG.normal(size=(6, 3)), "b": RNG.normal(size=(3, 1))})


@pytest.mark.parametrize(
    ("nodes", "words"),
    [
        ([helper.make_node("Softmax", ["seen"], ["done"])], "has an unsupported node Softmax"),
        ([helper.make_node("Tanh", ["seen"], ["done"])], "has an activation tanh that does not follow a dense layer"),
        (
            [
                helper.make_node("MatMul", ["seen", "W"], ["a"]),
                helper.make_node("Tanh", ["a"], ["b"]),
                helper.make_node("Mul", ["b", "W"], ["done"]),
            ],
            "has arithmetic of 3 neurons with 18 numbers",
        ),
        (
            [helper.make_node("GRU", ["seen", "W", "W"], ["", "done"], hidden_size=3)],
            "has an unsupported GRU",
        ),
    ],
)
def test_errors_name_unsupported_onnx_nodes(load_onnx, nodes, words):
    with pytest.raises(InputError, match=words):
        load_onnx(nodes, {"W": np.zeros((6, 3))})


def test_errors_name_the_invalid_field_of_a_policy():
    def policy(action="{kind: acceleration}", observation="{}", overrides=(), scenario="figure_eight"):
        attitude = [] if scenario == "onboard" else ["control.attitude={k_p: [8, 8, 8], k_d: [4, 4, 4]}"]
        control = f"control={{kind: policy, action: {action}, observation: {observation}}}"
        return load_scenario(scenario, [control, *attitude, *overrides])

    policy()
    for arguments, words in [
        ({"action": "{kind: rotor_speeds, order: [1, 2, 3, 3]}"}, "control.action.order .*each rotor from 1 to 4 once"),
        (
            {"action": "{kind: rates, min_thrust: 2.0}"},
            "control.action.max_thrust is 2.0 by default, but must be larger",
        ),
        ({"action": "{kind: magic}"}, "control.action.kind is 'magic', but must be one of"),
        ({"observation": "{signals: [wind, wind]}"}, "control.observation.signals .*must name each signal once"),
        (
            {"observation": "{signals: [reference_ahead]}"},
            "control.observation.ahead .*if signals has reference_ahead",
        ),
        ({"observation": "{ahead: [0.1]}"}, "control.observation.ahead .*left out otherwise"),
        ({"observation": "{signals: [attitude], turn: 0.1}"}, "control.observation.turn is 0.1, but must be 0"),
        ({"observation": "{signals: [speed]}"}, "control.observation.signals.0 is 'speed'"),
        ({"observation": "{history: 0}"}, "control.observation.history is 0"),
        ({"overrides": ["control.attitude=null"]}, "control.attitude is missing"),
        ({"action": "{kind: rates}", "overrides": ["control.attitude=null"]}, "control.action.k_rate is missing"),
        (
            {"action": "{kind: rotor_speeds}", "scenario": "onboard"},
            "control.action.kind is '?rotor_speeds'?, but must be acceleration, attitude, rates with",
        ),
        (
            {"scenario": "onboard", "overrides": ["control.attitude={k_p: [8, 8, 8], k_d: [4, 4, 4]}"]},
            "must be left out",
        ),
        (
            {"scenario": "onboard", "action": "{kind: rates, k_rate: [9, 9, 9]}"},
            "control.action.k_rate .*must be left out, or null, since laboratory.autopilot of kind attitude has its"
            " own",
        ),
        (
            {"action": "{kind: rates, k_rate: [9, 9, 9]}"},
            "control.attitude .*must be left out, or null, since actions of kind rates do not use it",
        ),
        (
            {"action": "{kind: rotor_speeds}"},
            "control.attitude .*must be left out, or null, since actions of kind rotor_speeds do not use it",
        ),
        (
            {"action": "{kind: rotor_speeds, min_rotor_speed: 300}", "overrides": ["control.attitude=null"]},
            "control.action.min_rotor_speed is 300, but must be smaller than max_rotor_speed in nominal, 300.0",
        ),
        (
            {"observation": "{signals: [velocity, clearance]}"},
            "control.observation.signals .*must not contain clearance, which is infinite",
        ),
    ]:
        with pytest.raises(InputError, match=words):
            policy(**arguments)


def test_the_error_for_a_missing_onnx_library_names_the_library(load_onnx, monkeypatch):
    monkeypatch.setitem(sys.modules, "onnx", None)
    with pytest.raises(InputError, match=r"net\.onnx: cannot be read: onnx is not installed; .*'drake_quad\[onnx\]'"):
        load_onnx(two_layers(), GRAPH_CONSTANTS)


@pytest.mark.parametrize("cube", [0.05, 0.04])
def test_a_gate_that_only_resembles_gelu_is_refused(load_onnx, cube):
    """A wrong coefficient of x³ is not mistaken for the rounding error of single precision."""
    with pytest.raises(InputError, match="has branches that meet in a node Mul"):
        load_onnx(approximated_gelu("three", "cube"), {**GRAPH_CONSTANTS, "cube": np.array(cube)})


@pytest.mark.parametrize("shapes", [{"B": (1, 9)}, {"W": (1, 6, 6)}, {"W": (2, 9, 6)}])
def test_recurrent_units_of_onnx_need_weights_and_biases_of_three_gates(load_onnx, shapes):
    shapes = {"W": (1, 9, 6), "R": (1, 9, 3), "B": (1, 18), **shapes}
    node = make_node("GRU", ["seen", "W", "R", "B"], ["", "done"], hidden_size=3, linear_before_reset=1)
    with pytest.raises(InputError, match="has a GRU with weights and biases of inconsistent shapes"):
        load_onnx([node], {name: np.ones(shape) for name, shape in shapes.items()})


@pytest.mark.parametrize(
    ("nodes", "words"),
    [
        (
            [make_node("Reshape", ["D", "two"], ["a"]), make_node("Add", ["seen", "a"], ["done"])],
            "has a node Reshape with constant inputs that cannot be computed",
        ),
        (
            [make_node("Gemm", ["W", "seen"], ["done"], transB=1)],
            "has a Gemm that does not multiply its input by a constant matrix",
        ),
        (
            [make_node("Gemm", ["seen", "W"], ["done"], transA=1)],
            "has a Gemm that does not multiply its input by a constant matrix",
        ),
        (
            two_layers(activation=[make_node("Swish", ["hidden"], ["active"], alpha=0.5)]),
            "activation Swish with an alpha of 0.5",
        ),
        (
            [
                make_node("Add", ["seen", "D"], ["a"]),
                make_node("Mul", ["a", "C"], ["b"]),
                *two_layers(first=("b", "hidden")),
            ],
            "has arithmetic on its input with arrays of different sizes",
        ),
        (
            [
                make_node("Sub", ["one", "one"], ["zero"]),
                make_node("Mul", ["seen", "zero"], ["a"]),
                *two_layers(first=("a", "hidden")),
            ],
            "multiplies its input by zero",
        ),
        (
            two_layers(
                activation=[("Tanh", ["hidden"], ["a"]), ("Add", ["a", "D"], ["b"]), ("Add", ["b", "C"], ["active"])]
            ),
            "has arithmetic with arrays of different sizes",
        ),
    ],
)
def test_arithmetic_that_is_not_part_of_a_network_is_refused(load_onnx, nodes, words):
    with pytest.raises(InputError, match=words):
        load_onnx(nodes, GRAPH_CONSTANTS)


@pytest.mark.parametrize(
    ("inputs", "outputs", "words"),
    [
        ([], ["done"], "has no inputs"),
        (["seen", "more"], ["done"], "has the inputs seen, more, but must have only one"),
        (["seen"], [], "has no outputs"),
    ],
)
def test_an_onnx_network_must_have_one_input_and_an_output(tmp_path, inputs, outputs, words):
    model = model_of(two_layers() if inputs else [make_node("Identity", ["C"], ["done"])], GRAPH_CONSTANTS)
    del model.graph.input[:], model.graph.output[:]
    for graph, names in ((model.graph.input, inputs), (model.graph.output, outputs)):
        graph.extend(helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, 6]) for name in names)
    onnx.save(model, tmp_path / "net.onnx")
    (tmp_path / "mine.yaml").write_text(POLICY_SCENARIO.format(file="net.onnx"), encoding="utf-8")
    with pytest.raises(InputError, match=words):
        load_scenario(tmp_path / "mine.yaml")
