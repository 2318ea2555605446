"""Error-state Kalman filter of the scenario language."""

import math
from collections.abc import Iterator
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import Field

from drake_quad.estimation.covariance import InertialNoise
from drake_quad.estimation.error_state_filter import Aiding, AidingParameters, ErrorStateKalmanFilter, FilterParameters
from drake_quad.estimation.estimate import Estimate
from drake_quad.framework.recipe import Recipe
from drake_quad.geometry.axes import BodyAxes, Vector, cross, minus, plus
from drake_quad.geometry.quaternion import Quaternion
from drake_quad.scenario.distributions import Distribution, Model
from drake_quad.scenario.estimators.estimator import ESTIMATORS, Estimator
from drake_quad.scenario.quantities import FixedNonNegative, FixedPositive, FixedSpan, can_differ_from_zero
from drake_quad.signals import EstimateDeviation, State

_MOTION_CAPTURE = "motion_capture"
_INERTIAL_SENSORS = "gyroscope", "accelerometer"
# Longest time between two propagations of the covariance, s. The increments of the Jacobians over this time are small
# compared with 1 even while the vehicle tumbles.
_MAX_BLOCK_TIME = 0.02


class AidingSettings(Model):
    """Use of a sensor that corrects the estimate."""

    deviation: FixedPositive | Annotated[tuple[FixedPositive, ...], Field(strict=False)] | None = Field(
        default=None,
        description="assumed standard deviation of the readings, in the unit of the readings: one number, or one for"
        " each component; by default, the standard deviation of the errors of the sensor without its biases",
    )
    latency: Annotated[int, Field(ge=0, le=50)] | None = Field(
        default=None, description="assumed delay of the readings, in whole periods; that of the sensor by default"
    )
    innovation_limit: FixedPositive = Field(
        default=5.0,
        description="largest innovation that is used, as a multiple of its standard deviation (1); the default is that"
        " of PX4's gates",
    )
    reset_time: FixedSpan = Field(
        default=0.5,
        description="time of rejected readings after which the readings reset the measured quantity (s)",
    )


class InitialDeviation(Model):
    """Assumed standard deviations of the errors of the initial estimate on each axis."""

    position: FixedPositive = Field(default=0.1, description="position (m)")
    velocity: FixedPositive = Field(default=0.1, description="velocity (m/s)")
    attitude: FixedPositive = Field(default=0.02, description="rotation about each axis (rad)")
    gyroscope_bias: FixedPositive = Field(default=0.01, description="bias of the gyroscope (rad/s)")
    accelerometer_bias: FixedPositive = Field(default=0.1, description="bias of the accelerometer (m/s²)")


class _Source(NamedTuple):
    """Aiding sensor: its settings, the same settings in the fleet, and how the filter uses it."""

    settings: Any
    fleet: Any
    aiding: AidingSettings


