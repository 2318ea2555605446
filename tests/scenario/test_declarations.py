"""Tests that scenarios are validated with the declared units and bounds."""

import math
import re

import pytest
from pydantic import ValidationError

from drake_quad.scenario.autopilots.autopilot import AUTOPILOTS
from drake_quad.scenario.controls.pid_cascade import PidCascadeControl
from drake_quad.scenario.declarations import quantities_in
from drake_quad.scenario.models import Laboratory, Vehicle

MAX_MAGNITUDE = 1e9
DECLARED_QUANTITIES = {(model, path): each for model in (Vehicle, Laboratory) for path, each in quantities_in(model)}
TESTED_KINDS = {
    "motors": ["throttle"],
    "layout": ["x"],
    "autopilot": [*AUTOPILOTS.members],
    "estimator": ["error_state_filter", "complementary_filter"],
}
for_each_quantity = pytest.mark.parametrize(
    ("model", "path", "declared"),
    [(*key, each) for key, each in DECLARED_QUANTITIES.items()],
    ids=[f"{model.__name__}.{path}" for model, path in DECLARED_QUANTITIES],
)


def is_refused(model, path, declared, value):
    """Return whether a model refuses a value of a field.

    If the mapping with the field has several kinds, all of them must agree. If the field is a list, a refused value
    must be refused for each item.
    """
    first, *steps = path.split(".")
    fields = [value] * declared.items if declared.items else value
    for step in reversed(steps):
        fields = {step: fields}
    refusals = set()
    for kind in TESTED_KINDS.get(first, [None]):
        if kind is not None and first == "autopilot" and steps[0] not in AUTOPILOTS.members[kind].model_fields:
            continue
        try:
            model.model_validate({first: fields if kind is None else {"kind": kind, **fields}})
            errors = []
        except ValidationError as error:
            errors = [each["loc"] for each in error.errors() if each["type"] != "missing"]
        errors_at_path = [loc for loc in errors if [step for step in loc if step in {first, *steps}] == [first, *steps]]
        refusing_items = {next((step for step in loc if isinstance(step, int)), 0) for loc in errors_at_path}
        assert len(refusing_items) in (0, max(1, declared.items))
        refusals.add(bool(refusing_items))
    (is_refused_by_all,) = refusals
    return is_refused_by_all


def value_within(declared):
    """Return a number between the bounds."""
    return 1.0 if declared.lower <= 1.0 <= declared.upper else 0.5 * (declared.lower + declared.upper)


@for_each_quantity
def test_a_number_is_refused_if_and_only_if_it_violates_the_declared_bounds(model, path, declared):
    lower, upper = float(declared.lower), float(declared.upper)
    assert -MAX_MAGNITUDE <= lower < upper <= MAX_MAGNITUDE
    outside = [lower - 1.0, upper + 1.0, math.nextafter(lower, -math.inf), math.nextafter(upper, math.inf)]
    if declared.is_whole:
        outside.append(lower + 0.5)
    for value in (lower, upper, value_within(declared)):
        assert not is_refused(model, path, declared, value)
    for value in outside:
        assert is_refused(model, path, declared, value)


@for_each_quantity
def test_a_normal_distribution_is_refused_if_and_only_if_a_declared_limit_is_missing(model, path, declared):
    mean = value_within(declared)
    below, above = {"min": mean}, {"max": mean}
    for limits, is_enough in (
        ({}, not (declared.needs_min or declared.needs_max)),
        (below, not declared.needs_max),
        (above, not declared.needs_min),
        (below | above, True),
    ):
        distribution = {"normal": {"mean": mean, "standard_deviation": 1e-3, **limits}}
        assert is_refused(model, path, declared, distribution) == (declared.is_whole or not is_enough)


@for_each_quantity
def test_declared_units_are_products_of_si_units(model, path, declared):
    relative = (
        r"unit of the (output|error|proportional gains.*)|its unit"  # loop terms have units that depend on the signals
    )
    part = r"(kg|m|s|N|rad|V|A|h|Ω)[²³]?"
    assert re.fullmatch(rf"{relative}|(1|{part}( {part})*)(/(\({part}( {part})*\)|{part}))?", declared.unit)


def test_declarations_agree_with_the_fields():
    """The test checks units and bounds of some well-known fields."""
    mass, error = DECLARED_QUANTITIES[Vehicle, "mass"], DECLARED_QUANTITIES[Vehicle, "thrust_factor_error"]
    assert (mass.unit, mass.items, mass.needs_min, mass.needs_max) == ("kg", 0, True, False)
    assert mass.lower == 1e-12
    assert (error.unit, error.items) == ("1", 4)
    assert error.lower > -1.0
    assert error.lower == pytest.approx(-1.0, abs=1e-15)
    assert DECLARED_QUANTITIES[Laboratory, "motion_capture.misalignment"].upper == math.pi
    assert DECLARED_QUANTITIES[Laboratory, "command_link.delay_ticks"].is_whole
    assert DECLARED_QUANTITIES[Laboratory, "autopilot.natural_frequency"].unit == "rad/s"
    assert {path.partition(".")[0] for model, path in DECLARED_QUANTITIES if model is Laboratory} == {
        "motion_capture",
        "command_link",
        "autopilot",
        "estimator",
    }


def test_a_formula_in_parentheses_is_not_read_as_a_unit():
    """The description of `integral_fade` contains (e / e₀)² before its unit."""
    quantities = dict(quantities_in(PidCascadeControl))
    assert quantities["velocity.integral_fade"].unit == "unit of the error"
