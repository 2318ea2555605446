"""Error-state Kalman filter on board: inertial navigation, corrected by readings of other sensors.

The filter corrects its estimate at a horizon, which lies before the present by the longest latency of its aiding
sensors. When the horizon reaches the time at which a reading was taken, this reading has therefore always arrived.
Samples of the inertial measurement unit are integrated in blocks of several samples. Blocks between the horizon and the
present are stored. The filter predicts the estimate at the present from the estimate at the horizon, over these blocks
and over the samples of the current block:

    time        horizon                                    present
                   ├──── block ────┼──── block ────┼── samples ──┤
    estimate    filter                              block start  output

PX4 uses the same structure, with a slower predictor between the horizon and the present (A. Khosravian et al.,
"Recursive attitude estimation in the presence of multi-rate and multi-delay vector measurements", ACC 2015).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

from drake_quad.estimation.corrections import AIDING_LAWS, AidingLaw, attitude_from_accelerometer, measurements_at
from drake_quad.estimation.covariance import Covariance, Gate, InertialNoise, corrected_error, propagate
from drake_quad.estimation.estimate import (
    NO_INCREMENT,
    Estimate,
    InertialIncrement,
    add_error,
    correct_increment_biases,
    extend_increment,
    predict,
    state_of,
)
from drake_quad.framework.elementary import identity, lazy_where, maximum, minimum, total, where
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.framework.records import layout_of, rows_layout
from drake_quad.geometry.axes import Vector
from drake_quad.geometry.quaternion import NO_ROTATION
from drake_quad.signals import Angle, BodyRates, EstimateDeviation, Number, Quantity, Row, State, Valid, valid_signal


class Aiding(NamedTuple):
    """Aiding sensor of a filter.

    Attributes:
        name: name of the input port with the readings.
        kind: type of the readings, a key of `AIDING_LAWS`.
        period_samples: period of the readings, in samples of the inertial measurement unit.
        can_miss: True if readings can be missing; the filter then has an input port for the validity of the readings.
        latency: time from the measurement to the arrival of a reading, in periods of the readings.
    """

    name: str
    kind: str
    period_samples: int = 1
    can_miss: bool = False
    latency: int = 0

    @property
    def law(self) -> AidingLaw:
        """Measurement equation of the aiding sensor."""
        return AIDING_LAWS[self.kind]


class AidingParameters(NamedTuple):
    """Parameters of an aiding sensor.

    Attributes:
        sensor: parameters of the measurement equation, such as a `PositionAiding`.
        innovation_limit: limit of the squared normalised innovation, beyond which a scalar measurement is rejected.
        max_rejections: number of successive readings with a rejected measurement after which the filter no longer
            rejects measurements, but lets them reset the measured quantity, until a reading satisfies the limit again.
            Without resets, a filter with a wrong estimate and a small covariance would reject all readings.
        lever: position of the sensor relative to the inertial measurement unit, along the axes of B, m; None if both
            are at the same position.
    """

    sensor: Any
    innovation_limit: Annotated[Row, Quantity("1", sign="positive")]
    max_rejections: Annotated[Row, Quantity("1", sign="nonnegative")] = 10.0
    lever: Vector | None = None


class FilterParameters(NamedTuple):
    """Parameters of an error-state Kalman filter.

    Attributes:
        noise: noise of the inertial measurement unit.
        initial: standard deviations of the errors of the initial estimate.
        aiding: parameters of the aiding sensors, in the same order as in the `FilterStructure`.
        start: initial estimate; None for a vehicle that is at rest at the origin with an unknown tilt.
        initial_yaw: yaw of the initial estimate if `start` is None.
        gravity: gravitational acceleration.
        imu: position of the inertial measurement unit relative to the centre of mass, along the axes of B, m; None if
            it is at the centre of mass.
    """

    noise: InertialNoise
    initial: EstimateDeviation
    aiding: tuple[AidingParameters, ...]
    start: Estimate | None = None
    initial_yaw: Angle = 0.0
    gravity: Annotated[Row, Quantity("m/s²", sign="positive")] = 9.81
    imu: Vector | None = None


class Counters(NamedTuple):
    """Counters of a filter. A sample is a sample of the inertial measurement unit.

    Attributes:
        waits_for_start: 1 before the first sample, then 0.
        samples_to_block: number of samples until the next block begins.
        samples_to_arrival: for each aiding sensor, the number of samples until its next reading arrives.
        samples_to_reading: for each aiding sensor, the number of samples until the horizon reaches its next reading.
        rejections: for each aiding sensor, the number of successive readings with a rejected measurement, at most
            `max_rejections`. It is `max_rejections` before the first reading.
    """

    waits_for_start: Number
    samples_to_block: Number
    samples_to_arrival: tuple[Number, ...]
    samples_to_reading: tuple[Number, ...]
    rejections: tuple[Number, ...]


class StoredReading(NamedTuple):
    """Reading of an aiding sensor that is stored until the horizon reaches it.

    Attributes:
        reading: reading of the sensor.
        validity: whether the reading is valid; None for a sensor whose readings cannot be missing.
    """

    reading: Any
    validity: Valid | None


class ErrorStateFilterState(NamedTuple):
    """State of a filter.

    Attributes:
        estimate: estimate at the horizon, at the beginning of the oldest block.
        covariance: covariance of the errors of this estimate.
        increment: motion over the samples of the current block.
        blocks: motion over each complete block between the horizon and the current block, the latest first; an empty
            tuple if no aiding sensor has a latency.
        estimate_at_block: estimate at the beginning of the current block; None if no aiding sensor has a latency.
        stored_readings: for each aiding sensor, the readings that the horizon has not reached yet, the latest first.
        counters: counters.
        innovation: latest normalised innovations of each scalar measurement.
    """

    estimate: Estimate
    covariance: Covariance
    increment: InertialIncrement
    blocks: tuple[InertialIncrement, ...]
    estimate_at_block: Estimate | None
    stored_readings: tuple[tuple[StoredReading, ...], ...]
    counters: Counters
    innovation: tuple[Number, ...]


# Fields of `ErrorStateFilterState` that linear models leave out; see `StateGroup.is_scheduled`.
_SCHEDULED_FIELDS = ("covariance", "counters", "innovation")


class FilterStructure(NamedTuple):
    """Structure of a filter.

    Attributes:
        aiding: aiding sensors.
        period: sampling period of the inertial measurement unit, s.
        block_samples: number of samples in a block.
    """

    aiding: tuple[Aiding, ...]
    period: float
    block_samples: int

    @property
    def horizon(self) -> int:
        """Time from the horizon to the beginning of the current block, in samples."""
        return max((each.latency * each.period_samples for each in self.aiding), default=0)

    @property
    def num_blocks(self) -> int:
        """Number of complete blocks between the horizon and the current block."""
        return self.horizon // self.block_samples

    def num_stored(self, aiding: Aiding) -> int:
        """Return the number of readings of a sensor that are stored; 0 if each reading is used when it arrives."""
        waiting = (self.horizon - aiding.latency * aiding.period_samples) // aiding.period_samples
        return waiting + 1 if waiting else 0

    @property
    def num_scalars(self) -> int:
        """Number of scalar measurements of all aiding sensors."""
        return sum(each.law.num_scalars for each in self.aiding)


def initial_memory(structure: FilterStructure, parameters: FilterParameters) -> ErrorStateFilterState:
    """Return the state of a filter before its first sample."""
    zero, start = Vector(0.0, 0.0, 0.0), parameters.start
    if start is None:
        start = Estimate(zero, zero, NO_ROTATION, zero, zero)
    increment = NO_INCREMENT._replace(gyroscope_bias=start.gyroscope_bias, accelerometer_bias=start.accelerometer_bias)
    arrivals = tuple([float(each.latency * each.period_samples) for each in structure.aiding])
    readings = (float(structure.horizon),) * len(structure.aiding)
    rejections = tuple([each.max_rejections for each in parameters.aiding])
    return ErrorStateFilterState(
        start,
        Covariance.diagonal(parameters.initial),
        increment,
        (increment,) * structure.num_blocks,
        start if structure.num_blocks else None,
        tuple([(_no_reading(each),) * structure.num_stored(each) for each in structure.aiding]),
        Counters(1.0, 0.0, arrivals, readings, rejections),
        (0.0,) * structure.num_scalars,
    )


def _no_reading(aiding: Aiding) -> StoredReading:
    layout = layout_of(aiding.law.reading)
    return StoredReading(layout.build([0.0] * layout.num_rows), Valid(0.0) if aiding.can_miss else None)


def filter_step(
    structure: FilterStructure,
    memory: ErrorStateFilterState,
    parameters: FilterParameters,
    gyroscope: BodyRates,
    accelerometer: Vector,
    readings: Sequence[StoredReading],
) -> ErrorStateFilterState:
    """Return the state of a filter after a sample of the inertial measurement unit.

    Args:
        structure: structure of the filter.
        memory: state before the sample.
        parameters: parameters of the filter.
        gyroscope: reading of the gyroscope.
        accelerometer: reading of the accelerometer along the axes of B, m/s².
        readings: latest reading of each aiding sensor.
    """
    waits = memory.counters
    begins = waits.samples_to_block < 0.5
    memory = memory._replace(stored_readings=_with_arrivals(memory, readings))
    if parameters.start is None:
        memory = _with_initial_tilt(memory, parameters, accelerometer)
    memory = _at_next_horizon(structure, memory, parameters, begins)
    memory = _corrected(structure, memory, parameters, gyroscope, readings)
    memory = _with_new_block(structure, memory, parameters, gyroscope, begins)
    samples = [each.period_samples for each in structure.aiding]
    counters = memory.counters._replace(
        waits_for_start=0.0,
        samples_to_block=next_wait(waits.samples_to_block, structure.block_samples),
        samples_to_arrival=tuple(map(next_wait, waits.samples_to_arrival, samples)),
        samples_to_reading=tuple(map(next_wait, waits.samples_to_reading, samples)),
    )
    increment = extend_increment(memory.increment, gyroscope, accelerometer, structure.period)
    return memory._replace(increment=increment, counters=counters)


def _with_arrivals(
    memory: ErrorStateFilterState, readings: Sequence[StoredReading]
) -> tuple[tuple[StoredReading, ...], ...]:
    """Return the stored readings of each aiding sensor, including the readings that arrive at this sample."""
    waits = memory.counters.samples_to_arrival
    return tuple(
        [
            where(wait < 0.5, (reading, *stored)[:-1], stored) if stored else ()
            for stored, reading, wait in zip(memory.stored_readings, readings, waits, strict=True)
        ]
    )


def _with_initial_tilt(
    memory: ErrorStateFilterState, parameters: FilterParameters, accelerometer: Vector
) -> ErrorStateFilterState:
    """Return the filter's state; at the first sample, with an attitude that is computed from the accelerometer."""
    estimate, starts = memory.estimate, memory.counters.waits_for_start > 0.5
    attitude = if_needed(
        starts, attitude_from_accelerometer, (accelerometer, parameters.initial_yaw), estimate.attitude
    )
    return memory._replace(estimate=estimate._replace(attitude=attitude))


