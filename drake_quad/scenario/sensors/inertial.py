"""Base class of the settings of gyroscopes and accelerometers."""

import math
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field

from drake_quad.geometry.axes import BodyAxes, Vector
from drake_quad.laboratory.sensors.gauss_markov import Correlation
from drake_quad.laboratory.sensors.inertial import BiasInstability, InertialErrors, LowPass, WarmUp, walk_step
from drake_quad.laboratory.sensors.vibration import Vibration
from drake_quad.scenario.inactive import needs
from drake_quad.scenario.plausible import PLAUSIBLE_RELATIVE_ERROR, not_in_degrees
from drake_quad.scenario.quantities import Misalignment, NonNegative, Positive, RelativeError, Span
from drake_quad.scenario.sensors.sensor import SensorSettings
from drake_quad.scenario.sensors.vibration import VibrationSettings

# Circuit boards are misaligned by at most a few degrees. The limit of 0.35 rad corresponds to 20°.
_PLAUSIBLE_MISALIGNMENT = not_in_degrees(upper=0.35)
NO_ERROR = (0.0, 0.0, 0.0)


class InertialSettings(SensorSettings):
    """Settings that gyroscopes and accelerometers have in common."""

    scale_error: Annotated[
        tuple[RelativeError, RelativeError, RelativeError], Field(strict=False), PLAUSIBLE_RELATIVE_ERROR
    ] = Field(default=NO_ERROR, description="relative scale error along x, y and z (1)")
    misalignment: Annotated[Misalignment, _PLAUSIBLE_MISALIGNMENT] = Field(
        default=NO_ERROR, description="roll, pitch and yaw of the axes of the sensor in B (rad)"
    )
    bandwidth: Positive | None = Field(
        default=None, description="bandwidth of a first-order low-pass filter (rad/s); no filter if not given"
    )
    bias_time: Annotated[Span, needs("bias_instability")] = Field(
        default=100.0, description="correlation time of bias_instability (s)"
    )
    warm_up_rise: Annotated[NonNegative, needs("temperature_coefficient")] = Field(
        default=0.0, description="rise of the temperature during the warm-up (K)"
    )
    warm_up_time: Annotated[Span, needs("warm_up_rise")] = Field(
        default=60.0, description="duration of the warm-up, which begins at time 0; the temperature rises linearly (s)"
    )
    vibration: VibrationSettings | None = Field(default=None, description="vibration of the rotors; none if not given")
    noise: ClassVar = ("noise_density", "bias_instability", "bias_random_walk")
    nonlinear: ClassVar = {
        "resolution": 0.0,
        "full_scale": None,
        "vibration": None,
        "temperature_coefficient": NO_ERROR,
    }

    def inertial_errors(self, vibration: Vibration | None) -> InertialErrors:
        """Return the errors of the sensor, given its vibration."""
        settings: Any = self
        correlation = Correlation.of(settings.bias_time, settings.period)
        coefficients = (coefficient * settings.warm_up_rise for coefficient in settings.temperature_coefficient)
        return InertialErrors(
            scale_error=Vector(*settings.scale_error),
            misalignment=BodyAxes.of(*settings.misalignment),
            bandwidth=None if settings.bandwidth is None else LowPass.of(settings.bandwidth, settings.period),
            bias_instability=BiasInstability(settings.bias_instability, correlation),
            bias_random_walk=walk_step(settings.bias_random_walk, settings.period),
            temperature_coefficient=WarmUp(Vector._make(coefficients), settings.period / settings.warm_up_time),
            vibration=vibration,
            full_scale=settings.full_scale,
            resolution=settings.resolution,
        )

    def equivalent_walk(self) -> Any:
        """Return a random walk that approximates random walk and bias instability together over short times."""
        settings: Any = self
        return np.hypot(settings.bias_random_walk, settings.bias_instability * np.sqrt(2.0 / settings.bias_time))

    def white_noise(self) -> Any:
        """Return the standard deviation of the white noise of a reading, which follows from the noise density."""
        settings: Any = self
        return settings.noise_density / math.sqrt(settings.period)


def density_field(unit: str) -> Any:
    """Return the field `noise_density` of a sensor, given the unit of its readings."""
    return Field(
        default=0.0,
        description=f"noise density on each axis ({unit}/√Hz); the standard deviation of a reading is this number over"
        " the square root of the period",
    )


def instability_field(unit: str) -> Any:
    """Return the field `bias_instability` of a sensor, given the unit of its readings."""
    return Field(
        default=0.0,
        description=f"standard deviation of a slowly varying bias on each axis, a Gauss-Markov process ({unit})",
    )


def walk_field(unit: str) -> Any:
    """Return the field `bias_random_walk` of a sensor, given the unit of its readings."""
    return Field(
        default=0.0,
        description=f"random walk of the bias on each axis ({unit}/√s); its standard deviation after a time t is this"
        " number times √t",
    )


def temperature_field(unit: str) -> Any:
    """Return the field `temperature_coefficient` of a sensor, given the unit of its readings."""
    return Field(default=NO_ERROR, description=f"change of the bias along x, y and z with the temperature ({unit}/K)")


def full_scale_field(unit: str) -> Any:
    """Return the field `full_scale` of a sensor, given the unit of its readings."""
    return Field(
        default=None, description=f"largest magnitude of a reading on each axis ({unit}); no limit if not given"
    )


def resolution_field(unit: str) -> Any:
    """Return the field `resolution` of a sensor, given the unit of its readings."""
    return Field(default=0.0, description=f"step between neighbouring readings ({unit}); 0 for exact readings")
