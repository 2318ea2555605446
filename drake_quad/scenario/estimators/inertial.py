"""Base class of estimators on board, which integrate gyroscope and accelerometer."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, NamedTuple

import numpy as np
from pydantic import Field

from drake_quad.estimation.error_state_filter import Aiding
from drake_quad.estimation.estimate import ErrorState, Estimate, add_error
from drake_quad.geometry.axes import BodyAxes, Vector, cross, plus
from drake_quad.geometry.quaternion import Quaternion
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.estimators.estimator import Estimator
from drake_quad.scenario.quantities import Direction, Position
from drake_quad.signals import State

MOTION_CAPTURE = "motion_capture"
INERTIAL_SENSORS = "gyroscope", "accelerometer"
AIDING_DESCRIPTION = (
    "sensors that correct the estimate, by the names of their ports; `motion_capture` is position and attitude from the"
    " cameras. By default, all sensors on board are used, and motion capture is not"
)


class InitialEstimate(Model):
    """Initial estimate. By default, it is the true state, and the sensors are assumed to have no biases."""

    position_error: Position = Field(
        default=(0.0, 0.0, 0.0), description="estimated minus true position along X, Y and Z of W (m)"
    )
    velocity_error: Position = Field(
        default=(0.0, 0.0, 0.0), description="estimated minus true velocity along X, Y and Z of W (m/s)"
    )
    rotation_error: Annotated[tuple[Direction, Direction, Direction], Field(strict=False)] = Field(
        default=(0.0, 0.0, 0.0),
        description="rotation vector from the true to the estimated attitude along X, Y and Z of W (rad)",
    )
    gyroscope_bias: Position = Field(
        default=(0.0, 0.0, 0.0), description="estimated bias of the gyroscope along the axes of B (rad/s)"
    )
    accelerometer_bias: Position = Field(
        default=(0.0, 0.0, 0.0), description="estimated bias of the accelerometer along the axes of B (m/s²)"
    )

    def of(self, exact: Estimate) -> Estimate:
        """Return the initial estimate, given the exact estimate without biases."""
        vectors = [getattr(self, name) for name in InitialEstimate.model_fields]
        if not np.any([np.any(np.not_equal(each, 0.0)) for vector in vectors for each in vector]):
            return exact
        return add_error(exact, ErrorState(*[Vector(*vector) for vector in vectors]))


class AidingSource(NamedTuple):
    """Aiding sensor of an estimator.

    Attributes:
        settings: settings of the sensor in the scenario.
        fleet: the same settings in `Batch.fleet_scenario`, in which random fields are arrays.
        aiding: settings of the estimator for this sensor.
    """

    settings: Any
    fleet: Any
    aiding: Any


class InertialEstimator(Estimator):
    """Estimator on board, which integrates gyroscope and accelerometer and is corrected by other sensors.

    Attributes:
        aiding: settings of the estimator for each sensor that corrects the estimate, by port name; None to use all
            sensors on board with `default_aiding`.
        default_aiding: default settings of the estimator for a sensor.
        initial_estimate: estimate at time 0.
    """

    integrates_sensors: ClassVar = True
    default_aiding: ClassVar[Model]
    if TYPE_CHECKING:  # at runtime, these annotations would change the order of the fields of subclasses
        aiding: dict[str, Any] | None
        initial_estimate: InitialEstimate

    @property
    def reads_motion_capture(self) -> bool:
        """True if motion capture corrects the estimate."""
        return self.aiding is not None and MOTION_CAPTURE in self.aiding

    def names_of_sensors(self, laboratory: Any) -> list[str]:
        """Return the names of the inertial and aiding sensors."""
        return [*INERTIAL_SENSORS, *self.sources(laboratory, laboratory)]

    def aiding_settings(self, name: str) -> Any:
        """Return the settings of the estimator for an aiding sensor."""
        return self.default_aiding if self.aiding is None else self.aiding[name]

    def sources(self, laboratory: Any, fleet: Any) -> dict[str, AidingSource]:
        """Return the aiding sensors by name, given the laboratory of a scenario and that of its fleet."""
        cameras = {MOTION_CAPTURE: (laboratory.motion_capture, fleet.motion_capture)}
        sensors, drawn = laboratory.named_sensors, fleet.named_sensors
        every = cameras | {name: (sensors[name], drawn[name]) for name in sensors}
        names = [*self.aiding] if self.aiding is not None else [name for name in sensors if sensors[name].aids]
        return {name: AidingSource(every[name][0], every[name][1], self.aiding_settings(name)) for name in names}

    def first_estimate(self, fleet: Any, start: State, imu: Vector | None = None) -> Estimate:
        """Return the initial estimate of a fleet's filters.

        Args:
            fleet: scenario of the fleet.
            start: true state of the vehicles at time 0.
            imu: position of the inertial sensors relative to the centre of mass, m; None if they are there.
        """
        initial: InitialEstimate = fleet.laboratory.estimator.initial_estimate
        return initial.of(exact_estimate(start, imu))

    def in_hover(self) -> "InertialEstimator":
        """Return the estimator with an exact initial estimate."""
        return self.model_copy(update={"initial_estimate": InitialEstimate()})

    def check_fits(self, scenario: Any) -> None:
        """Raise a validation error if a sensor is missing, or if the estimator cannot use it."""
        for demand, *path in self.sensor_errors(scenario.laboratory):
            raise scenario.field_error(demand, "laboratory", *path)

    def sensor_errors(self, laboratory: Any) -> Iterator[tuple[Any, ...]]:
        """Yield an error message and the path of a field for each problem with the sensors of a laboratory.

        The caller must stop at the first problem, since each check relies on the earlier ones.
        """
        sensors = laboratory.named_sensors
        for name in INERTIAL_SENSORS:
            if name not in sensors:
                yield f"must contain a sensor of kind {name}, which the estimator integrates", "sensors"
        gyroscope, accelerometer = (sensors[name] for name in INERTIAL_SENSORS)
        if accelerometer.period != gyroscope.period:
            demand = f"must be the period of the gyroscope, {gyroscope.period:g}"
            yield demand, *path_of("accelerometer", laboratory), "period"
        for name in INERTIAL_SENSORS:
            if sensors[name].latency_samples:
                demand = "must be 0, since the estimator integrates this sensor"
                yield demand, *path_of(name, laboratory), "latency_samples"
        for name in self.aiding or {}:
            if name != MOTION_CAPTURE and (name not in sensors or not sensors[name].aids):
                able = [each for each, sensor in sensors.items() if sensor.aids]
                yield (
                    f"must not contain {name}, which is not a sensor that corrects an estimate; those are"
                    f" {', '.join([MOTION_CAPTURE, *able])}",
                    *("estimator", "aiding"),
                )
        sources = self.sources(laboratory, laboratory)
        if not sources:
            yield (
                "must contain a sensor that corrects the estimate, such as gnss, or laboratory.estimator.aiding must"
                " contain motion_capture",
                "sensors",
            )
        for name, source in sources.items():
            ratio = source.settings.period / gyroscope.period
            if abs(ratio - round(ratio)) > 1e-6 or ratio < 0.5:
                demand = f"must be a multiple of the gyroscope's period, {gyroscope.period:g}"
                yield demand, *path_of(name, laboratory), "period"


def path_of(name: str, laboratory: Any) -> tuple[str | int, ...]:
    """Return the path of a sensor's settings within a laboratory."""
    if name == MOTION_CAPTURE:
        return (MOTION_CAPTURE,)
    return "sensors", [*laboratory.named_sensors].index(name)


