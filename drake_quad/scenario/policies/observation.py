"""Policy observations in the scenario language."""

from typing import Annotated, Literal, NamedTuple

from pydantic import Field, model_validator

from drake_quad.control.policy.observation import OBSERVABLE_SIGNALS, Frame, ObservationSpec, num_observed
from drake_quad.laboratory.flight_monitor import Solid, nearest_solid
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.quantities import FixedMoment, HalfTurn
from drake_quad.scenario.sensors.sensor import SENSORS
from drake_quad.signals import Row
from drake_quad.space.space import Space


class ObservationSettings(Model):
    """Quantities that a policy observes at each control tick."""

    signals: Annotated[tuple[str, ...], Field(strict=False, min_length=1)] = Field(
        default=("position_error", "velocity_error", "rotation", "body_rates", "reference_acceleration", "action"),
        description="observed signals, in the order of their components; the page Systems lists the components and"
        " units of each signal. The signals of the sensors in `laboratory.sensors` can also be observed, such as"
        " `accelerometer` or `gnss_valid`",
    )
    state_source: Literal["measurement", "state"] = Field(
        default="measurement",
        description="source of position, velocity, attitude and body rates: the `measurement` of the cameras, with"
        " noise and delay, or the true `state` of the vehicle",
    )
    frame: Frame = Field(
        default="world",
        description="axes of observed vectors: W; W rotated about Z by the yaw of the vehicle (`heading`) or of the"
        " reference (`reference_heading`); or B",
    )
    history: Annotated[int, Field(ge=1, le=100)] = Field(
        default=1, description="number of ticks in an observation, including the present tick"
    )
    ahead: Annotated[tuple[FixedMoment, ...], Field(strict=False, max_length=50)] = Field(
        default=(),
        description="times after the present (s) at which `reference_ahead` contains the position of the reference,"
        " relative to the vehicle",
    )
    turn: HalfTurn = Field(
        default=0.0,
        description="angle about z from x_B to the forward direction of the policy (rad); it also rotates the axes of"
        " all frames except W, so that a policy that faces X in W flies at a yaw of -turn",
    )

    @model_validator(mode="after")
    def _complete(self) -> "ObservationSettings":
        for index, name in enumerate(self.signals):
            if name not in OBSERVABLE_SIGNALS and not SENSORS.has_signal(name):
                demand = f"must be {', '.join(OBSERVABLE_SIGNALS)}, or a signal of a sensor"
                raise self.field_error(demand, "signals", index)
        if len(set(self.signals)) < len(self.signals):
            raise self.field_error("must name each signal once", "signals")
        if ("reference_ahead" in self.signals) != bool(self.ahead):
            raise self.field_error("must be given if signals has reference_ahead, and left out otherwise", "ahead")
        if self.turn and "attitude" in self.signals:
            raise self.field_error("must be 0 if signals has attitude; use rotation instead of attitude", "turn")
        return self

    def spec(self) -> ObservationSpec:
        """Return the observation structure for the system that computes it."""
        return ObservationSpec(self.signals, self.frame, self.history, self.turn)

    def num_rows(self, num_actions: int) -> int:
        """Return the number of elements in an observation, given the number of elements in an action."""
        return self.history * num_observed(self.spec(), num_actions=num_actions, num_ahead=len(self.ahead))

    def clearance(self, space: Space | None) -> "Clearance | None":
        """Return the distance to obstacles as a function of position, or None if the policy does not observe it."""
        if "clearance" not in self.signals or space is None:
            return None
        return Clearance(tuple([obstacle.shape for obstacle in space.obstacles]), space.radius)


class Clearance(NamedTuple):
    """Function that returns a vehicle's distance to the nearest obstacle, m, given its position X, Y, Z, m.

    Attributes:
        solids: obstacles.
        radius: radius of the sphere that represents the vehicle, m.
    """

    solids: tuple[Solid, ...]
    radius: float

    def __call__(self, x: Row, y: Row, z: Row) -> Row:
        """Return the distance between the vehicle's sphere and the nearest obstacle, m."""
        distance, _ = nearest_solid(x, y, z, self.solids)
        return distance - self.radius
