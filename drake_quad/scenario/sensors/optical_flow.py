"""Optical flow in the scenario language."""

from typing import Annotated, Any, ClassVar, Literal

from drake_quad.estimation.corrections import FlowAiding
from drake_quad.framework.records import record_like
from drake_quad.laboratory.sensors.optical_flow import OPTICAL_FLOW, OpticalFlowParameters
from drake_quad.scenario.plausible import PLAUSIBLE_RELATIVE_ERROR, PLAUSIBLE_SIZE
from drake_quad.scenario.quantities import NonNegative, Number, Position, Positive, RelativeError, field_from_record
from drake_quad.scenario.sensors.aiding import AidingModel
from drake_quad.scenario.sensors.mounting import relative_to_centre
from drake_quad.scenario.sensors.sensor import SENSORS, SensorSettings


@SENSORS.register
class OpticalFlowSettings(SensorSettings):
    """Camera that looks down along -z of B and measures the angular velocity of the ground in its image."""

    kind: Literal["optical_flow"]
    position: Annotated[Position, PLAUSIBLE_SIZE] = field_from_record(
        OpticalFlowParameters, "position", "x, y and z in B relative to the origin of `layout`, like `centre_of_mass`"
    )
    ground: Number = field_from_record(OpticalFlowParameters, "ground", "height of the ground in W")
    min_distance: NonNegative = field_from_record(
        OpticalFlowParameters, "min_distance", "smallest distance to the ground; readings below are missing"
    )
    max_distance: Positive = field_from_record(
        OpticalFlowParameters, "max_distance", "largest distance to the ground; readings above are missing"
    )
    max_flow: Positive = field_from_record(
        OpticalFlowParameters, "max_flow", "largest flow on each axis; readings above are missing"
    )
    flow_noise: NonNegative = field_from_record(
        OpticalFlowParameters, "flow_noise", "standard deviation of a reading on each axis"
    )
    scale_error: Annotated[RelativeError, PLAUSIBLE_RELATIVE_ERROR] = field_from_record(
        OpticalFlowParameters, "scale_error", "relative scale error"
    )
    law: ClassVar = OPTICAL_FLOW
    noise: ClassVar = ("flow_noise",)
    aids: ClassVar = AidingModel("flow", (("flow_noise",),))

    def parameters(self, vehicle: Any) -> OpticalFlowParameters:
        """Return the parameters of optical flow."""
        return record_like(OpticalFlowParameters, self, position=relative_to_centre(self.position, vehicle))

    def aiding_parameters(self, deviations: tuple[Any, ...]) -> FlowAiding:
        """Return the parameters of the measurement equation for the flow, given its standard deviation (rad/s)."""
        (deviation,) = deviations
        return FlowAiding(deviation, self.ground)
