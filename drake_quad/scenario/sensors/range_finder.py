"""Range finder in the scenario language."""

from typing import Annotated, Any, ClassVar, Literal

from drake_quad.estimation.corrections import GroundAiding
from drake_quad.framework.records import record_like
from drake_quad.laboratory.sensors.range_finder import RANGE_FINDER, RangeFinderParameters
from drake_quad.scenario.plausible import PLAUSIBLE_SIZE, not_in_millimetres
from drake_quad.scenario.quantities import NonNegative, Number, Position, Positive, field_from_record
from drake_quad.scenario.sensors.aiding import AidingModel
from drake_quad.scenario.sensors.mounting import relative_to_centre
from drake_quad.scenario.sensors.sensor import SENSORS, SensorSettings

# Laser range finders of small vehicles measure up to 200 m.
_PLAUSIBLE_RANGE = not_in_millimetres(upper=500.0)


@SENSORS.register
class RangeFinderSettings(SensorSettings):
    """Range finder, which measures the distance to the ground along -z of B. Readings beyond its range are missing."""

    kind: Literal["range_finder"]
    position: Annotated[Position, PLAUSIBLE_SIZE] = field_from_record(
        RangeFinderParameters, "position", "x, y and z in B relative to the origin of `layout`, like `centre_of_mass`"
    )
    ground: Number = field_from_record(RangeFinderParameters, "ground", "height of the ground in W")
    min_distance: NonNegative = field_from_record(
        RangeFinderParameters, "min_distance", "smallest distance that is measured"
    )
    max_distance: Annotated[Positive, _PLAUSIBLE_RANGE] = field_from_record(
        RangeFinderParameters, "max_distance", "largest distance that is measured"
    )
    bias: Number = field_from_record(RangeFinderParameters, "bias", "constant error")
    distance_noise: NonNegative = field_from_record(
        RangeFinderParameters, "distance_noise", "standard deviation of a reading at distance 0"
    )
    relative_noise: NonNegative = field_from_record(
        RangeFinderParameters, "relative_noise", "growth of the standard deviation with the distance"
    )
    law: ClassVar = RANGE_FINDER
    noise: ClassVar = ("distance_noise", "relative_noise")
    aids: ClassVar = AidingModel("ground_distance", (("distance_noise", "relative_noise"),))

    def parameters(self, vehicle: Any) -> RangeFinderParameters:
        """Return the range finder parameters."""
        return record_like(RangeFinderParameters, self, position=relative_to_centre(self.position, vehicle))

    def aiding_parameters(self, deviations: tuple[Any, ...]) -> GroundAiding:
        """Return the parameters of the measurement equation for the distance to the ground.

        The standard deviation does not depend on the distance. By default, it is the standard deviation at 1 m.
        """
        (deviation,) = deviations
        return GroundAiding(deviation, self.ground)
