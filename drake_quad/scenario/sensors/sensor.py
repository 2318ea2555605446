"""Base class of onboard sensors, and their registry `SENSORS`.

To add a sensor, extend `SensorSettings` and register the class with `SENSORS.register`. The readings then form a signal
named after the kind. The laboratory has a port with this name. The signal is recorded, and a control may read it. If
readings can be missing, a second signal, whose name ends with `_valid`, tells whether the present reading is valid.
"""

from abc import abstractmethod
from typing import Annotated, Any, ClassVar, TypeVar

from pydantic import Field

from drake_quad.framework.recipe import Recipe
from drake_quad.laboratory.sensors.sensor import FaultySensor, Sensor, SensorLaw, error_names
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.quantities import Period, Ticks, any_nonzero, max_ticks
from drake_quad.scenario.sensors.aiding import AidingSensor
from drake_quad.scenario.sensors.fault import AnyFault
from drake_quad.scenario.unions import OpenUnion
from drake_quad.signals import SIGNALS, Valid, valid_signal, without_number

_Member = TypeVar("_Member", bound=type[Model])


class SensorSettings(AidingSensor, Model):
    """Onboard sensor. In a fleet scenario, randomly drawn values are (N,) arrays.

    The fields of `errors` in the parameters are the errors that can be switched off. An error is on if the scenario
    field of the same name contains a mapping or a nonzero number.

    Attributes:
        law: measurement law of the sensor.
        noise: names of the fields that determine the noise. If all are zero, the sensor has no noise.
        nonlinear: values of fields that switch off errors without a linear model.
    """

    kind: str
    period: Period = Field(default=0.01, description="time between readings (s)")
    latency_samples: Ticks = Field(default=0, description="delay from a reading to its arrival, in whole periods")
    fault: AnyFault | None = Field(default=None, description="fault of the sensor; none if not given")
    law: ClassVar[SensorLaw]
    noise: ClassVar[tuple[str, ...]]
    nonlinear: ClassVar[dict[str, Any]] = {}

    @property
    def can_miss(self) -> bool:
        """True if readings can be missing, so that a signal tells whether they are valid."""
        return self.law.can_miss or self.fault is not None

    def in_hover(self) -> "SensorSettings":
        """Return the sensor without a fault, and without errors that have no linear model."""
        return self.model_copy(update={"fault": None, **self.nonlinear})

    def without_noise(self) -> "SensorSettings":
        """Return a copy of the sensor without noise."""
        zeros = {name: (0.0,) * len(v) if isinstance(v := getattr(self, name), tuple) else 0.0 for name in self.noise}
        return self.model_copy(update=zeros)

    @property
    def latency(self) -> Any:
        """Delay from a reading to its arrival, in whole sensor periods."""
        return self.latency_samples

    @abstractmethod
    def parameters(self, vehicle: Any) -> Any:
        """Return the parameters of the measurement law, given the vehicle in `Batch.fleet_scenario`."""

    def recipe(self, fleet: Any, vehicle: Any) -> Recipe:
        """Return the recipe to build the sensors of a fleet.

        Args:
            fleet: sensor in `Batch.fleet_scenario`, in which random fields are arrays.
            vehicle: vehicle in the same scenario.
        """

        def is_on(name: str) -> bool:
            return any_nonzero(getattr(self, name), getattr(fleet, name))

        parameters = fleet.parameters(vehicle)
        structure = {
            "name": self.kind,
            "law": self.law,
            "period": self.period,
            "noisy": any(map(is_on, self.noise)),
            "longest_latency": max_ticks(self.latency_samples, fleet.latency_samples),
            "errors": tuple(filter(is_on, error_names(parameters))),
            "fault": None if self.fault is None else self.fault.effect,
        }
        if self.fault is not None:
            parameters = FaultySensor(parameters, fleet.fault.parameters())
        return Recipe(Sensor, structure, parameters)


class _SensorUnion(OpenUnion):
    """Registry of sensors that also registers the readings of each sensor, and whether they are valid, as signals."""

    def register(self, model: _Member) -> _Member:
        """Register a sensor and its signal, as a decorator of the sensor class."""
        if getattr(model, "aids", None) is not None and not hasattr(model, "aiding_parameters"):
            raise TypeError(f"{model.__name__} must define aiding_parameters, since its readings correct estimates")
        super().register(model)
        name = self._name_of(model)
        SIGNALS[name] = self.members[name].law.reading
        SIGNALS[valid_signal(name)] = Valid
        return model

    def remove(self, name: str) -> None:
        """Remove a sensor and its signal."""
        super().remove(name)
        del SIGNALS[name], SIGNALS[valid_signal(name)]

    @property
    def signals(self) -> list[str]:
        """Names of the signals that sensors can have."""
        return [each for name in self.members for each in (name, valid_signal(name))]

    def has_signal(self, name: str) -> bool:
        """Return whether a sensor can have a signal of this name, which may end with a number, as in `gnss_valid_2`."""
        return without_number(name) in self.signals

    def _name_of(self, model: type[Any]) -> str:
        name = super()._name_of(model)
        if name in SIGNALS and name not in self.members:
            raise ValueError(f"the kind {name} of {model.__name__} is the name of an existing signal; choose another")
        return name


SENSORS = _SensorUnion(SensorSettings)
"""Registry of the kinds of sensors on board."""

AnySensor = Annotated[SensorSettings, SENSORS]
