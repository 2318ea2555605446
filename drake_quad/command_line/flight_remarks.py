"""Remarks on scenarios that commands print before the flight."""

from collections.abc import Iterable

from drake_quad.command_line.output import remark
from drake_quad.flight.remarks import flight_remarks
from drake_quad.scenario.models import Scenario


def print_flight_remarks(scenarios: Iterable[Scenario]) -> None:
    """Print the `flight_remarks` of scenarios on standard error, without repetitions."""
    for sentence in dict.fromkeys(sentence for scenario in scenarios for sentence in flight_remarks(scenario)):
        remark(sentence)
