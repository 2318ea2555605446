"""Tests of saving learned networks, and of flights with saved networks."""

import dataclasses

import numpy as np
import pytest
from ruamel.yaml import YAML

from drake_quad import InputError, load_scenario, save_network, simulate
from drake_quad.control.position import PdGains, ProportionalDerivative, build_position_controller
from drake_quad.flight.simulation import simulate_samples
from drake_quad.geometry.per_axis import PerAxis
from drake_quad.scenario.files.saving import save_scenario

# A network with few rules compiles faster.
FEW_SETS = "centres: [-1.0, 0.9], widths: [1.9, 2.1]"
FEW_RULES = f"control.network.inputs={{error: {{{FEW_SETS}}}, error_rate: {{{FEW_SETS}}}}}"
ADAPTIVE_SETS = "control.network.adaptive={centres: 0.4, widths: 0.3, exponents: 0.2}"
SHORT_FLIGHT = ("duration=0.8", "metrics.start=0")


def simulated_flight(asymmetric, *overrides):
    return simulate(asymmetric("pd_t2fnn", *SHORT_FLIGHT, *overrides), sample=0)


@pytest.mark.long
@pytest.mark.parametrize("settings", [[FEW_RULES], [FEW_RULES, ADAPTIVE_SETS]])
def test_a_network_starts_with_the_final_parameters_of_another_flight(asymmetric, tmp_path, settings):
    """Each axis and each vehicle of a fleet starts with the saved parameters. A saved scenario contains them."""
    first = simulated_flight(asymmetric, *settings)
    file = save_network(first, tmp_path / "deeper" / "learned.yaml")
    again = asymmetric("pd_t2fnn", *SHORT_FLIGHT, *settings, f"control.network.learned={file}")
    for flight in simulate_samples(again, [0, 3]):
        np.testing.assert_array_equal(flight["weights"][0], first["weights"][-1])
        if ADAPTIVE_SETS in settings:
            np.testing.assert_array_equal(flight["antecedents"][0], first["antecedents"][-1])
    file.rename(tmp_path / "elsewhere.yaml")
    save_scenario(again, tmp_path / "again.yaml")
    assert load_scenario(tmp_path / "again.yaml").control == again.control


@pytest.mark.long
def test_learned_fuzzy_sets_are_used_even_if_a_flight_only_adapts_the_weights(asymmetric, tmp_path):
    """The first corrections are the same whether or not the flight adapts the fuzzy sets further."""
    file = save_network(simulated_flight(asymmetric, FEW_RULES, ADAPTIVE_SETS), tmp_path / "learned.yaml")
    learned = f"control.network.learned={file}"
    constant_sets, adaptive_sets = (
        simulated_flight(asymmetric, FEW_RULES, learned, *overrides) for overrides in ([], [ADAPTIVE_SETS])
    )
    np.testing.assert_array_equal(constant_sets["correction"][:2], adaptive_sets["correction"][:2])
    assert np.abs(constant_sets["correction"][1]).min() > 0.0
    assert "antecedents" not in constant_sets.signals


@pytest.mark.long
def test_a_learning_rate_of_zero_keeps_the_learned_parameters(asymmetric, tmp_path):
    file = learned_file(tmp_path, MATCHING_HEADER + EQUAL_WEIGHTS)
    learning = "control.network.learning={kind: gradient, signal: feedback, rate: 0}"
    flight = simulated_flight(asymmetric, learning, f"control.network.learned={file}", "duration=0.3")
    np.testing.assert_array_equal(flight["weights"], 0.25)
    np.testing.assert_allclose(flight["correction"], 0.25, rtol=1e-14)


def learned_file(folder, text):
    path = folder / "learned.yaml"
    path.write_text(text)
    return path


