"""Error-state Kalman filter in the scenario language."""

import math
from collections.abc import Iterator
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from drake_quad.estimation.covariance import InertialNoise
from drake_quad.estimation.error_state_filter import AidingParameters, ErrorStateKalmanFilter, FilterParameters
from drake_quad.framework.recipe import Recipe
from drake_quad.geometry.axes import Vector, minus
from drake_quad.scenario.distributions import Distribution, Model
from drake_quad.scenario.estimators.estimator import ESTIMATORS
from drake_quad.scenario.estimators.inertial import (
    AIDING_DESCRIPTION,
    INERTIAL_SENSORS,
    InertialEstimator,
    InitialEstimate,
    aiding_sensor,
    none_if_zero,
    path_of,
)
from drake_quad.scenario.quantities import (
    FixedAngleNoise,
    FixedNonNegative,
    FixedPositive,
    FixedSpan,
    can_differ_from_zero,
)
from drake_quad.signals import EstimateDeviation, State

# Longest time between two propagations of the covariance, s. The increments of the Jacobians over this time are small
# compared with 1 even while the vehicle tumbles.
_MAX_BLOCK_TIME = 0.02


class AidingSettings(Model):
    """Settings of the filter for a sensor that corrects the estimate."""

    deviation: FixedPositive | Annotated[tuple[FixedPositive, ...], Field(strict=False)] | None = Field(
        default=None,
        description="assumed standard deviation of the readings, in the unit of the readings: one number, or one for"
        " each component; by default, the standard deviation of the errors of the sensor without its biases",
    )
    latency: Annotated[int, Field(ge=0, le=50)] | None = Field(
        default=None, description="assumed delay of the readings, in whole periods; by default, that of the sensor"
    )
    innovation_limit: FixedPositive = Field(
        default=5.0,
        description="largest innovation that is used, as a multiple of its standard deviation (1); the default is PX4's"
        " gate size",
    )
    reset_time: FixedSpan = Field(
        default=0.5,
        description="duration of successive rejected readings after which a reading resets the measured quantity (s)",
    )


class InitialDeviation(Model):
    """Assumed standard deviations of the errors of the initial estimate on each axis."""

    position: FixedPositive = Field(default=0.1, description="position (m)")
    velocity: FixedPositive = Field(default=0.1, description="velocity (m/s)")
    attitude: FixedAngleNoise = Field(default=0.02, description="rotation about each axis (rad)")
    gyroscope_bias: FixedPositive = Field(default=0.01, description="bias of the gyroscope (rad/s)")
    accelerometer_bias: FixedPositive = Field(default=0.1, description="bias of the accelerometer (m/s²)")


