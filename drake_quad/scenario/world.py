"""Fields of a scenario with several vehicles."""

from typing import Annotated

from pydantic import Field

from drake_quad.scenario.distributions import Model, Real
from drake_quad.scenario.quantities import FixedNonNegative, FixedPositive, Point
from drake_quad.vehicle.downwash import CRAZYFLIE_DOWNWASH, DownwashParameters

VEHICLES = "vehicles"
"""Field with the vehicles by their names."""
WORLD = "world"
"""Field with `WorldSettings`."""


class DownwashSettings(Model):
    """Downwash of the vehicles; the defaults are those of the Crazyflie 2 in gym-pybullet-drones."""

    force: FixedNonNegative = Field(default=CRAZYFLIE_DOWNWASH.force, description="factor of the force (N)")
    spread: Real = Field(default=CRAZYFLIE_DOWNWASH.spread, description="increase of the radius with the height (1)")
    offset: Real = Field(
        default=CRAZYFLIE_DOWNWASH.offset, description="radius at the height 0, whose sign does not matter (m)"
    )
    propeller_radius: FixedPositive = Field(
        default=CRAZYFLIE_DOWNWASH.propeller_radius, description="radius of a propeller (m)"
    )
    min_height: FixedPositive = Field(
        default=CRAZYFLIE_DOWNWASH.min_height,
        description="height below which the force is proportional to the height (m); the default is an assumption",
    )

    def parameters(self) -> DownwashParameters:
        """Return the parameters of the downwash."""
        return DownwashParameters(self.force, self.spread, self.offset, self.propeller_radius, self.min_height)


class WorldSettings(Model):
    """Field `world` of a world."""

    radius: FixedPositive = Field(description="radius of the sphere around each vehicle (m)")
    downwash: DownwashSettings | None = Field(
        default_factory=DownwashSettings, description="downwash of the vehicles; none if null"
    )


class VehicleSettings(Model):
    """Fields of a vehicle of a world in addition to those of a scenario."""

    extends: Annotated[tuple[str, ...], Field(strict=False)] = Field(
        default=(), description="further layers, as in a scenario"
    )
    offset: Point | None = Field(default=None, description="offset of the route in W (m)")
