"""Observations of policies in the scenario language."""

from typing import Annotated, Literal, NamedTuple

from pydantic import Field, model_validator

from drake_quad.control.policy.observation import OBSERVABLE_SIGNALS, Frame, ObservationSpec, num_observed
from drake_quad.laboratory.flight_monitor import Solid, nearest_solid
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.quantities import HalfTurn, PlainMoment
from drake_quad.signals import Row
from drake_quad.space.space import Space

SignalName = Literal[tuple(OBSERVABLE_SIGNALS)]  # type: ignore[valid-type] # the names of a table


class ObservationSettings(Model):
    """Observation of a policy at each tick of the control."""

    signals: Annotated[tuple[SignalName, ...], Field(strict=False, min_length=1)] = Field(  # type: ignore[valid-type]
        default=("position_error", "velocity_error", "rotation", "body_rates", "reference_acceleration", "action"),
        description="in the order of the rows; the page of systems has their rows and units",
    )
    sees: Literal["measurement", "state"] = Field(
        default="measurement",
        description="what position, velocity, attitude and rates are those of: the cameras', with their noise and"
        " delay, or the vehicle's own",
    )
    frame: Frame = Field(
        default="world",
        description="axes along which vectors are seen: those of W; those of W turned about Z by the vehicle's yaw"
        " (`heading`) or by the reference's yaw (`reference_heading`); those of B",
    )
    history: Annotated[int, Field(ge=1, le=100)] = Field(
        default=1, description="ticks that are seen, with the present one"
    )
    ahead: Annotated[tuple[PlainMoment, ...], Field(strict=False, max_length=50)] = Field(
        default=(), description="times from now of `reference_ahead`: where the reference will be, seen from here (s)"
    )
    turn: HalfTurn = Field(
        default=0.0,
        description="angle about z from x_B to the policy's front (rad); the axes of all frames but W are turned by it,"
        " too, so that a policy in W which looks along X flies at a yaw of -turn",
    )

    @model_validator(mode="after")
    def _complete(self) -> "ObservationSettings":
        if len(set(self.signals)) < len(self.signals):
            raise self.wrong("must name each signal once", "signals")
        if ("reference_ahead" in self.signals) != bool(self.ahead):
            raise self.wrong("must be given with the signal reference_ahead, and only then", "ahead")
        if self.turn and "attitude" in self.signals:
            raise self.wrong("must be 0 with the signal attitude; rotation is seen turned", "turn")
        return self

    def spec(self) -> ObservationSpec:
        """Return what is seen."""
        return ObservationSpec(self.signals, self.frame, self.history, self.turn)

    def num_rows(self, num_actions: int) -> int:
        """Return the number of rows of an observation, given that of an action."""
        return self.history * num_observed(self.spec(), num_actions=num_actions, num_ahead=len(self.ahead))

    def clearance(self, space: Space | None) -> "Clearance | None":
        """Return the distance to obstacles as a function of the position; None if it is not seen."""
        if "clearance" not in self.signals or space is None:
            return None
        return Clearance(tuple([obstacle.shape for obstacle in space.obstacles]), space.radius)


class Clearance(NamedTuple):
    """Distance of a vehicle from obstacles: a function of X, Y and Z, m.

    Attributes:
        solids: obstacles.
        radius: radius of the vehicle, m.
    """

    solids: tuple[Solid, ...]
    radius: float

    def __call__(self, x: Row, y: Row, z: Row) -> Row:
        """Return the distance between the surfaces, m."""
        distance, _ = nearest_solid(x, y, z, self.solids)
        return distance - self.radius