def _at_next_horizon(
    structure: FilterStructure, memory: ErrorStateFilterState, parameters: FilterParameters, begins: Any
) -> ErrorStateFilterState:
    """Return the state after the horizon has moved to the next block, if a block begins at this sample."""
    blocks = (memory.increment, *memory.blocks)
    arguments = memory.estimate, memory.covariance, blocks[-1], parameters.noise, parameters.gravity
    estimate, covariance = if_needed(begins, _after_block, arguments, (memory.estimate, memory.covariance))
    if structure.num_blocks:
        memory = memory._replace(blocks=where(begins, blocks[:-1], memory.blocks))
    return memory._replace(estimate=estimate, covariance=covariance)


def _after_block(
    estimate: Estimate, covariance: Covariance, block: InertialIncrement, noise: InertialNoise, gravity: Row
) -> tuple[Estimate, Covariance]:
    """Propagate an estimate and its covariance from the start to the end of a block of inertial readings."""
    block = correct_increment_biases(block, estimate)
    return predict(estimate, block, gravity), propagate(covariance, block, estimate.attitude.axes(), noise)


def _corrected(
    structure: FilterStructure,
    memory: ErrorStateFilterState,
    parameters: FilterParameters,
    gyroscope: BodyRates,
    readings: Sequence[StoredReading],
) -> ErrorStateFilterState:
    """Return the state after corrections by the readings that were taken at the time of the horizon."""
    estimate, covariance, counters = memory.estimate, memory.covariance, memory.counters
    rates = memory.blocks[-1].first_rates if memory.blocks else gyroscope
    rejections, innovations, first = [], [], 0
    for k, (aiding, aiding_parameters) in enumerate(zip(structure.aiding, parameters.aiding, strict=True)):
        reading, validity = memory.stored_readings[k][-1] if memory.stored_readings[k] else readings[k]
        is_new = counters.samples_to_reading[k] < 0.5
        if validity is not None:
            is_new = is_new & (validity.valid > 0.5)
        before = memory.innovation[first : first + aiding.law.num_scalars]
        first += aiding.law.num_scalars
        arguments = estimate, covariance, reading, aiding_parameters, rates, counters.rejections[k]
        after = if_needed(
            is_new,
            _Correction(aiding.law, aiding.period_samples * structure.period),
            arguments,
            Corrected(estimate, covariance, before, counters.rejections[k]),
        )
        estimate, covariance = after.estimate, after.covariance
        innovations += after.innovation
        rejections.append(after.rejections)
    return memory._replace(
        estimate=estimate,
        covariance=covariance,
        innovation=tuple(innovations),
        counters=counters._replace(rejections=tuple(rejections)),
    )