MATCHING_HEADER = "kind: type_2\ninputs: [error, error_rate]\nsets: [3, 4]\n"
EQUAL_WEIGHTS = "".join(f"{axis}: {{weights: {[0.25] * 12}}}\n" for axis in "xyz")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (MATCHING_HEADER.replace("4", "3") + EQUAL_WEIGHTS, r"weights is .*, but must have 9 numbers"),
        (
            MATCHING_HEADER.replace("type_2", "type_1") + EQUAL_WEIGHTS,
            "same kind: this network has type_2, .* have type_1",
        ),
        (MATCHING_HEADER.replace("error, error_rate", "x, y") + EQUAL_WEIGHTS, "the learned parameters have x, y"),
        (
            MATCHING_HEADER.replace("3, 4", "4, 3") + EQUAL_WEIGHTS,
            "same sets: this network has 3, 4, .* have 4, 3",
        ),
        (
            MATCHING_HEADER + EQUAL_WEIGHTS.replace("z:", "# z:"),
            "same axes: this network has x, y, z, .* have x, y",
        ),
        (
            MATCHING_HEADER + EQUAL_WEIGHTS.replace("weights", "antecedents: [1.2], weights"),
            "antecedents is .*must have 19 numbers",
        ),
        (
            MATCHING_HEADER + EQUAL_WEIGHTS.replace("}", f", antecedents: {[0.1] * 19}}}", 1),
            "antecedents on all axes or on none",
        ),
        ("[1, 2]", "must be a mapping of fields"),
        ("", "must be a mapping of fields"),
        (MATCHING_HEADER + EQUAL_WEIGHTS + "colour: red", "colour is unknown"),
    ],
)
def test_a_file_that_does_not_match_the_network_is_refused(asymmetric, tmp_path, text, message):
    with pytest.raises(InputError, match=message) as caught:
        asymmetric("pd_t2fnn", f"control.network.learned={learned_file(tmp_path, text)}")
    assert "\n" not in str(caught.value)


def test_the_message_about_a_missing_network_file_names_it(asymmetric):
    with pytest.raises(InputError, match=r"control.network.learned refers to nowhere\.yaml, which does not exist"):
        asymmetric("pd_t2fnn", "control.network.learned=nowhere.yaml")


def test_a_relative_file_name_is_relative_to_the_scenario_file(root, tmp_path):
    learned_file(tmp_path, MATCHING_HEADER + EQUAL_WEIGHTS)
    path = tmp_path / "mine.yaml"
    path.write_text(
        f"mine: {{extends: '{root}/tests/asymmetric.yaml:pd_t2fnn', control: {{network: {{learned: learned.yaml}}}}}}"
    )
    assert load_scenario(path).control.network.learned.y.weights == (0.25,) * 12


@pytest.mark.long
def test_a_network_that_diverged_is_not_saved(asymmetric, tmp_path):
    flight = simulate(asymmetric("pd_t2fnn", "duration=0.1", "metrics.start=0"), sample=0)
    for value in (np.nan, np.inf):
        weights = flight["weights"].copy()
        weights[-1, 4] = value
        diverged = dataclasses.replace(flight, signals={**flight.signals, "weights": weights})
        with pytest.raises(
            InputError, match="the parameters of the network cannot be saved, since some are NaN or infinite"
        ):
            save_network(diverged, tmp_path / "learned.yaml")
    assert not [*tmp_path.iterdir()]


@pytest.mark.long
def test_saving_a_flight_without_a_network_is_refused(asymmetric, tmp_path):
    """A flight in which a user's system replaces the network has no network either."""
    short = ("duration=0.1", "metrics.start=0")
    gains = PdGains(PerAxis(2.0, 2.0, 6.0), PerAxis(2.0, 2.0, 3.5))
    position_controller = build_position_controller(ProportionalDerivative(num_vehicles=1, parameters=gains))
    for flight in (
        simulate(asymmetric("pid", *short), sample=0),
        simulate(asymmetric("pd_t2fnn", *short), sample=0, position_controller=position_controller),
    ):
        with pytest.raises(InputError, match="has no network"):
            save_network(flight, tmp_path / "learned.yaml")
    assert not [*tmp_path.iterdir()]


@pytest.mark.long
def test_parameters_are_saved_for_each_axis_in_any_order_of_the_axes(asymmetric, tmp_path):
    axes = ["control.network.axes=[z, x]", FEW_RULES, "duration=0.3"]
    first = simulated_flight(asymmetric, *axes)
    file = save_network(first, tmp_path / "learned.yaml")
    again = simulated_flight(asymmetric, *axes, f"control.network.learned={file}")
    x, z = np.split(first["weights"][-1], 2)
    assert not np.array_equal(x, z)
    # The saved file contains only the learned parameters.
    saved = YAML(typ="safe").load(file)
    assert saved.keys() == {"kind", "inputs", "sets", "x", "z"}
    assert saved["x"] == {"weights": x.tolist()}
    assert saved["z"] == {"weights": z.tolist()}
    np.testing.assert_array_equal(again["weights"][0], first["weights"][-1])
