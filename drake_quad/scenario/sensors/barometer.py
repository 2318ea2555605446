"""Barometer in the scenario language."""

from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from drake_quad.estimation.corrections import HeightAiding
from drake_quad.framework.records import record_like
from drake_quad.laboratory.sensors.barometer import (
    BAROMETER,
    BarometerErrors,
    BarometerParameters,
    GroundPressure,
    HeightDrift,
)
from drake_quad.laboratory.sensors.gauss_markov import Correlation
from drake_quad.scenario.inactive import needs
from drake_quad.scenario.plausible import PLAUSIBLE_SIZE
from drake_quad.scenario.quantities import NonNegative, Number, Position, Positive, Span, field_from_record
from drake_quad.scenario.sensors.aiding import AidingModel
from drake_quad.scenario.sensors.mounting import relative_to_centre
from drake_quad.scenario.sensors.sensor import SENSORS, SensorSettings


@SENSORS.register
class BarometerSettings(SensorSettings):
    """Barometer, which measures the height above the origin of W. 1 Pa corresponds to about 0.083 m."""

    kind: Literal["barometer"]
    position: Annotated[Position, PLAUSIBLE_SIZE] = field_from_record(
        BarometerParameters, "position", "x, y and z in B relative to the origin of `layout`, like `centre_of_mass`"
    )
    bias: Number = field_from_record(BarometerParameters, "bias", "constant error")
    height_noise: NonNegative = field_from_record(
        BarometerParameters, "height_noise", "standard deviation of a reading"
    )
    drift: NonNegative = Field(
        default=0.0, description="standard deviation of a slowly varying error, a Gauss-Markov process (m)"
    )
    drift_time: Annotated[Span, needs("drift")] = Field(default=300.0, description="correlation time of drift (s)")
    dynamic_pressure: Number = Field(
        default=0.0,
        description="pressure error at the port, relative to the dynamic pressure of the relative wind (1)",
    )
    ground_effect: NonNegative = Field(
        default=0.0, description="fall of the reading at the ground, from the pressure below the rotors (m)"
    )
    ground_effect_length: Annotated[Positive, needs("ground_effect")] = Field(
        default=0.3, description="height over which ground_effect decays by the factor e (m)"
    )
    law: ClassVar = BAROMETER
    noise: ClassVar = ("height_noise", "drift")
    aids: ClassVar = AidingModel("height", (("height_noise", "drift"),))

    def parameters(self, vehicle: Any) -> BarometerParameters:
        """Return the barometer parameters."""
        settings: Any = self
        errors = BarometerErrors(
            HeightDrift(settings.drift, Correlation.of(settings.drift_time, settings.period)),
            0.5 * settings.dynamic_pressure / vehicle.gravity,
            GroundPressure(settings.ground_effect, settings.ground_effect_length),
        )
        position = relative_to_centre(settings.position, vehicle)
        return record_like(BarometerParameters, self, position=position, errors=errors)

    def aiding_parameters(self, deviations: tuple[Any, ...]) -> HeightAiding:
        """Return the parameters of the measurement equation for the height, given its standard deviation (m)."""
        return HeightAiding(*deviations)