def _with_new_block(
    structure: FilterStructure,
    memory: ErrorStateFilterState,
    parameters: FilterParameters,
    gyroscope: BodyRates,
    begins: Any,
) -> ErrorStateFilterState:
    """If a block of samples begins at this sample, return the filter's state with an empty current block.

    Otherwise, the state is returned unchanged.
    """
    estimate = memory.estimate
    empty = NO_INCREMENT._replace(
        gyroscope_bias=estimate.gyroscope_bias,
        accelerometer_bias=estimate.accelerometer_bias,
        first_rates=gyroscope,
    )
    memory = memory._replace(increment=where(begins, empty, memory.increment))
    if structure.num_blocks:
        ahead = if_needed(begins, _at_present, (estimate, memory.blocks, parameters.gravity), memory.estimate_at_block)
        memory = memory._replace(estimate_at_block=ahead)
    return memory


def _at_present(estimate: Estimate, blocks: tuple[InertialIncrement, ...], gravity: Row) -> Estimate:
    """Return the estimate after several blocks, given the estimate before them. The latest block comes first."""
    for block in reversed(blocks):
        estimate = predict(estimate, correct_increment_biases(block, estimate), gravity)
    return estimate


def next_wait(wait: Number, period: int) -> Number:
    """Return the number of samples until the next periodic event, after one more sample.

    Args:
        wait: number of samples before this sample; 0 if the event occurs at this sample.
        period: period of the event, in samples.
    """
    return where(wait < 0.5, period - 1.0, wait - 1.0)


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
    """Function that corrects an estimate and its covariance by a reading.

    Attributes:
        law: measurement equation.
        period: time between readings, s.
    """

    law: AidingLaw
    period: float

    def __call__(
        self,
        estimate: Estimate,
        covariance: Covariance,
        reading: Any,
        parameters: AidingParameters,
        gyroscope: BodyRates,
        rejections: Number,
    ) -> Corrected:
        measurements = measurements_at(parameters.lever, self.law, estimate, reading, parameters.sensor, gyroscope)
        resets = rejections >= parameters.max_rejections
        gate = Gate(parameters.innovation_limit, resets, self.period * maximum(rejections, 1.0))
        error, covariance, innovation = corrected_error(covariance, measurements, gate)
        is_rejected = total([where(each * each <= parameters.innovation_limit, 0.0, 1.0) for each in innovation]) > 0.5
        rejections = where(is_rejected, minimum(rejections + 1.0, parameters.max_rejections), 0.0)
        return Corrected(add_error(estimate, error), covariance, innovation, rejections)


