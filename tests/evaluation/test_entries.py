"""Tests of the shipped designs, which must equal the entries of the evaluation except for tuned parameters."""

import pytest

from drake_quad.evaluation.designs import design_file, read_designs, write_designs
from drake_quad.evaluation.entries import controller_entries
from drake_quad.evaluation.families import FAMILIES
from drake_quad.evaluation.protocol import _write_predictive_control, previous_numbers
from drake_quad.evaluation.results import (
    SENSITIVITY_LIMITS,
    SENSITIVITY_VARIANT_CONTROLLERS,
    SENSITIVITY_VARIANTS,
    sensitivity_variant_name,
)
from drake_quad.scenario.paths import split_path


def numbers_in(design, paths):
    """Return the values at the given paths of a design."""
    result = []
    for path in paths:
        part = design
        for step in split_path(path):
            part = part[int(step) if step.isdecimal() else step]
        result.append(part)
    return result


@pytest.fixture(scope="module")
def designs(diagrams):
    """Return the shipped designs by family, and the designs with other limits."""
    return {name: read_designs(design_file(diagrams, name)) for name in (*FAMILIES, SENSITIVITY_VARIANTS)}


@pytest.mark.slow
@pytest.mark.parametrize("name", FAMILIES)
def test_a_shipped_design_differs_from_its_controller_entry_only_in_tuned_parameters(name, designs):
    family = FAMILIES[name]
    entries = controller_entries(on_board=family.on_board, position_networks=family.position_networks)
    # The file of the laboratory also contains a design with a smaller margin.
    assert designs[name].keys() - {"indi_fast"} == entries.keys()
    for key, entry in entries.items():
        design = designs[name][key]
        numbers = [numbers_in(design, parameter.paths) for parameter in entry.parameters]
        for parameter, result in zip(entry.parameters, numbers, strict=True):
            assert len(set(result)) == 1
            assert parameter.low <= result[0] <= parameter.high
            # The report states that each range spans at least a factor of ten.
            assert parameter.high >= 9.99 * parameter.low
        if entry.parameters:
            assert entry.tree([result[0] for result in numbers]) == design
        else:
            assert design["control"]["kind"] == key
    for key in SENSITIVITY_VARIANT_CONTROLLERS:
        for limit in SENSITIVITY_LIMITS if name == "laboratory" else ():
            design, parameters = (
                designs[SENSITIVITY_VARIANTS][sensitivity_variant_name(key, limit)],
                entries[key].parameters,
            )
            if parameters:
                assert entries[key].tree([numbers_in(design, parameter.paths)[0] for parameter in parameters]) == design


def test_controller_entries_have_consistent_attributes():
    entries = controller_entries(on_board=False, position_networks=True)
    assert [name for name, each in entries.items() if each.uncompiled] == ["mpc"]
    in_laps = [name for name, each in entries.items() if each.trained_in_laps]
    assert in_laps == [name for name in entries if name.endswith("_map")]
    for name, each in entries.items():
        assert each.base == (name.partition("_t1")[0].partition("_t2")[0] if "fnn" in name else "")
        assert each.label == "LQG" or not each.base or each.label.startswith(f"{entries[each.base].label} + type ")
        assert each.base or ("lag" in each.plant_knowledge) == ("lag" in str(each.parameters) or name == "lqg")
    assert len({each.label for each in entries.values()}) == len(entries)
    without = controller_entries(on_board=False, position_networks=False)
    assert entries.keys() - without.keys() == set(in_laps)
    assert entries.keys() - controller_entries(on_board=True, position_networks=True).keys() == {"geometric"}


def test_the_middle_of_a_range_is_its_geometric_mean():
    entry = controller_entries(on_board=True, position_networks=False)["pd"]
    tree = entry.geometric_mean()
    for parameter in entry.parameters:
        for number in numbers_in(tree, parameter.paths):
            assert number / parameter.low == pytest.approx(parameter.high / number, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("name", FAMILIES)
def test_the_mpc_design_is_the_lqg_regulator_with_a_horizon(name, designs, tmp_path):
    path = tmp_path / "designs.yaml"
    assert list(_write_predictive_control(path)) == []
    path.write_text("lqg:\n  control: {kind: lqg, kalman: [1.0, 2.0]}\n", encoding="utf-8")
    assert [each.name for each in _write_predictive_control(path)] == ["mpc"]
    assert read_designs(path)["mpc"] == {"control": {"kind": "mpc", "kalman": [1.0, 2.0], "horizon": 0.6}}
    shipped = designs[name]
    assert shipped["mpc"]["control"] == {**shipped["lqg"]["control"], "kind": "mpc", "horizon": 0.6}


@pytest.mark.slow
def test_the_parameters_of_an_earlier_design_are_read_from_its_file(diagrams, designs, tmp_path):
    family = FAMILIES["laboratory"]
    path = design_file(diagrams, "laboratory")
    entries = controller_entries(on_board=False, position_networks=True)
    for key in ("indi", "pd_t2fnn"):
        expected = [numbers_in(designs["laboratory"][key], parameter.paths)[0] for parameter in entries[key].parameters]
        assert previous_numbers(diagrams, family, path, key, entries[key]) == expected
    assert previous_numbers(diagrams, family, tmp_path / "none.yaml", "pd", entries["pd"]) is None
    # A design of another kind has no such parameters.
    assert previous_numbers(diagrams, family, path, "pd", entries["pid"]) is None


def plain(tree):
    """Convert a tree of a YAML file to plain lists and dictionaries, without the style of the file."""
    if isinstance(tree, dict):
        return {key: plain(part) for key, part in tree.items()}
    return [plain(part) for part in tree] if isinstance(tree, list) else tree


@pytest.mark.slow
def test_rewriting_designs_does_not_change_their_file(diagrams, tmp_path):
    path = design_file(diagrams, "neural_fly")
    copy = tmp_path / "designs.yaml"
    copy.write_bytes(path.read_bytes())
    write_designs(copy, plain(read_designs(copy)), comments={})
    assert copy.read_text(encoding="utf-8") == path.read_text(encoding="utf-8")
    text = copy.read_text(encoding="utf-8")
    assert "attitude: null" in text
    write_designs(copy, {}, comments={}, header="Two\nlines")
    assert copy.read_text(encoding="utf-8").startswith("# Two\n# lines\n")
