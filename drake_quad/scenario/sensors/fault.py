"""Faults of sensors in the scenario language."""

import math
from abc import abstractmethod
from collections.abc import Iterator
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from drake_quad.laboratory.sensors.sensor import FaultKind, SensorFault
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.inactive import FlightConditions, InactiveSetting, late_setting
from drake_quad.scenario.quantities import Moment, Probability, Span
from drake_quad.signals import Row


class _Fault(Model):
    """Fault during an interval of time.

    Attributes:
        effect: effect of the fault on readings.
    """

    time: Moment = Field(default=0.0, description="time at which the fault begins (s)")
    duration: Span | None = Field(
        default=None, description="duration of the fault (s); the fault lasts until the end of the flight if not given"
    )
    effect: ClassVar[FaultKind]

    @abstractmethod
    def loss_rate(self) -> Row:
        """Return the probability that a reading is lost during the fault."""

    def parameters(self) -> SensorFault:
        """Return the parameters of the fault."""
        end = math.inf if self.duration is None else self.time + self.duration
        return SensorFault(self.time, end, self.loss_rate())

    def inactive_settings(self, flight: FlightConditions, path: str) -> Iterator[InactiveSetting]:
        """Yield settings without effect, such as a fault after the flight."""
        yield from super().inactive_settings(flight, path)
        yield from late_setting(self, "time", flight, path)


class FailedSensor(_Fault):
    """The sensor takes no reading, as in an outage of satellite navigation. Its readings are not valid."""

    kind: Literal["failed"]
    effect: ClassVar = FaultKind(is_reported=True, is_random=False)

    def loss_rate(self) -> Row:
        """Return 1, since no reading is taken."""
        return 1.0


class FrozenSensor(_Fault):
    """The sensor repeats its last reading as if it were a new one. Its readings are valid."""

    kind: Literal["frozen"]
    effect: ClassVar = FaultKind(is_reported=False, is_random=False)

    def loss_rate(self) -> Row:
        """Return 1, since no new reading is taken."""
        return 1.0


class DropoutsOfSensor(_Fault):
    """Each reading is lost with a probability. Lost readings are not valid."""

    kind: Literal["dropout"]
    probability: Probability = Field(description="probability that a reading is lost (1)")
    effect: ClassVar = FaultKind(is_reported=True, is_random=True)
    strength_fields: ClassVar = ("probability",)

    def loss_rate(self) -> Row:
        """Return the probability that a reading is lost."""
        return self.probability


AnyFault = Annotated[FailedSensor | FrozenSensor | DropoutsOfSensor, Field(discriminator="kind")]