@dataclass(frozen=True)
class _InitialField:
    """Function that computes the initial value of a field of `ErrorStateFilterState` from the filter's parameters."""

    name: str
    structure: FilterStructure

    def __call__(self, parameters: FilterParameters) -> Any:
        return getattr(initial_memory(self.structure, parameters), self.name)


@dataclass(frozen=True)
class _Step:
    """Function that calls `filter_step`, given the fields of `ErrorStateFilterState` and the values of the ports."""

    structure: FilterStructure

    def __call__(self, parameters: FilterParameters, gyroscope: BodyRates, accelerometer: Vector, *others: Any) -> Any:
        memory, ports = (
            ErrorStateFilterState(*others[: len(ErrorStateFilterState._fields)]),
            others[len(ErrorStateFilterState._fields) :],
        )
        readings = tuple(map(StoredReading, ports[0::2], ports[1::2]))
        return filter_step(self.structure, memory, parameters, gyroscope, accelerometer, readings)


def _state_at_present(
    parameters: FilterParameters,
    gyroscope: BodyRates,
    estimate: Estimate,
    increment: InertialIncrement,
    ahead: Estimate | None,
) -> State:
    """Return the estimated state of the vehicle at the present."""
    present = predict(estimate if ahead is None else ahead, increment, parameters.gravity)
    return state_of(present, gyroscope, parameters.imu)


