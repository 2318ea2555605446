"""Complementary filter on board: inertial navigation with fixed gains.

Between the samples of an inertial measurement unit, the attitude follows the gyroscope, and the velocity follows the
accelerometer (R. Mahony, T. Hamel, J.-M. Pflimlin, "Nonlinear complementary filters on the special orthogonal group",
IEEE Transactions on Automatic Control 53, 2008, section IV):

    ω̂ = ω - b + e / T_t,    b' = - e / (T_t T_b),    e = (a / |a|) × (R^T e_z)

with the reading ω of the gyroscope and the reading a of the accelerometer. The filter assumes that a points upwards.
This is true only on average, because the accelerometer of a quadrotor measures the thrust and the drag.

A reading of another sensor corrects the measured quantity by a fixed fraction of the innovation. For a velocity or a
rotation, the fraction is 1 - θ with θ = exp(-Δt / T), the period Δt of the readings and the time constant T. A position
also corrects the velocity, as in a critically damped g-h filter with g = 1 - θ² and h = (1 - θ)². The filter ignores
the latencies of sensors and their positions on the vehicle.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

from drake_quad.estimation.corrections import AidingLaw, attitude_from_accelerometer
from drake_quad.estimation.covariance import ScalarMeasurement, shortest_change
from drake_quad.estimation.error_state_filter import Aiding, check_aiding, if_needed, next_wait
from drake_quad.estimation.estimate import (
    NO_INCREMENT,
    ErrorState,
    Estimate,
    add_error,
    extend_increment,
    predict,
    state_of,
)
from drake_quad.framework.elementary import exp
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.framework.records import layout_of
from drake_quad.geometry.axes import Vector, cross, length, minus, plus, times
from drake_quad.geometry.quaternion import NO_ROTATION
from drake_quad.signals import Angle, BodyRates, Number, Quantity, Row, Valid, valid_signal

_Time = Annotated[Row, Quantity("s", sign="positive")]
_ZERO = Vector(0.0, 0.0, 0.0)


class TimeConstants(NamedTuple):
    """Time constants with which the estimate follows the readings.

    Attributes:
        tilt: time constant T_t with which roll and pitch follow the accelerometer.
        bias: time constant T_b with which the estimated bias of the gyroscope follows the error of the tilt.
        rotation: time constant of corrections by a measured attitude, yaw or heading.
        velocity: time constant of corrections by a measured velocity.
        position: time constant of corrections by a measured position, which change position and velocity.
    """

    tilt: _Time
    bias: _Time
    rotation: _Time
    velocity: _Time
    position: _Time


class ComplementaryParameters(NamedTuple):
    """Parameters of a complementary filter.

    Attributes:
        times: time constants.
        aiding: parameters of the measurement equations of the aiding sensors. Standard deviations are not used.
        start: initial estimate; None for a vehicle that is at rest at the origin with an unknown tilt.
        initial_yaw: yaw of the initial estimate if `start` is None.
        gravity: gravitational acceleration.
    """

    times: TimeConstants
    aiding: tuple[Any, ...]
    start: Estimate | None = None
    initial_yaw: Angle = 0.0
    gravity: Annotated[Row, Quantity("m/s²", sign="positive")] = 9.81


class ComplementaryCounters(NamedTuple):
    """Counters of a complementary filter.

    Attributes:
        waits_for_start: 1 before the first sample, then 0.
        samples_to_reading: for each aiding sensor, the number of samples until its next reading.
    """

    waits_for_start: Number
    samples_to_reading: tuple[Number, ...]


def correct_estimate(
    estimate: Estimate, measurements: Sequence[ScalarMeasurement], times_of_filter: TimeConstants, period: float
) -> Estimate:
    """Return an estimate after corrections by scalar measurements.

    Args:
        estimate: estimate at the time of the measurements.
        measurements: scalar measurements. Each corrects the part of the estimate that its field `reset` names. A
            measurement that corrects the position also corrects the velocity.
        times_of_filter: time constants.
        period: time between the measurements, s.
    """
    error = ErrorState(_ZERO, _ZERO, _ZERO, _ZERO, _ZERO)
    for innovation, derivatives, _, changed in measurements:
        decay = exp(-period / getattr(times_of_filter, changed))
        direction = shortest_change(getattr(derivatives, changed))
        change = Vector._make(0.0 if each is None else innovation * each for each in direction)
        if changed == "position":
            rate = (1.0 - decay) * (1.0 - decay) / period
            error = error._replace(
                position=plus(error.position, times(1.0 - decay * decay, change)),
                velocity=plus(error.velocity, times(rate, change)),
            )
        else:
            error = error._replace(**{changed: plus(getattr(error, changed), times(1.0 - decay, change))})
    return add_error(estimate, error)


@dataclass(frozen=True)
class _Correction:
    """Function that corrects an estimate by a reading.

    Attributes:
        law: measurement equation.
        period: time between readings, s.
    """

    law: AidingLaw
    period: float

    def __call__(
        self, estimate: Estimate, reading: Any, aiding: Any, times_of_filter: TimeConstants, gyroscope: BodyRates
    ) -> Estimate:
        measurements = self.law.formula(estimate, reading, aiding, gyroscope)
        return correct_estimate(estimate, measurements, times_of_filter, self.period)


@dataclass(frozen=True)
class _Step:
    """Function that updates the state of a complementary filter with a sample of the inertial measurement unit.

    Attributes:
        aiding: aiding sensors.
        period: sampling period of the inertial measurement unit, s.
    """

    aiding: tuple[Aiding, ...]
    period: float

    def __call__(
        self,
        estimate: Estimate,
        counters: ComplementaryCounters,
        parameters: ComplementaryParameters,
        gyroscope: BodyRates,
        accelerometer: Vector,
        *readings: Any,
    ) -> tuple[Estimate, ComplementaryCounters]:
        if parameters.start is None:
            starts = counters.waits_for_start > 0.5
            attitude = if_needed(
                starts, attitude_from_accelerometer, (accelerometer, parameters.initial_yaw), estimate.attitude
            )
            estimate = estimate._replace(attitude=attitude)
        waits = counters.samples_to_reading
        for each, aiding, reading, valid, wait in zip(
            self.aiding, parameters.aiding, readings[0::2], readings[1::2], waits, strict=True
        ):
            is_new = wait < 0.5 if valid is None else (wait < 0.5) & (valid.valid > 0.5)
            correction = _Correction(each.law, each.period_samples * self.period)
            estimate = if_needed(is_new, correction, (estimate, reading, aiding, parameters.times, gyroscope), estimate)
        axes = estimate.attitude.axes()
        up, vertical = times(1.0 / length(accelerometer), accelerometer), Vector(axes.x.z, axes.y.z, axes.z.z)
        tilt = times(1.0 / parameters.times.tilt, cross(up, vertical))
        increment = NO_INCREMENT._replace(gyroscope_bias=minus(estimate.gyroscope_bias, tilt))
        increment = extend_increment(increment, gyroscope, accelerometer, self.period)
        bias = minus(estimate.gyroscope_bias, times(self.period / parameters.times.bias, tilt))
        estimate = predict(estimate, increment, parameters.gravity)._replace(gyroscope_bias=bias)
        following = tuple(map(next_wait, waits, [each.period_samples for each in self.aiding]))
        return estimate, ComplementaryCounters(0.0, following)


@fleet_system(float, AutoDiffXd)
class ComplementaryFilter(FleetSystem):
    """Complementary filter for the state of the vehicle and the bias of its gyroscope, with fixed gains.

    .. pydrake_system::

        name: ComplementaryFilter
        input_ports:
        - gyroscope
        - accelerometer
        - position
        - position_valid
        output_ports:
        - measurement

    The filter reads its ports at the same times as an `ErrorStateKalmanFilter`, and starts in the same way. The diagram
    shows the ports of a filter with the aiding sensor `position`, whose readings can be missing.

    Args:
        num_vehicles: number of vehicles N.
        aiding: aiding sensors; their latencies are ignored.
        period: sampling period of the inertial measurement unit, s.
        parameters: parameters of the filter.

    Raises:
        ValueError: if parameters belong to another sensor.
    """

    def declare(self, *, aiding: tuple[Aiding, ...], period: float, parameters: ComplementaryParameters) -> None:
        """Declare the ports, states and parameters of this system."""
        check_aiding(aiding, 1, parameters.aiding)
        gyroscope = self.input("gyroscope", layout=layout_of(BodyRates))
        accelerometer = self.input("accelerometer", layout=layout_of(Vector))
        readings: list[Any] = []
        for each in aiding:
            readings.append(self.input(each.name, layout=layout_of(each.law.reading)))
            valid = self.input(valid_signal(each.name), layout=layout_of(Valid)) if each.can_miss else None
            readings.append(valid)
        parameter = self.parameter("parameters", lambda parameters: parameters)
        estimate = self.state("estimate", _initial_estimate)
        counters = ComplementaryCounters(1.0, (0.0,) * len(aiding))
        groups = estimate, self.state("counters", lambda _: counters, is_scheduled=True)
        step = _Step(tuple(aiding), period)
        self.update(
            period, step, *groups, parameter, gyroscope, accelerometer, *readings, writes=groups, at_start=False
        )
        self.output("measurement", state_of, estimate, gyroscope)


def _initial_estimate(parameters: ComplementaryParameters) -> Estimate:
    return Estimate(_ZERO, _ZERO, NO_ROTATION, _ZERO, _ZERO) if parameters.start is None else parameters.start
