"""Distance to an ultra-wideband anchor in the scenario language."""

from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from drake_quad.estimation.corrections import AnchorAiding
from drake_quad.framework.records import record_like
from drake_quad.geometry.axes import Vector
from drake_quad.laboratory.sensors.uwb_range import UWB_RANGE, Anchor, Outliers, UwbErrors, UwbParameters
from drake_quad.scenario.inactive import needs
from drake_quad.scenario.plausible import PLAUSIBLE_SIZE
from drake_quad.scenario.quantities import NonNegative, Number, Position, Positive, Probability, field_from_record
from drake_quad.scenario.sensors.aiding import AidingModel
from drake_quad.scenario.sensors.mounting import relative_to_centre
from drake_quad.scenario.sensors.sensor import SENSORS, SensorSettings


@SENSORS.register
class UwbRangeSettings(SensorSettings):
    """Ultra-wideband radio, which measures the distance to one anchor. Add one sensor for each anchor."""

    kind: Literal["uwb_range"]
    anchor: Position = Field(default=(0.0, 0.0, 0.0), description="position of the anchor in W (m)")
    position: Annotated[Position, PLAUSIBLE_SIZE] = field_from_record(
        UwbParameters, "position", "x, y and z of the antenna in B relative to the origin of `layout`"
    )
    max_distance: Positive = field_from_record(
        UwbParameters, "max_distance", "range of the radio; readings at larger distances are missing"
    )
    bias: Number = field_from_record(UwbParameters, "bias", "constant error")
    distance_noise: NonNegative = field_from_record(UwbParameters, "distance_noise", "standard deviation of a reading")
    outlier_rate: Probability = Field(
        default=0.0, description="probability that a reflected signal is received, whose path is longer (1)"
    )
    outlier_size: Annotated[NonNegative, needs("outlier_rate")] = Field(
        default=0.0,
        description="standard deviation of a normal random number, whose magnitude an outlier adds to the distance (m)",
    )
    law: ClassVar = UWB_RANGE
    nonlinear: ClassVar = {"outlier_rate": 0.0}
    noise: ClassVar = ("distance_noise", "outlier_rate")
    aids: ClassVar = AidingModel("anchor_distance", (("distance_noise",),))

    def parameters(self, vehicle: Any) -> UwbParameters:
        """Return the parameters of the distance measurement."""
        errors = UwbErrors(Outliers.of(self.outlier_rate, self.outlier_size))
        position = relative_to_centre(self.position, vehicle)
        return record_like(UwbParameters, self, anchor=Anchor(*self.anchor), position=position, errors=errors)

    def aiding_parameters(self, deviations: tuple[Any, ...]) -> AnchorAiding:
        """Return the parameters of the measurement equation for the distance, given its standard deviation (m)."""
        (deviation,) = deviations
        return AnchorAiding(deviation, Vector(*self.anchor))
