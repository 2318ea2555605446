"""Initial vehicle state in the scenario language."""

import math
from typing import Annotated, Any, Literal

from pydantic import Field

from drake_quad.scenario.distributions import Model, NumberOrDistribution
from drake_quad.scenario.quantities import Direction, NonNegative, Number, Position, bounds, radians
from drake_quad.vehicle.quadrotor import HoverPose, InitialMotion

_Roll = Annotated[NumberOrDistribution, bounds(ge=-math.pi, le=math.pi), radians(math.pi)]
_Pitch = Annotated[NumberOrDistribution, bounds(ge=-0.5 * math.pi, le=0.5 * math.pi), radians(0.5 * math.pi)]


class InitialState(Model):
    """State of the vehicle at time 0. By default, the vehicle hovers at the start of the reference."""

    frame: Literal["reference", "world"] = Field(
        default="reference",
        description="`reference`: position and yaw are relative to the reference at time 0; `world`: they are absolute",
    )
    position: Position = Field(default=(0.0, 0.0, 0.0), description="position along X, Y and Z of W (m)")
    velocity: Position = Field(default=(0.0, 0.0, 0.0), description="velocity along X, Y and Z of W (m/s)")
    attitude: Annotated[tuple[_Roll, _Pitch, Direction], Field(strict=False)] = Field(
        default=(0.0, 0.0, 0.0),
        description="roll, pitch and yaw (rad); a vehicle with a roll of π is upside down",
    )
    body_rates: Annotated[tuple[Number, Number, Number], Field(strict=False)] = Field(
        default=(0.0, 0.0, 0.0), description="angular velocity about the axes x, y and z of B (rad/s)"
    )
    rotor_speeds: Annotated[tuple[NonNegative, NonNegative, NonNegative, NonNegative], Field(strict=False)] = Field(
        default=(1.0, 1.0, 1.0, 1.0), description="speed of each rotor, as a multiple (1) of its speed in hover"
    )

    def pose(self, fleet: Any, start: HoverPose) -> HoverPose:
        """Return the initial position and yaw of a fleet's vehicles.

        Args:
            fleet: initial state in `Batch.fleet_scenario`, in which random fields are arrays.
            start: position and yaw of the reference at time 0.
        """
        x, y, z = fleet.position
        pose = HoverPose(x, y, z, fleet.attitude[2])
        if self.frame == "world":
            return pose
        return HoverPose._make(offset + value for offset, value in zip(pose, start, strict=True))

    @staticmethod
    def motion(fleet: Any) -> InitialMotion:
        """Return the initial tilt, velocity, body rates and rotor speeds of a fleet's vehicles."""
        roll, pitch, _ = fleet.attitude
        return InitialMotion(roll, pitch, *fleet.velocity, *fleet.body_rates, *fleet.rotor_speeds)