def aiding_sensor(name: str, settings: Any, period: float, latency: int = 0) -> Aiding:
    """Return the structure of an aiding sensor.

    Args:
        name: name of the sensor.
        settings: settings of the sensor in the scenario.
        period: sampling period of the inertial sensors, s.
        latency: assumed latency, in periods of the sensor.
    """
    return Aiding(name, settings.aids.kind, round(settings.period / period), settings.can_miss, latency)


def none_if_zero(offset: Vector) -> Vector | None:
    """Return an offset, which may contain (N,) arrays; None if it is zero for all vehicles."""
    return offset if any(np.any(np.not_equal(each, 0.0)) for each in offset) else None


def exact_estimate(start: State, imu: Vector | None = None) -> Estimate:
    """Return the estimate that equals the true state at the inertial measurement unit, with zero biases.

    Args:
        start: state of the vehicle.
        imu: position of the unit relative to the centre of mass, m; None if it is at the centre of mass.
    """
    axes = BodyAxes.of(start.roll, start.pitch, start.yaw)
    position, velocity = Vector(start.x, start.y, start.z), Vector(start.v_x, start.v_y, start.v_z)
    if imu is not None:
        position = plus(position, axes.in_world(imu))
        velocity = plus(velocity, axes.in_world(cross(Vector(start.p, start.q, start.r), imu)))
    zero = Vector(0.0, 0.0, 0.0)
    return Estimate(position, velocity, Quaternion.of(start.roll, start.pitch, start.yaw), zero, zero)
