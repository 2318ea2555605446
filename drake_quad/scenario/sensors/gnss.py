"""Satellite navigation in the scenario language."""

from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from drake_quad.estimation.corrections import FixAiding, PositionAiding, VelocityAiding
from drake_quad.framework.records import record_like
from drake_quad.laboratory.sensors.gauss_markov import Correlation
from drake_quad.laboratory.sensors.gnss import (
    GNSS,
    GnssErrors,
    GnssParameters,
    Multipath,
    PositionDeviation,
    PositionDrift,
)
from drake_quad.scenario.inactive import needs
from drake_quad.scenario.plausible import PLAUSIBLE_SIZE
from drake_quad.scenario.quantities import NonNegative, Position, Span, field_from_record
from drake_quad.scenario.sensors.aiding import AidingModel
from drake_quad.scenario.sensors.mounting import relative_to_centre
from drake_quad.scenario.sensors.sensor import SENSORS, SensorSettings

_PerAxis = Annotated[tuple[NonNegative, NonNegative, NonNegative], Field(strict=False)]


@SENSORS.register
class GnssSettings(SensorSettings):
    """Satellite navigation, which measures the position and the velocity of the antenna in W."""

    kind: Literal["gnss"]
    position: Annotated[Position, PLAUSIBLE_SIZE] = field_from_record(
        GnssParameters, "position", "x, y and z of the antenna in B relative to the origin of `layout`"
    )
    position_noise: _PerAxis = field_from_record(
        GnssParameters, "position_noise", "standard deviation of the white noise of the position along X, Y, Z"
    )
    velocity_noise: _PerAxis = field_from_record(
        GnssParameters, "velocity_noise", "standard deviation of the white noise of the velocity along X, Y, Z"
    )
    position_drift: _PerAxis = Field(
        default=(0.0, 0.0, 0.0),
        description="standard deviation of a slowly varying error of the position along X, Y, Z, a Gauss-Markov process"
        " (m)",
    )
    drift_time: Annotated[Span, needs("position_drift")] = Field(
        default=100.0, description="correlation time of position_drift (s)"
    )
    multipath: _PerAxis = Field(
        default=(0.0, 0.0, 0.0),
        description="standard deviation of an error of the position along X, Y, Z that jumps, from reflections (m)",
    )
    multipath_time: Annotated[Span, needs("multipath")] = Field(default=10.0, description="mean time between jumps (s)")
    law: ClassVar = GNSS
    nonlinear: ClassVar = {"multipath": (0.0, 0.0, 0.0)}
    noise: ClassVar = ("position_noise", "velocity_noise", "position_drift", "multipath")
    aids: ClassVar = AidingModel("fix", (("position_noise", "position_drift", "multipath"), ("velocity_noise",)))

    def parameters(self, vehicle: Any) -> GnssParameters:
        """Return the parameters of satellite navigation."""
        settings: Any = self
        correlation = Correlation.of(settings.drift_time, settings.period)
        errors = GnssErrors(
            PositionDrift(PositionDeviation(*settings.position_drift), correlation),
            Multipath.of(PositionDeviation(*settings.multipath), settings.multipath_time, settings.period),
        )
        position = relative_to_centre(settings.position, vehicle)
        return record_like(GnssParameters, self, position=position, errors=errors)

    def aiding_parameters(self, deviations: tuple[Any, ...]) -> FixAiding:
        """Return the parameters of the measurement equation for position and velocity.

        Args:
            deviations: standard deviations of the three coordinates (m) and of the three velocities (m/s).
        """
        return FixAiding(PositionAiding(*deviations[:3]), VelocityAiding(*deviations[3:]))
