"""Error-state Kalman filter on board: inertial navigation, corrected by readings of other sensors."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

from drake_quad.estimation.corrections import AIDING_LAWS, AidingLaw, levelled
from drake_quad.estimation.covariance import Covariance, InertialNoise, corrected_error, propagated
from drake_quad.estimation.estimate import NO_MOTION, Estimate, Motion, predicted, state_of, with_error
from drake_quad.framework.elementary import identity, minimum, total, where, where_needed
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.framework.records import layout_of, rows_layout
from drake_quad.geometry.axes import Vector
from drake_quad.geometry.quaternion import NO_ROTATION
from drake_quad.signals import Angle, BodyRates, EstimateDeviation, Number, Quantity, Row, Valid, valid_signal


class Aiding(NamedTuple):
    """Aiding sensor of a filter.

    Attributes:
        name: name of the input port with the readings.
        kind: type of the readings, a name in `AIDING_LAWS`.
        samples: period of the readings, a whole number of samples of the inertial measurement unit.
        can_miss: True if readings can be missing; the filter then has an input port for the validity of the readings.
    """

    name: str
    kind: str
    samples: int = 1
    can_miss: bool = False

    @property
    def law(self) -> AidingLaw:
        """Measurement equation."""
        return AIDING_LAWS[self.kind]


class AidingParameters(NamedTuple):
    """Parameters of an aiding sensor.

    Attributes:
        sensor: parameters of the measurement equation, such as a `PositionAiding`.
        innovation_limit: largest squared normalised innovation of a scalar measurement that is used.
        max_rejections: number of successive readings with a rejected measurement, after which readings reset the
            measured quantity until they obey the limit again. Without this number, a filter with a wrong estimate and
            a small covariance would reject all readings.
    """

    sensor: Any
    innovation_limit: Annotated[Row, Quantity("1", sign="positive")]
    max_rejections: Annotated[Row, Quantity("1", sign="nonnegative")] = 10.0


class FilterParameters(NamedTuple):
    """Parameters of an error-state Kalman filter.

    Attributes:
        noise: noise of the inertial measurement unit.
        initial: standard deviations of the errors of the initial estimate.
        aiding: parameters of the aiding sensors, in the order of the structure.
        initial_yaw: yaw of the initial estimate.
        gravity: gravitational acceleration.
    """

    noise: InertialNoise
    initial: EstimateDeviation
    aiding: tuple[AidingParameters, ...]
    initial_yaw: Angle = 0.0
    gravity: Annotated[Row, Quantity("m/s²", sign="positive")] = 9.81


class Counters(NamedTuple):
    """Counters of a filter.

    Attributes:
        waits_for_start: 1 before the first sample, then 0.
        samples_to_propagation: samples until the next propagation of the covariance.
        samples_to_reading: samples until the next reading of each aiding sensor.
        rejections: number of successive readings of each aiding sensor with a rejected measurement, at most
            `max_rejections`; this is also the value before the first reading.
    """

    waits_for_start: Number
    samples_to_propagation: Number
    samples_to_reading: tuple[Number, ...]
    rejections: tuple[Number, ...]


class Memory(NamedTuple):
    """State of a filter.

    Attributes:
        estimate: estimate at the current time.
        covariance: covariance of its errors, without the motion since the last propagation.
        motion: motion since the last propagation of the covariance.
        counters: counters of samples.
        innovation: latest normalised innovations of each scalar measurement.
    """

    estimate: Estimate
    covariance: Covariance
    motion: Motion
    counters: Counters
    innovation: tuple[Number, ...]


class FilterStructure(NamedTuple):
    """Structure of a filter.

    Attributes:
        aiding: aiding sensors.
        period: sampling period of the inertial measurement unit, s.
        propagation_samples: number of samples between propagations of the covariance.
    """

    aiding: tuple[Aiding, ...]
    period: float
    propagation_samples: int


def initial_memory(parameters: FilterParameters, num_scalars: int) -> Memory:
    """Return the state of a filter before its first sample.

    Args:
        parameters: parameters of the filter.
        num_scalars: number of scalar measurements of all aiding sensors.
    """
    zero, zeros = Vector(0.0, 0.0, 0.0), (0.0,) * len(parameters.aiding)
    return Memory(
        Estimate(zero, zero, NO_ROTATION, zero, zero),
        Covariance.diagonal(parameters.initial),
        NO_MOTION,
        Counters(1.0, 0.0, zeros, tuple([each.max_rejections for each in parameters.aiding])),
        (0.0,) * num_scalars,
    )


def filter_step(
    structure: FilterStructure,
    estimate: Estimate,
    covariance: Covariance,
    motion: Motion,
    counters: Counters,
    innovation: tuple[Number, ...],
    parameters: FilterParameters,
    gyroscope: BodyRates,
    accelerometer: Vector,
    *readings: Any,
) -> tuple[Any, ...]:
    """Return the state of a filter after a sample of the inertial measurement unit.

    Args:
        structure: structure of the filter.
        estimate: estimate at the time of the readings.
        covariance: covariance at the last propagation.
        motion: motion since then.
        counters: counters of samples.
        innovation: latest normalised innovations.
        parameters: parameters of the filter.
        gyroscope: reading of the gyroscope.
        accelerometer: reading of the accelerometer along the axes of B, m/s².
        readings: reading and validity of each aiding sensor; the validity is None if no reading can be missing.
    """
    starts = counters.waits_for_start > 0.5
    attitude = _if_needed(starts, levelled, (accelerometer, parameters.initial_yaw), estimate.attitude)
    estimate = estimate._replace(attitude=attitude)
    is_due: Any = True if structure.propagation_samples == 1 else counters.samples_to_propagation < 0.5
    covariance = _if_needed(is_due, propagated, (covariance, motion, parameters.noise), covariance)
    motion = where(is_due, NO_MOTION, motion)
    waits, rejections, innovations, first = [], [], [], 0
    for k, (aiding, aiding_parameters) in enumerate(zip(structure.aiding, parameters.aiding, strict=True)):
        reading, validity = readings[2 * k : 2 * k + 2]
        is_new: Any = True if aiding.samples == 1 else counters.samples_to_reading[k] < 0.5
        waits.append(_next_count(is_new, counters.samples_to_reading[k], aiding.samples))
        if validity is not None:
            is_new = is_new & (validity.valid > 0.5)
        before = innovation[first : first + aiding.law.num_scalars]
        first += aiding.law.num_scalars
        arguments = estimate, covariance, reading, aiding_parameters, gyroscope, counters.rejections[k]
        after = _if_needed(
            is_new, _Correction(aiding.law), arguments, Corrected(estimate, covariance, before, counters.rejections[k])
        )
        estimate, covariance = after.estimate, after.covariance
        innovations += after.innovation
        rejections.append(after.rejections)
    estimate, motion = predicted(estimate, motion, gyroscope, accelerometer, parameters.gravity, structure.period)
    wait = _next_count(is_due, counters.samples_to_propagation, structure.propagation_samples)
    counters = Counters(0.0, wait, tuple(waits), tuple(rejections))
    return estimate, covariance, motion, counters, tuple(innovations)


class Corrected(NamedTuple):
    """Result of the correction by a reading.

    Attributes:
        estimate: corrected estimate.
        covariance: covariance of its errors.
        innovation: normalised innovations of the scalar measurements.
        rejections: number of successive readings with a rejected measurement, at most `max_rejections`.
    """

    estimate: Estimate
    covariance: Covariance
    innovation: tuple[Number, ...]
    rejections: Number


@dataclass(frozen=True)
class _Correction:
    """Formula of the correction by a reading with a given measurement equation."""

    law: AidingLaw

    def __call__(
        self,
        estimate: Estimate,
        covariance: Covariance,
        reading: Any,
        parameters: AidingParameters,
        gyroscope: BodyRates,
        rejections: Number,
    ) -> Corrected:
        measurements = self.law.formula(estimate, reading, parameters.sensor, gyroscope)
        limit, maximum = parameters.innovation_limit, parameters.max_rejections
        error, covariance, innovation = corrected_error(covariance, measurements, limit, rejections >= maximum)
        is_rejected = total([where(each * each <= limit, 0.0, 1.0) for each in innovation]) > 0.5
        rejections = where(is_rejected, minimum(rejections + 1.0, maximum), 0.0)
        return Corrected(with_error(estimate, error), covariance, innovation, rejections)


@dataclass(frozen=True)
class _InitialGroup:
    """Function that computes the initial value of a field of `Memory` from the parameters."""

    name: str
    num_scalars: int

    def __call__(self, parameters: FilterParameters) -> Any:
        return getattr(initial_memory(parameters, self.num_scalars), self.name)


def _next_count(is_due: Any, count: Number, period: int) -> Number:
    """Return the number of samples to the next event of a given period, after a sample."""
    return 0.0 if period == 1 else where(is_due, period - 1.0, count - 1.0)


def _if_needed(mask: Any, formula: Callable[..., Any], arguments: Sequence[Any], otherwise: Any) -> Any:
    """Return `where_needed` of a formula of records.

    Args:
        mask: Boolean for each vehicle, true if the vehicle needs the formula.
        formula: function of records that returns a record.
        arguments: arguments of the formula.
        otherwise: result for vehicles for which the mask is false.
    """
    layouts = [layout_of(type(each) if isinstance(each, tuple) else Row, each) for each in arguments]
    result = layout_of(type(otherwise), otherwise)

    def of_rows(*rows: Row) -> tuple[Row, ...]:
        remaining, records = list(rows), []
        for layout in layouts:
            records.append(layout.build(remaining[: layout.num_rows]))
            del remaining[: layout.num_rows]
        return tuple(result.flatten(formula(*records)))

    flat = [row for layout, each in zip(layouts, arguments, strict=True) for row in layout.flatten(each)]
    return result.build(where_needed(mask, of_rows, flat, tuple(result.flatten(otherwise))))


@fleet_system(float, AutoDiffXd)
class ErrorStateKalmanFilter(FleetSystem):
    """Error-state Kalman filter for the state of the vehicle and the biases of its inertial sensors.

    .. pydrake_system::

        name: ErrorStateKalmanFilter
        input_ports:
        - gyroscope
        - accelerometer
        - position
        - position_valid
        output_ports:
        - measurement
        - estimate_deviation
        - innovation

    At every multiple of the period h, except for time zero, the filter reads its input ports, whose values were sampled
    one period before. It corrects the estimate by the readings of the aiding sensors, and predicts it over one period.
    The outputs therefore have no delay if the sensors have none. An aiding sensor with a period of several samples has
    new readings at multiples of its period.

    The covariance is propagated every `propagation_samples` samples, over the sum of their motions. A propagation costs
    as much as four predictions. `estimate_deviation` is the standard deviation after the last correction. `innovation`
    contains the latest normalised innovations of each scalar measurement, sensor by sensor.

    The vehicle is at rest at the first sample. Roll and pitch are estimated from the direction of the accelerometer's
    reading, and the first reading of each aiding sensor is used even if its innovation is large. Position and yaw
    therefore begin at the first readings if their initial deviations are large.

    The block shows the ports of a filter with the aiding sensor `position`, whose readings can be missing.

    Args:
        num_vehicles: number of vehicles N.
        aiding: aiding sensors. Their periods are multiples of `propagation_samples`.
        period: sampling period h of the inertial measurement unit, s.
        propagation_samples: number of samples between propagations of the covariance.
        parameters: parameters of the filter.

    Raises:
        ValueError: if a period is not a multiple of `propagation_samples`, or if parameters belong to another sensor.
    """

    def declare(
        self,
        *,
        aiding: tuple[Aiding, ...],
        period: float,
        propagation_samples: int = 1,
        parameters: FilterParameters,
    ) -> None:
        """Declare ports, states and parameters."""
        _check(aiding, propagation_samples, parameters)
        num_scalars = sum(each.law.num_scalars for each in aiding)
        gyroscope = self.input("gyroscope", layout=layout_of(BodyRates))
        accelerometer = self.input("accelerometer", layout=layout_of(Vector))
        readings: list[Any] = []
        for each in aiding:
            readings.append(self.input(each.name, layout=layout_of(each.law.reading)))
            valid = self.input(valid_signal(each.name), layout=layout_of(Valid)) if each.can_miss else None
            readings.append(valid)
        parameter = self.parameter("parameters", lambda parameters: parameters)
        groups = [self.state(name, _InitialGroup(name, num_scalars)) for name in Memory._fields]
        structure = FilterStructure(tuple(aiding), period, propagation_samples)
        reads = structure, *groups, parameter, gyroscope, accelerometer, *readings
        self.update(period, filter_step, *reads, writes=groups, at_start=False)
        estimate, covariance, _, _, innovation = groups
        self.output("measurement", state_of, estimate, gyroscope)
        self.output("estimate_deviation", Covariance.deviations, covariance)
        self.output("innovation", identity, innovation, layout=rows_layout(num_scalars))


def _check(aiding: Sequence[Aiding], propagation_samples: int, parameters: FilterParameters) -> None:
    if propagation_samples < 1:
        raise ValueError(f"propagation_samples is {propagation_samples}, but must be at least 1")
    if len(aiding) != len(parameters.aiding):
        raise ValueError(f"there are parameters for {len(parameters.aiding)} aiding sensors, but {len(aiding)} sensors")
    for each, given in zip(aiding, parameters.aiding, strict=True):
        if each.kind not in AIDING_LAWS:
            raise ValueError(f"{each.name} has the kind {each.kind!r}, but must have one of {', '.join(AIDING_LAWS)}")
        if each.samples < 1 or each.samples % propagation_samples:
            raise ValueError(
                f"{each.name} has a period of {each.samples} samples, but must have a multiple of propagation_samples,"
                f" which is {propagation_samples}"
            )
        if type(given.sensor) is not each.law.aiding:
            raise ValueError(
                f"{each.name} has parameters of type {type(given.sensor).__name__}, but the kind {each.kind!r} needs"
                f" {each.law.aiding.__name__}"
            )
