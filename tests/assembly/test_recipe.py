"""Tests of recipes for systems."""

import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, Demultiplexer

from drake_quad.assembly.user_systems import UserSystems
from drake_quad.framework.recipe import Recipe
from drake_quad.laboratory.command_link import CommandLink, LinkParameters


def nested_diagram(recipe):
    """Return a diagram that contains a diagram with the system of a recipe."""
    inner, outer = DiagramBuilder(), DiagramBuilder()
    inner.AddNamedSystem("link", recipe.build(2))
    inner.ExportInput(inner.GetSubsystemByName("link").GetInputPort("wrench"), "wrench")
    outer.AddNamedSystem("laboratory", inner.Build())
    return outer.Build()


def test_a_recipe_builds_a_system_and_resets_it_in_nested_diagrams():
    structure = {"period": 0.04, "longest_delay": 2}
    first = Recipe(CommandLink, structure, LinkParameters(delay_ticks=np.array([2.0, 0.0])))
    diagram = nested_diagram(first)
    link = diagram.GetSubsystemByName("laboratory").GetSubsystemByName("link")
    context = diagram.CreateDefaultContext()

    def delays():
        return link.get_parameter(link.GetMyContextFromRoot(context), "link").delay_ticks

    np.testing.assert_array_equal(delays(), [2.0, 0.0])
    first._replace(parameters=LinkParameters(delay_ticks=1.0)).reset(diagram, "laboratory.link", context)
    np.testing.assert_array_equal(delays(), [1.0, 1.0])


def test_a_recipe_for_a_system_with_other_ports_or_events_is_refused_on_reset():
    recipe = Recipe(CommandLink, {"period": 0.04, "longest_delay": 2}, LinkParameters())
    diagram = nested_diagram(recipe)
    longer_recipe = recipe._replace(structure={"period": 0.04, "longest_delay": 3})
    with pytest.raises(ValueError, match=r"laboratory.link was built with .*2.*, but this recipe requires .*3"):
        longer_recipe.reset(diagram, "laboratory.link", diagram.CreateDefaultContext())


def test_user_functions_build_systems_for_the_given_number_of_vehicles():
    functions = UserSystems(control=lambda n: ConstantVectorSource(np.full(n, 1.0)), wind=lambda n: Demultiplexer(n))
    assert [*functions.specified] == ["control", "wind"]
    systems = functions.build(3)
    assert [*systems.specified] == ["control", "wind"]
    assert (systems.control.get_output_port().size(), systems.wind.num_output_ports()) == (3, 3)
    assert UserSystems().build(3) == UserSystems()