@ESTIMATORS.register
class ErrorStateFilterSettings(Estimator):
    """Error-state Kalman filter on board, which integrates gyroscope and accelerometer and is corrected by other sensors.

    The estimate begins with the true state and without biases.
    """

    kind: Literal["error_state_filter"]
    aiding: dict[str, AidingSettings] | None = Field(
        default=None,
        description="sensors that correct the estimate, by the names of their ports; `motion_capture` is position and"
        " attitude from the cameras. By default, all sensors on board are used, and motion capture is not",
    )
    gyroscope_noise: FixedPositive | None = Field(
        default=None, description="assumed noise density (rad/s/√Hz); that of the gyroscope by default"
    )
    accelerometer_noise: FixedPositive | None = Field(
        default=None, description="assumed noise density (m/s²/√Hz); that of the accelerometer by default"
    )
    gyroscope_walk: FixedNonNegative | None = Field(
        default=None, description="assumed random walk of the bias (rad/s/√s); that of the gyroscope by default"
    )
    accelerometer_walk: FixedNonNegative | None = Field(
        default=None, description="assumed random walk of the bias (m/s²/√s); that of the accelerometer by default"
    )
    initial_deviation: InitialDeviation = InitialDeviation()

    @property
    def reads_motion_capture(self) -> bool:
        """True if motion capture corrects the estimate."""
        return self.aiding is not None and _MOTION_CAPTURE in self.aiding

    def recipe(self, scenario: Any, fleet: Any, start: State) -> Recipe:
        """Return the recipe for the filters of a fleet."""
        laboratory, filter_of_fleet = fleet.laboratory, self.with_explicit_noise(fleet.laboratory)
        period = scenario.laboratory.named_sensors["gyroscope"].period
        imu = laboratory.named_sensors["accelerometer"].position
        aiding, parameters = [], []
        for name, source in self._sources(scenario.laboratory, laboratory).items():
            settings, used = source.settings, filter_of_fleet.used(name)
            samples = round(settings.period / period)
            latency = settings.latency if used.latency is None else used.latency
            aiding.append(Aiding(name, settings.aids.kind, samples, settings.can_miss, int(latency)))
            place = source.fleet.place
            lever = None if place is None else _unless_zero(minus(Vector(*place), Vector(*imu)))
            parameters.append(
                AidingParameters(
                    source.fleet.aiding_parameters(_for_each(used.deviation, len(source.fleet.reading_deviations()))),
                    used.innovation_limit**2,
                    max(1.0, float(round(used.reset_time / settings.period))),
                    lever,
                )
            )
        # The filter assumes that the centre of mass is the origin of the layout.
        from_centre = _unless_zero(Vector(*imu))
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
            _initial_estimate(start, from_centre),
            gravity=scenario.nominal.gravity,
            imu=from_centre,
        )
        structure = {
            "aiding": tuple(aiding),
            "period": period,
            "block_samples": _block_samples([each.samples for each in aiding], period),
        }
        return Recipe(ErrorStateKalmanFilter, structure, filter_parameters)

    def with_explicit_noise(self, laboratory: Any) -> "ErrorStateFilterSettings":
        """Return the filter with explicit assumptions about noise; the laboratory may be that of a fleet."""
        gyroscope, accelerometer = (laboratory.named_sensors[name] for name in _INERTIAL_SENSORS)
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
        for name, source in self._sources(laboratory, laboratory).items():
            deviation = source.aiding.deviation
            given = source.fleet.reading_deviations() if deviation is None else deviation
            used[name] = source.aiding.model_copy(update={"deviation": given})
        return self.model_copy(update={**update, "aiding": used})

    def names_of_sensors(self, laboratory: Any) -> list[str]:
        """Return the names of the inertial and aiding sensors."""
        return [*_INERTIAL_SENSORS, *self._sources(laboratory, laboratory)]

    def used(self, name: str) -> AidingSettings:
        """Return the settings of an aiding sensor."""
        return AidingSettings() if self.aiding is None else self.aiding[name]

    def _sources(self, laboratory: Any, fleet: Any) -> dict[str, _Source]:
        """Return the aiding sensors by name, given the laboratory of a scenario and that of its fleet."""
        cameras = {_MOTION_CAPTURE: (laboratory.motion_capture, fleet.motion_capture)}
        sensors, drawn = laboratory.named_sensors, fleet.named_sensors
        every = cameras | {name: (sensors[name], drawn[name]) for name in sensors}
        names = [*self.aiding] if self.aiding is not None else [name for name in sensors if sensors[name].aids]
        return {name: _Source(*every[name], self.used(name)) for name in names}

    def check_fits(self, scenario: Any) -> None:
        """Raise a validation error if a sensor is missing, or if the filter cannot use it."""
        for demand, *path in self._flaws(scenario.laboratory):
            raise scenario.field_error(demand, "laboratory", *path)

    def _flaws(self, laboratory: Any) -> Iterator[tuple[Any, ...]]:
        """Yield what is wrong with the sensors of a laboratory, as a demand and the path of the field."""
        sensors = laboratory.named_sensors
        for name in _INERTIAL_SENSORS:
            if name not in sensors:
                yield f"must contain a sensor of kind {name}, which the estimator integrates", "sensors"
        gyroscope, accelerometer = (sensors[name] for name in _INERTIAL_SENSORS)
        places = {name: i for i, name in enumerate(sensors)}
        if accelerometer.period != gyroscope.period:
            yield (
                f"must be the period of the gyroscope, {gyroscope.period:g}",
                *("sensors", places["accelerometer"], "period"),
            )
        for name in _INERTIAL_SENSORS:
            if sensors[name].latency_samples:
                yield "must be 0, since the estimator integrates this sensor", "sensors", places[name], "latency_samples"
        for name in self.aiding or {}:
            if name != _MOTION_CAPTURE and (name not in sensors or not sensors[name].aids):
                able = [each for each, sensor in sensors.items() if sensor.aids]
                yield (
                    f"is not a sensor that corrects an estimate; those are {', '.join([_MOTION_CAPTURE, *able])}",
                    *("estimator", "aiding", name),
                )
        sources = self._sources(laboratory, laboratory)
        if not sources:
            yield "must contain a sensor that corrects the estimate, such as gnss", "sensors"
        for name, source in sources.items():
            field = (_MOTION_CAPTURE,) if name == _MOTION_CAPTURE else ("sensors", places[name])
            ratio = source.settings.period / gyroscope.period
            if abs(ratio - round(ratio)) > 1e-6 or ratio < 0.5:
                yield f"must be a multiple of the gyroscope's period, {gyroscope.period:g}", *field, "period"
            if source.aiding.latency is None and isinstance(source.settings.latency, Distribution):
                demand = "has a random latency; give the latency that the estimator assumes"
                yield demand, "estimator", "aiding", name
            given = source.aiding.deviation
            if isinstance(given, tuple) and len(given) != (number := len(source.settings.reading_deviations())):
                yield f"must be one number or {number} numbers", "estimator", "aiding", name, "deviation"
            if given is None and source.settings.lacks_noise():
                yield (
                    f"must have noise, or laboratory.estimator.aiding.{name}.deviation must be given: a filter needs a"
                    " positive standard deviation",
                    *field,
                )
        for name, noise in zip(_INERTIAL_SENSORS, (self.gyroscope_noise, self.accelerometer_noise), strict=True):
            if noise is None and not can_differ_from_zero(sensors[name].noise_density):
                yield (
                    f"must be positive, or laboratory.estimator.{name}_noise must be given",
                    *("sensors", places[name], "noise_density"),
                )


