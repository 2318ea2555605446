"""Base classes of physical effects on the vehicle, and their registry `EFFECTS`.

To add an effect, extend `AirLoadEffect` and register the class with `EFFECTS.register`.
"""

from abc import abstractmethod
from typing import Annotated, Any, ClassVar

from pydantic import Field

from drake_quad.framework.records import record_like
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.quantities import NonNegative
from drake_quad.scenario.unions import OpenFields
from drake_quad.signals import Row

PerAxis = Annotated[tuple[NonNegative, NonNegative, NonNegative], Field(strict=False)]
NO_OFFSET = (0.0, 0.0, 0.0)


class VehicleEffect(Model):
    """Effect on the vehicle that the paper's equations do not contain.

    In a fleet scenario, randomly drawn values are (N,) arrays.

    Attributes:
        field: name of the vehicle field that contains the effect.
        description: description of the vehicle field.
        record: class of `drake_quad.vehicle` whose formulas compute the effect.
        is_nominal: True if the ground station knows the effect, so that controllers are designed with it.
        depends_on_time: True if the effect changes while a vehicle hovers.
        couples_axes: True if the effect can couple the axes of an otherwise symmetric vehicle.
        belongs_to_airframe: True if the effect is part of the airframe, so that the description of another vehicle
            replaces it.
        depends_on_wind: True if wind changes the forces of the effect.
    """

    field: ClassVar[str]
    description: ClassVar[str]
    record: ClassVar[type]
    is_nominal: ClassVar[bool]
    depends_on_time: ClassVar[bool]
    couples_axes: ClassVar[bool]
    belongs_to_airframe: ClassVar[bool]
    depends_on_wind: ClassVar[bool] = False

    def parameters(self) -> Any:
        """Return the `record` with the parameters of the effect."""
        return record_like(self.record, self)

    def in_hover(self) -> "VehicleEffect | None":
        """Return the part of the effect that does not change during hover; None if nothing remains."""
        return None if self.depends_on_time else self

    def symmetric(self) -> "VehicleEffect | None":
        """Return the part of the effect that does not couple axes; None if nothing remains."""
        return None if self.couples_axes else self

    def max_damping(self, vehicle: Any, airspeed: Row) -> Row:
        """Return the largest derivative of the force on the vehicle with respect to its speed, N s/m.

        Args:
            vehicle: vehicle in `Batch.fleet_scenario`, in which random fields are arrays.
            airspeed: largest airspeed of a hovering vehicle in the mean wind, m/s.
        """
        return 0.0

    def natural_frequency(self, vehicle: Any) -> Row:
        """Return the natural frequency in hover of the oscillation that the effect adds, rad/s; 0 if it adds none."""
        return 0.0

    def event_times(self) -> tuple[Row, ...]:
        """Return the times at which the forces on the vehicle are discontinuous, s."""
        return ()


EFFECTS = OpenFields(VehicleEffect)
"""Registry of the effects, each the model of a field of a vehicle."""


class AirLoadEffect(VehicleEffect):
    """Effect whose force and torque depend on airspeed and rotor speeds.

    The method `load` of the class `record` computes the force and the torque.
    """

    depends_on_wind: ClassVar = True

    @abstractmethod
    def max_damping(self, vehicle: Any, airspeed: Row) -> Row:
        """Return the largest derivative of the force on the vehicle with respect to its speed, N s/m."""
