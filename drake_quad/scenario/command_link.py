"""Command link in the scenario language."""

from typing import Any

from pydantic import Field

from drake_quad.framework.recipe import Recipe
from drake_quad.framework.records import record_like
from drake_quad.laboratory import command_link
from drake_quad.laboratory.command_link import LinkParameters
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.quantities import Period, Probability, Ticks, any_nonzero, field_from_record, max_ticks
from drake_quad.signals import AttitudeTarget, Wrench


class CommandLinkSettings(Model):
    """Radio link that carries the command to the vehicle: a wrench, or a target for the autopilot."""

    period: Period = Field(default=0.02, description="control period (s); the default is the paper's")
    delay_ticks: Ticks = Field(default=1, description="delay from sending to arrival, in whole control ticks")
    loss_rate: Probability = field_from_record(LinkParameters, "loss_rate", "fraction of packets that are lost")

    def recipe(self, fleet: Any, signal: command_link.Command, initial: Wrench | AttitudeTarget) -> Recipe:
        """Return the recipe to build the links of a fleet.

        Args:
            fleet: link in `Batch.fleet_scenario`, in which random fields are arrays.
            signal: name of the signal that the link carries.
            initial: command before the first packet arrives.
        """
        structure = {
            "signal": signal,
            "period": self.period,
            "longest_delay": max_ticks(self.delay_ticks, fleet.delay_ticks),
            "loses_packets": any_nonzero(self.loss_rate, fleet.loss_rate),
        }
        return Recipe(command_link.CommandLink, structure, record_like(LinkParameters, fleet, initial=initial))
