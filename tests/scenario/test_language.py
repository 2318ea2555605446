"""Tests that page and schema of the scenario language match the models, and that the schema accepts shipped files."""

import functools
import json
import re
from pathlib import Path

import jsonschema
import pytest
from ruamel.yaml import YAML

from drake_quad.scenario.distributions import DISTRIBUTIONS
from drake_quad.scenario.schema import file_schema, language_page

REPOSITORY = Path(__file__).parent.parent.parent
DOCUMENTATION = "".join(page.read_text(encoding="utf-8") for page in sorted((REPOSITORY / "docs").rglob("*.md")))
YAML_EXAMPLES = re.findall(r"```yaml\n(.*?)```", DOCUMENTATION, re.DOTALL)


@functools.cache
def validator():
    return jsonschema.Draft202012Validator(file_schema())


def schema_errors(text):
    return [error.message for error in validator().iter_errors(YAML(typ="safe", pure=True).load(text))]


@pytest.mark.slow
def test_generated_page_and_schema_are_up_to_date():
    how_to_update = "python scripts/development/document_scenarios.py --output docs/reference writes them again"
    folder = REPOSITORY / "docs" / "reference"
    assert (folder / "scenario_language.md").read_text(encoding="utf-8") == language_page(), how_to_update
    assert json.loads((folder / "scenario.schema.json").read_text(encoding="utf-8")) == file_schema(), how_to_update


@pytest.mark.parametrize("path", sorted((REPOSITORY / "diagrams").rglob("*.yaml")), ids=lambda path: path.name)
def test_the_schema_accepts_every_shipped_file(path):
    assert schema_errors(path.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize("block", YAML_EXAMPLES)
def test_the_schema_accepts_the_examples_on_the_pages(block):
    assert schema_errors(block) == []


@pytest.mark.parametrize(
    "invalid_text",
    [
        "a: {vehicle: {weight: 1.0}}",
        "a: {vehicle: {mass: heavy}}",
        "a: {route: {kind: loop}}",
        "a: {laboratory: {wind: [{kind: fan, flow: fast}]}}",
        "a: {control: {position: {kind: pd, k_p: [1.0, 1.0]}}}",
        "a: {vehicle: {mass: {normal: {mean: 1.0, standard_deviation: 0.1, min: 0.5, shared: {a: 1.5}}}}}",
        "a: {vehicle: {mass: {normal: {mean: 1.0, standard_deviation: 0.1, min: 0.5, shared: {my drone: 0.5}}}}}",
        "a: {extends: 3}",
        "a: 3",
    ],
)
def test_the_schema_rejects_invalid_files(invalid_text):
    assert schema_errors(invalid_text)


UNIFORM_YAML = "{uniform: {min: 0.1, max: 0.2}}"
ROTOR_YAML = "{position: [X, 0.1, 0], turns: clockwise, drag_factor: 0.1}"


@pytest.mark.parametrize(
    "field",
    [
        *("mass: X", "arm_length: X", "inertia: [0.1, X, 0.2]", "motors: {kind: throttle, curve: [0.0, X, 2.0]}"),
        *(f"layout: {{kind: {kind}, length: X, width: 0.1}}" for kind in ("plus", "x", "h")),
        *(f"layout: {{kind: {kind}, length: 0.1, width: X}}" for kind in ("plus", "x", "h")),
        f"layout: {{kind: rotors, rotors: [{ROTOR_YAML}, {ROTOR_YAML}, {ROTOR_YAML}, {ROTOR_YAML}]}}",
    ],
)
def test_the_schema_allows_no_distributions_in_nominal(field):
    """The fields of `nominal` must be numbers, while those of `vehicle` may be distributions."""
    assert schema_errors(f"a: {{nominal: {{{field.replace('X', '0.15')}}}}}") == []
    assert schema_errors(f"a: {{vehicle: {{{field.replace('X', UNIFORM_YAML)}}}}}") == []
    assert schema_errors(f"a: {{nominal: {{{field.replace('X', UNIFORM_YAML)}}}}}") != []


def test_every_field_is_on_the_page():
    page = language_page()
    fields = set(re.findall(r"^\| `(\w+)` \|", page, re.MULTILINE))
    assert {"centre_of_mass", "derivative_bandwidth", "initial_covariance", "turbulence", "corridors"} <= fields
    headings = {heading.lower() for heading in re.findall(r"^## (\w+)", page, re.MULTILINE)}
    # All links to distributions lead to the section of the first distribution, so the sections of the others have no
    # link.
    distributions = {model.__name__.lower() for model in DISTRIBUTIONS.values()}
    linked_sections = {*re.findall(r"\]\(#(\w+)\)", page), "scenario", *distributions}
    assert linked_sections == headings