@ESTIMATORS.register
class ErrorStateFilterSettings(InertialEstimator):
    """Error-state Kalman filter on board, which integrates inertial sensors and is corrected by other sensors.

    By default, the estimate begins with the true state and without biases.
    """

    kind: Literal["error_state_filter"]
    aiding: dict[str, AidingSettings] | None = Field(default=None, description=AIDING_DESCRIPTION)
    gyroscope_noise: FixedPositive | None = Field(
        default=None, description="assumed noise density (rad/s/√Hz); by default, that of the gyroscope"
    )
    accelerometer_noise: FixedPositive | None = Field(
        default=None, description="assumed noise density (m/s²/√Hz); by default, that of the accelerometer"
    )
    gyroscope_walk: FixedNonNegative | None = Field(
        default=None, description="assumed random walk of the bias (rad/s/√s); by default, that of the gyroscope"
    )
    accelerometer_walk: FixedNonNegative | None = Field(
        default=None, description="assumed random walk of the bias (m/s²/√s); by default, that of the accelerometer"
    )
    initial_deviation: InitialDeviation = InitialDeviation()
    initial_estimate: InitialEstimate = InitialEstimate()
    default_aiding: ClassVar = AidingSettings()

    def recipe(self, scenario: Any, fleet: Any, start: State) -> Recipe:
        """Return the recipe for the filters of a fleet."""
        laboratory, filter_of_fleet = fleet.laboratory, self.with_explicit_noise(fleet.laboratory)
        period = scenario.laboratory.named_sensors["gyroscope"].period
        imu = laboratory.named_sensors["accelerometer"].position
        aiding, parameters = [], []
        for name, source in self.sources(scenario.laboratory, laboratory).items():
            settings, used = source.settings, filter_of_fleet.aiding_settings(name)
            latency = settings.latency if used.latency is None else used.latency
            aiding.append(aiding_sensor(name, settings, period, int(latency)))
            place = source.fleet.mounting_position
            lever = None if place is None else none_if_zero(minus(Vector(*place), Vector(*imu)))
            parameters.append(
                AidingParameters(
                    source.fleet.aiding_parameters(_per_component(used.deviation, settings.num_components)),
                    used.innovation_limit**2,
                    max(1.0, float(round(used.reset_time / settings.period))),
                    lever,
                )
            )
        # The filter assumes that the centre of mass is the origin of the layout.
        from_centre = none_if_zero(Vector(*imu))
        deviation = self.initial_deviation
        filter_parameters = FilterParameters(
            InertialNoise(
                filter_of_fleet.gyroscope_noise,  # type: ignore[arg-type]
                filter_of_fleet.accelerometer_noise,  # type: ignore[arg-type]
                filter_of_fleet.gyroscope_walk,  # type: ignore[arg-type]
                filter_of_fleet.accelerometer_walk,  # type: ignore[arg-type]
            ),
            EstimateDeviation(
                *[deviation.position] * 3,
                *[deviation.velocity] * 3,
                *[deviation.attitude] * 3,
                *[deviation.gyroscope_bias] * 3,
                *[deviation.accelerometer_bias] * 3,
            ),
            tuple(parameters),
            self.first_estimate(fleet, start, from_centre),
            gravity=scenario.nominal.gravity,
            imu=from_centre,
        )
        structure = {
            "aiding": tuple(aiding),
            "period": period,
            "block_samples": _block_samples([each.period_samples for each in aiding], period),
        }
        return Recipe(ErrorStateKalmanFilter, structure, filter_parameters)

    def with_explicit_noise(self, laboratory: Any) -> "ErrorStateFilterSettings":
        """Return the filter with all assumptions about noise as settings, taken from the sensors where none is given.

        Args:
            laboratory: laboratory with the sensors, which may be that of a fleet.
        """
        gyroscope, accelerometer = (laboratory.named_sensors[name] for name in INERTIAL_SENSORS)
        update = {
            name: value if getattr(self, name) is None else getattr(self, name)
            for name, value in {
                "gyroscope_noise": gyroscope.noise_density,
                "accelerometer_noise": accelerometer.noise_density,
                "gyroscope_walk": gyroscope.equivalent_walk(),
                "accelerometer_walk": accelerometer.equivalent_walk(),
            }.items()
        }
        used = {}
        for name, source in self.sources(laboratory, laboratory).items():
            deviation = source.aiding.deviation
            given = source.fleet.reading_deviations() if deviation is None else deviation
            used[name] = source.aiding.model_copy(update={"deviation": given})
        return self.model_copy(update={**update, "aiding": used})

    def sensor_errors(self, laboratory: Any) -> Iterator[tuple[Any, ...]]:
        """Yield an error message and the path of a field for each problem with the sensors of a laboratory."""
        yield from super().sensor_errors(laboratory)
        for name, source in self.sources(laboratory, laboratory).items():
            settings, given = source.settings, source.aiding.deviation
            if source.aiding.latency is None and isinstance(settings.latency, Distribution):
                demand = "has a random latency; give the latency that the estimator assumes"
                yield demand, "estimator", "aiding", name
            if isinstance(given, tuple) and len(given) != settings.num_components:
                demand = f"must be one number or {settings.num_components} numbers"
                yield demand, "estimator", "aiding", name, "deviation"
            if given is None and settings.lacks_noise():
                yield (
                    f"must have noise, or laboratory.estimator.aiding.{name}.deviation must be given, since a filter"
                    " needs a positive standard deviation",
                    *path_of(name, laboratory),
                )
        for name, noise in zip(INERTIAL_SENSORS, (self.gyroscope_noise, self.accelerometer_noise), strict=True):
            if noise is None and not can_differ_from_zero(laboratory.named_sensors[name].noise_density):
                demand = f"must be positive, or laboratory.estimator.{name}_noise must be given"
                yield demand, *path_of(name, laboratory), "noise_density"


def _per_component(deviation: Any, num_components: int) -> tuple[Any, ...]:
    """Return a tuple with the standard deviation of each component, given this tuple or one number for all."""
    return deviation if isinstance(deviation, tuple) else (deviation,) * num_components


def _block_samples(samples: list[int], period: float) -> int:
    """Return the number of inertial samples between two propagations of the covariance.

    It is the largest number that divides the period of every aiding sensor and spans at most `_MAX_BLOCK_TIME`.

    Args:
        samples: number of inertial samples in a period of each aiding sensor.
        period: sampling period of the inertial sensors, s.
    """
    common = math.gcd(*samples)
    limit = max(1, int(_MAX_BLOCK_TIME / period + 1e-6))
    return max(size for size in range(1, limit + 1) if common % size == 0)