def _for_each(deviation: Any, num_components: int) -> tuple[Any, ...]:
    """Return the standard deviation of each component, given one for all or one for each."""
    return deviation if isinstance(deviation, tuple) else (deviation,) * num_components


def _unless_zero(offset: Vector) -> Vector | None:
    """Return an offset, which may contain (N,) arrays; None if it is zero for all vehicles."""
    return offset if any(np.any(np.not_equal(each, 0.0)) for each in offset) else None


def _block_samples(samples: list[int], period: float) -> int:
    """Return the largest number of samples in a block that divides all periods and is not too long."""
    common = math.gcd(*samples)
    limit = max(1, int(_MAX_BLOCK_TIME / period + 1e-6))
    return max(size for size in range(1, limit + 1) if common % size == 0)


def _initial_estimate(start: State, imu: Vector | None) -> Estimate:
    """Return the estimate of the inertial measurement unit without biases, given the state of the vehicle."""
    axes = BodyAxes.of(start.roll, start.pitch, start.yaw)
    position, velocity = Vector(start.x, start.y, start.z), Vector(start.v_x, start.v_y, start.v_z)
    if imu is not None:
        position = plus(position, axes.in_world(imu))
        velocity = plus(velocity, axes.in_world(cross(Vector(start.p, start.q, start.r), imu)))
    zero = Vector(0.0, 0.0, 0.0)
    return Estimate(position, velocity, Quaternion.of(start.roll, start.pitch, start.yaw), zero, zero)
