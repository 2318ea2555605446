"""What commands print of flights before they are flown."""

from collections.abc import Iterable

from drake_quad.assembly.remarks import flight_remarks
from drake_quad.command_line.output import remark
from drake_quad.scenario import Scenario


def print_flight_remarks(scenarios: Iterable[Scenario]) -> None:
    """Print on standard error what to know of flights of scenarios, each sentence once."""
    for sentence in dict.fromkeys(sentence for scenario in scenarios for sentence in flight_remarks(scenario)):
        remark(sentence)