def if_needed(mask: Any, formula: Callable[..., Any], arguments: Sequence[Any], otherwise: Any) -> Any:
    """Return the result of a formula for some vehicles, and another record for all other vehicles.

    This is `lazy_where` for a formula whose arguments and result are records instead of rows.

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
    return result.build(lazy_where(mask, of_rows, flat, tuple(result.flatten(otherwise))))


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
    An aiding sensor whose period is several samples has new readings at multiples of this period, and a reading arrives
    after its latency. Just after an update, the output `measurement` has no delay, whatever the latencies are. Discrete
    updates of other systems at the same instant use the previous output, as with motion capture.

    A block consists of `block_samples` samples. At the beginning of each block, the filter propagates the covariance
    and corrects the estimate, so readings must be taken at these times. `estimate_deviation` contains the standard
    deviations of the errors at the horizon, after the last correction. `innovation` contains the latest normalised
    innovation of each scalar measurement, sensor by sensor.

    Without an initial estimate, the filter assumes that the vehicle is at rest at the first sample. It estimates roll
    and pitch from the direction of the accelerometer's reading, and uses the first reading of each aiding sensor even
    if its innovation is large. If the initial deviations of position and yaw are large, their estimates therefore start
    at the first readings.

    The diagram shows the ports of a filter with the aiding sensor `position`, whose readings can be missing.

    Args:
        num_vehicles: number of vehicles N.
        aiding: aiding sensors. Their periods are multiples of `block_samples`.
        period: sampling period h of the inertial measurement unit, s.
        block_samples: number of samples in a block.
        parameters: parameters of the filter.

    Raises:
        ValueError: if a period is not a multiple of `block_samples`, or if parameters belong to another sensor.
    """

    def declare(
        self,
        *,
        aiding: tuple[Aiding, ...],
        period: float,
        block_samples: int = 1,
        parameters: FilterParameters,
    ) -> None:
        """Declare the ports, states and parameters of this system."""
        check_aiding(aiding, block_samples, [each.sensor for each in parameters.aiding])
        structure = FilterStructure(tuple(aiding), period, block_samples)
        gyroscope = self.input("gyroscope", layout=layout_of(BodyRates))
        accelerometer = self.input("accelerometer", layout=layout_of(Vector))
        readings: list[Any] = []
        for each in aiding:
            readings.append(self.input(each.name, layout=layout_of(each.law.reading)))
            valid = self.input(valid_signal(each.name), layout=layout_of(Valid)) if each.can_miss else None
            readings.append(valid)
        parameter = self.parameter("parameters", lambda parameters: parameters)
        initial = initial_memory(structure, parameters)
        writes = ErrorStateFilterState._make(
            self.state(name, _InitialField(name, structure), is_scheduled=name in _SCHEDULED_FIELDS)
            if _has_rows(group)
            else None
            for name, group in zip(ErrorStateFilterState._fields, initial, strict=True)
        )
        reads = [given if group is None else group for group, given in zip(writes, initial, strict=True)]
        arguments = parameter, gyroscope, accelerometer, *reads, *readings
        self.update(period, _Step(structure), *arguments, writes=writes, at_start=False)
        present = parameter, gyroscope, writes.estimate, writes.increment, writes.estimate_at_block
        self.output("measurement", _state_at_present, *present)
        self.output("estimate_deviation", Covariance.deviations, writes.covariance)
        self.output("innovation", identity, writes.innovation, layout=rows_layout(structure.num_scalars))


def _has_rows(record: Any) -> bool:
    return record is not None and layout_of(type(record), record).num_rows > 0


def check_aiding(aiding: Sequence[Aiding], block_samples: int, parameters: Sequence[Any]) -> None:
    """Raise ValueError if aiding sensors do not fit the blocks, or their parameters.

    Args:
        aiding: aiding sensors.
        block_samples: number of samples in a block.
        parameters: parameters of the measurement equation of each sensor.
    """
    if block_samples < 1:
        raise ValueError(f"block_samples is {block_samples}, but must be at least 1")
    if len(aiding) != len(parameters):
        raise ValueError(f"there are parameters for {len(parameters)} aiding sensors, but {len(aiding)} sensors")
    for each, given in zip(aiding, parameters, strict=True):
        if each.kind not in AIDING_LAWS:
            raise ValueError(f"{each.name} has the kind {each.kind!r}, but must have one of {', '.join(AIDING_LAWS)}")
        if each.period_samples < 1 or each.period_samples % block_samples:
            raise ValueError(
                f"{each.name} has a period of {each.period_samples} samples, but must have a multiple of block_samples,"
                f" which is {block_samples}"
            )
        if type(given) is not each.law.aiding:
            raise ValueError(
                f"{each.name} has parameters of type {type(given).__name__}, but the kind {each.kind!r} needs"
                f" {each.law.aiding.__name__}"
            )
