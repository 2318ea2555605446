"""Industrial fan in the scenario language."""

from collections.abc import Sequence
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, field_validator

from drake_quad.framework.recipe import Recipe
from drake_quad.laboratory.wind.fans import Direction, Fans, Jet, Outlet
from drake_quad.scenario.distributions import validation_error
from drake_quad.scenario.limits import MIN_MAGNITUDE
from drake_quad.scenario.plausible import PLAUSIBLE_RELATIVE_ERROR, Plausible, not_in_millimetres
from drake_quad.scenario.quantities import NonNegative, Number, Position, Positive, excludes_zero
from drake_quad.scenario.winds.source import WINDS, WindSource, WindSurroundings, jets
from drake_quad.signals import VelocityW

# Fan walls for quadrotors move up to 100 m³/s. Industrial fans have diameters of up to 7 m.
_PLAUSIBLE_FLOW = Plausible("m³/s", "m³/h", 1.0 / 3600.0, upper=500.0)
_PLAUSIBLE_DIAMETER = not_in_millimetres(upper=10.0)


@WINDS.register
class FanSource(WindSource):
    """An industrial fan: a free jet in a room."""

    kind: Literal["fan"]
    position: Position = Field(description="centre of the outlet, in W (m)")
    direction: Position = Field(description="vector of any length in the direction of the flow, in W")
    flow: Annotated[NonNegative, _PLAUSIBLE_FLOW] = Field(description="volume flow (m³/s)")
    diameter: Annotated[Positive, _PLAUSIBLE_DIAMETER] = Field(description="diameter of the outlet (m)")
    turbulence: Annotated[NonNegative, PLAUSIBLE_RELATIVE_ERROR] = Field(
        default=0.22, description="standard deviation of the air velocity on each axis, relative to the mean speed (1)"
    )
    strength_fields: ClassVar = ("flow",)
    depends_on_position: ClassVar = True
    depends_on_time: ClassVar = False

    @field_validator("direction")
    @classmethod
    def _has_direction(cls, direction: tuple[Number, Number, Number]) -> tuple[Number, Number, Number]:
        if not any(excludes_zero(part) for part in direction):
            raise validation_error(f"must have a component whose magnitude is at least {MIN_MAGNITUDE} in every sample")
        return direction

    def jets(self) -> tuple[Jet, ...]:
        """Return the jet of the fan."""
        jet = Jet.of_fan(
            outlet=Outlet(*self.position),
            direction=Direction(*self.direction),
            flow=self.flow,
            diameter=self.diameter,
            turbulence=self.turbulence,
        )
        return (jet,)

    def max_speed(self) -> VelocityW:
        """Return the mean speed of the air at the outlet, m/s."""
        return self.jets()[0].exit_speed

    def without_turbulence(self) -> WindSource | None:
        """Return the same fan with a jet that is not turbulent."""
        return self.model_copy(update={"turbulence": 0.0})

    def recipe(self, surroundings: WindSurroundings) -> Recipe:
        """Return the recipe to build the wind of this fan alone."""
        return Recipe(Fans, {"period": surroundings.period}, self.jets())

    @classmethod
    def recipes(cls, sources: Sequence[Any], surroundings: WindSurroundings) -> dict[str, Recipe]:
        """Return the recipe to build a single system that computes the wind of all fans."""
        return {"fans": sources[0].recipe(surroundings)._replace(parameters=jets(sources))}
