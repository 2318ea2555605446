"""Sensors on board, and the questions about them that the rest of the library asks.

A sensor of your own is a class that extends `SensorSettings` and is registered with `SENSORS.member`. Its readings are
then a signal, called after its kind: a port of the laboratory, which is recorded and which a control may read.
"""

from abc import abstractmethod
from typing import Annotated, Any, ClassVar, TypeVar

from pydantic import Field

from drake_quad.framework.recipe import Recipe
from drake_quad.laboratory.sensors.sensor import Sensor, SensorLaw
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.quantities import Period, Ticks, any_nonzero, largest_ticks
from drake_quad.scenario.unions import OpenUnion
from drake_quad.signals import SIGNALS

_Member = TypeVar("_Member", bound=type[Model])


class SensorSettings(Model):
    """Sensor on board. Numbers that a study draws are (N,) arrays when its methods are called for a fleet.

    Attributes:
        law: law that the sensor measures by.
        noise: names of the fields that are sizes of the noise.
    """

    kind: str
    period: Period = Field(default=0.01, description="time between readings (s)")
    latency_samples: Ticks = Field(default=0, description="whole periods from a reading to its arrival")
    law: ClassVar[SensorLaw]
    noise: ClassVar[tuple[str, ...]]

    @abstractmethod
    def numbers(self, vehicle: Any) -> Any:
        """Return the record of the numbers of the law, given the vehicle that flies."""

    def recipe(self, fleet: Any, vehicle: Any) -> Recipe:
        """Return the recipe for the sensors of a fleet.

        Args:
            fleet: the sensor in a `Batch.fleet_scenario`.
            vehicle: the vehicle in a `Batch.fleet_scenario`.
        """
        structure = {
            "name": self.kind,
            "law": self.law,
            "period": self.period,
            "noisy": any(any_nonzero(getattr(self, name), getattr(fleet, name)) for name in self.noise),
            "longest_latency": largest_ticks(self.latency_samples, fleet.latency_samples),
        }
        return Recipe(Sensor, structure, fleet.numbers(vehicle))


class _SensorUnion(OpenUnion):
    """Kinds of sensors, whose readings are signals while they are registered."""

    def member(self, model: _Member) -> _Member:
        """Register a sensor and its signal, as a decorator of its class."""
        super().member(model)
        name = self._name_of(model)
        SIGNALS[name] = self.members[name].law.reading
        return model

    def remove(self, name: str) -> None:
        """Remove a sensor and its signal."""
        super().remove(name)
        del SIGNALS[name]

    def _name_of(self, model: type[Any]) -> str:
        name = super()._name_of(model)
        if name in SIGNALS and name not in self.members:
            raise ValueError(f"there is a signal called {name}, so no sensor can have this kind")
        return name


SENSORS = _SensorUnion(SensorSettings)
"""Kinds of sensors on board."""

AnySensor = Annotated[SensorSettings, SENSORS]
