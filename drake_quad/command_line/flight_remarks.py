"""Remarks on scenarios that commands print before the flight."""

from collections.abc import Iterable, Mapping

from drake_quad.command_line.output import remark
from drake_quad.flight.remarks import flight_remarks, unequal_conditions
from drake_quad.scenario.models import Scenario


def print_flight_remarks(scenarios: Iterable[Scenario]) -> None:
    """Print the `flight_remarks` of scenarios on standard error, without repetitions."""
    for sentence in dict.fromkeys(sentence for scenario in scenarios for sentence in flight_remarks(scenario)):
        remark(sentence)


def remark_on_estimator(scenario: Scenario) -> None:
    """Print a remark on standard error if a controller is designed for a scenario with a state estimator."""
    if scenario.laboratory.estimator.integrates_sensors:
        remark("the design assumes a direct measurement of the state; margins at the link include the estimator")


def print_comparison_remarks(scenarios: Mapping[str, Scenario]) -> None:
    """Print a remark on each controller whose flight conditions differ from those of the first controller.

    Args:
        scenarios: scenario of each controller, by the controller's name.
    """
    for sentence in unequal_conditions(scenarios):
        remark(sentence)
