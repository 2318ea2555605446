"""Sensors on board: periodic readings with noise, memory, latency and faults, and the diagram of all sensors.

A sensor takes a reading at the start of a simulation and at every multiple of the period. The reading becomes available
after a whole number of periods. Discrete updates of other systems at the same instant still use the previous reading,
as with motion capture.

A sensor is a hidden Markov model. Its memory m, such as a drifting bias, and its reading y at tick k are

    m_0 = start(n_0, u_0)    m_k = step(m_{k-1}, n_k, u_k)    y_k = formula(m_k, n_k, u_k)

with the input signals u and standard normal noise n.
"""

from collections.abc import Callable, Collection, Mapping
from typing import Any, NamedTuple

from pydrake.common import RandomDistribution
from pydrake.systems.framework import Diagram, DiagramBuilder

from drake_quad.errors import InputError
from drake_quad.framework.elementary import where
from drake_quad.framework.fleet_system import TIME, AutoDiffXd, FleetSystem, Input, fleet_system
from drake_quad.framework.records import layout_of
from drake_quad.framework.wiring import build, connect_inputs
from drake_quad.laboratory.delay_line import DelayLine, declare_delay_line, delay_line_step, latest_sample
from drake_quad.randomness.noise import Stream, export_streams
from drake_quad.signals import SIGNALS, Number, Row, Time, Valid, valid_signal


class SensorMemory(NamedTuple):
    """State equation of a sensor, whose internal state is called its memory.

    Attributes:
        start: function that returns the memory at the first reading. Its arguments are those of the law's formula
            except for the memory.
        step: function that returns the memory at the next reading. Its arguments are the parameters of the sensor, the
            noise of the next reading, the previous memory, and the input signals at the next reading.
    """

    start: Callable[..., Any]
    step: Callable[..., Any]


class Sample(NamedTuple):
    """Reading of a sensor whose readings can be missing, and its validity.

    Attributes:
        reading: record of the reading.
        valid: True if there is a reading; the sensor repeats the previous reading otherwise.
    """

    reading: Any
    valid: Any


class SensorLaw(NamedTuple):
    """Measurement law of a sensor: how its readings follow from signals, noise and internal state.

    Attributes:
        reading: type of the record of a reading.
        formula: function that returns a reading, or a `Sample` if readings can be missing. Its arguments are the
            parameters of the sensor, the noise, the memory if the law has a memory, and the input signals of the
            sensor. The parameters are a record with a field `latency_samples`. Errors that can be switched off are
            fields of a record in the field `errors` of the parameters; they are None if they are switched off.
        reads: names of the input signals of the sensor.
        errors_that_read: pairs of the name of an error and the name of a further input signal that this error needs.
            The formula receives None for the signal if the error is switched off.
        memory: state equation of the sensor; None for a sensor without a memory.
        noise: function that returns a record of zeros with one component for each standard normal sample that a reading
            needs, given the parameters. By default, the noise has the type `reading`. A formula receives None if there
            is no noise.
        can_miss: True if the formula returns a `Sample`.
    """

    reading: type
    formula: Callable[..., Any]
    reads: tuple[str, ...]
    errors_that_read: tuple[tuple[str, str], ...] = ()
    memory: SensorMemory | None = None
    noise: Callable[[Any], Any] | None = None
    can_miss: bool = False


class FaultKind(NamedTuple):
    """Kind of a sensor fault.

    Attributes:
        is_reported: True if the sensor reports lost readings as not valid; False if it repeats its last reading as if
            it were new.
        is_random: True if readings are lost at random.
    """

    is_reported: bool
    is_random: bool


class SensorFault(NamedTuple):
    """Interval of time in which readings are lost, and the probability that a reading is lost.

    Attributes:
        start: time of the first reading that can be lost.
        end: time from which on readings are no longer lost.
        rate: probability that a reading is lost.
    """

    start: Time
    end: Time
    rate: Number


class FaultySensor(NamedTuple):
    """Parameters of a sensor with a fault.

    Attributes:
        sensor: parameters of the measurement law.
        fault: parameters of the fault.
    """

    sensor: Any
    fault: SensorFault


class Dropout(NamedTuple):
    """Uniform random number in [0, 1) for a reading, which is lost if the number is below the rate of the fault."""

    reading: Number


class _Structure(NamedTuple):
    """Properties of a `Sensor` on which its state equations depend.

    Attributes:
        law: measurement law.
        fault: kind of the fault; None for a sensor without a fault.
        longest_latency: largest possible latency, in periods.
    """

    law: SensorLaw
    fault: FaultKind | None
    longest_latency: int

    @property
    def can_miss(self) -> bool:
        """True if readings of the sensor can be missing."""
        return self.law.can_miss or self.fault is not None

    def sample(self, memory: Any, parameters: Any, noise: Any, signals: tuple[Any, ...]) -> Sample:
        """Return the reading of a sensor without a fault; the validity is 1 or 0."""
        arguments = (parameters, noise) if self.law.memory is None else (parameters, noise, memory)
        result = self.law.formula(*arguments, *signals)
        if not self.law.can_miss:
            return Sample(result, 1.0)
        return Sample(result.reading, where(result.valid, 1.0, 0.0))

    def with_fault(self, sample: Sample, last: Any, fault: SensorFault, dropout: Dropout | None, time: Row) -> Sample:
        """Return the reading of a sensor with a fault, given the last reading and the reading without a fault."""
        assert self.fault is not None
        is_lost = (time >= fault.start) & (time < fault.end)
        if dropout is not None:
            is_lost = is_lost & (dropout.reading < fault.rate)
        valid = where(is_lost, 0.0, sample.valid) if self.fault.is_reported else sample.valid
        return Sample(where(is_lost, last, sample.reading), valid)


def first_reading(
    structure: _Structure,
    parameters: Any,
    noise: Any,
    fault: SensorFault | None,
    dropout: Dropout | None,
    time: Row,
    *signals: Any,
) -> tuple[Any, ...]:
    """Return the initial states of a `Sensor`. If the first reading is missing, all its components are zero."""
    law = structure.law
    memory = None if law.memory is None else law.memory.start(parameters, noise, *signals)
    sample = structure.sample(memory, parameters, noise, signals)
    zero_reading = _zero_reading(law)
    # A sensor that freezes from the beginning repeats its first reading.
    if structure.fault is not None and fault is not None and structure.fault.is_reported:
        sample = structure.with_fault(sample, zero_reading, fault, dropout, time)
    reading = where(sample.valid > 0.5, sample.reading, zero_reading) if structure.can_miss else sample.reading
    valid = Valid(sample.valid)
    return reading, (reading,) * structure.longest_latency, valid, (valid,) * structure.longest_latency, memory


def next_reading(
    structure: _Structure,
    out: Any,
    in_transit: tuple[Any, ...],
    valid_in_transit: tuple[Valid, ...],
    memory: Any,
    parameters: Any,
    noise: Any,
    fault: SensorFault | None,
    dropout: Dropout | None,
    time: Row,
    *signals: Any,
) -> tuple[Any, ...]:
    """Return the states of a `Sensor` after a reading.

    Args:
        structure: properties of the sensor.
        out: reading that the output contained before the update; None if no reading can be missing.
        in_transit: earlier readings that are not yet available, latest reading first.
        valid_in_transit: validity of these readings.
        memory: memory at the previous reading.
        parameters: parameters of the measurement law.
        noise: standard normal samples; None if there is no noise.
        fault: parameters of the fault; None if there is no fault.
        dropout: random number of the reading; None if no reading is lost at random.
        time: time of the reading, s.
        signals: input signals of the sensor.
    """
    law = structure.law
    if law.memory is not None:
        memory = law.memory.step(parameters, noise, memory, *signals)
    sample = structure.sample(memory, parameters, noise, signals)
    if not structure.can_miss:
        return *delay_line_step(sample.reading, in_transit, parameters.latency_samples), None, (), memory
    last = latest_sample(out, in_transit)
    if law.can_miss:
        sample = Sample(where(sample.valid > 0.5, sample.reading, last), sample.valid)
    if fault is not None:
        sample = structure.with_fault(sample, last, fault, dropout, time)
    return (
        *delay_line_step(sample.reading, in_transit, parameters.latency_samples),
        *delay_line_step(Valid(sample.valid), valid_in_transit, parameters.latency_samples),
        memory,
    )


def error_names(parameters: Any) -> tuple[str, ...]:
    """Return the names of the errors that can be switched off, given the parameters of a sensor."""
    return parameters.errors._fields if hasattr(parameters, "errors") else ()


def with_errors(parameters: Any, names: Collection[str]) -> Any:
    """Return the parameters of a sensor with all errors except for the named ones switched off."""
    switched_off = {name: None for name in error_names(parameters) if name not in names}
    return parameters._replace(errors=parameters.errors._replace(**switched_off)) if switched_off else parameters


def _zero_reading(law: SensorLaw) -> Any:
    layout = layout_of(law.reading)
    return layout.build([0.0] * layout.num_rows)


def _zeros_like(example: Any) -> Any:
    layout = layout_of(type(example), example)
    return layout.build([0.0] * layout.num_rows)


@fleet_system(float, AutoDiffXd)
class Sensor(FleetSystem):
    """Sensor on board.

    .. pydrake_system::

        name: Sensor
        input_ports:
        - state
        - acceleration
        - rotor_speed
        - noise
        - dropout
        output_ports:
        - accelerometer
        - accelerometer_valid

    The block above shows an accelerometer with all its errors and a fault. The output port is named after the sensor.
    The input ports are the signals that the measurement law needs. A sensor with noise has the random input port
    `noise`, with standard normal samples.

    A sensor whose readings can be missing has a second output port, whose name ends with `_valid`. It is 1 if the
    latest reading is a new one, and 0 if this reading is missing. A missing reading repeats the previous one. The first
    reading is zero if it is missing. A sensor that loses readings at random has the random input port `dropout`, with a
    uniform number in [0, 1) for each reading.

    The parameters of the context are `parameters` and, for a sensor with a fault, `fault`. The states are the states of
    a `DelayLine`: the latest reading that has arrived, under the name of the sensor, and, if there is latency, the
    readings in transit. If readings can be missing, the validity has a `DelayLine` of its own. The state `memory` is
    the internal state of the measurement law, if its errors need one.

    Args:
        num_vehicles: number N of vehicles.
        name: name of the sensor.
        law: measurement law of the sensor.
        period: time between readings, s.
        noisy: True if the readings have noise.
        longest_latency: largest possible latency, in periods.
        errors: names of the errors that are switched on.
        fault: kind of the fault; None for a sensor without a fault.
        parameters: record of the parameters of the measurement law; a `FaultySensor` for a sensor with a fault.
    """

    def declare(
        self,
        *,
        name: str,
        law: SensorLaw,
        period: float = 0.01,
        noisy: bool = False,
        longest_latency: int = 0,
        errors: tuple[str, ...] = (),
        fault: FaultKind | None = None,
        parameters: Any,
    ) -> None:
        """Declare the ports, states and parameters of this system."""
        structure = _Structure(law, fault, longest_latency)

        def law_parameters(parameters: Any) -> Any:
            return with_errors(parameters.sensor if isinstance(parameters, FaultySensor) else parameters, errors)

        signals: list[Input | None] = [self.input(signal) for signal in law.reads]
        signals += [self.input(signal) if error in errors else None for error, signal in law.errors_that_read]
        parameter = self.parameter("parameters", law_parameters)
        example = law_parameters(parameters)
        noise_example = _zero_reading(law) if law.noise is None else law.noise(example)
        noise = None
        if noisy:
            layout = layout_of(type(noise_example), noise_example)
            noise = self.random_input("noise", layout, RandomDistribution.kGaussian, period=period)

        def zero_memory(parameters: Any) -> Any:
            """Return a memory of zeros, which the initialization replaces."""
            assert law.memory is not None
            inputs = [layout_of(SIGNALS[each.name]) if each is not None else None for each in signals]
            zeros = [None if layout is None else layout.build([0.0] * layout.num_rows) for layout in inputs]
            start = law.memory.start(law_parameters(parameters), noise_example if noisy else None, *zeros)
            return _zeros_like(start)

        line = declare_delay_line(self, name, lambda parameters: _zero_reading(law), longest_latency)
        validity = DelayLine(None, ())  # type: ignore[arg-type]
        if structure.can_miss:
            validity = declare_delay_line(self, valid_signal(name), lambda parameters: Valid(0.0), longest_latency)
        memory = None if law.memory is None else zero_memory(parameters)
        has_memory = memory is not None and layout_of(type(memory), memory).num_rows > 0
        if has_memory:
            memory = self.state("memory", zero_memory)
        fault_reads: tuple[Any, ...] = (None, None, 0.0)
        if fault is not None:
            dropout = None
            if fault.is_random:
                dropout = self.random_input("dropout", Dropout, RandomDistribution.kUniform, period=period)
            fault_reads = self.parameter("fault", lambda parameters: parameters.fault), dropout, TIME
        reads = parameter, noise, *fault_reads, *signals
        writes = *line, *validity, memory if has_memory else None
        self.initialize(first_reading, structure, *reads, writes=writes)
        # The initialization event already takes the reading at time zero. A memory must not be advanced again with the
        # same random samples, so the updates of a sensor with a memory begin one period later.
        self.update(
            period,
            next_reading,
            structure,
            line.out if structure.can_miss else None,
            line.in_transit,
            validity.in_transit,
            memory,
            *reads,
            writes=writes,
            at_start=not has_memory,
        )
        self.state_output(line.out)
        if structure.can_miss:
            self.state_output(validity.out)


def build_sensors(
    sensors: Mapping[str, Any], *, streams: Mapping[str, list[Stream]], available: Collection[str]
) -> Diagram:
    """Build the diagram `sensors`.

    .. pydrake_system::

        name: sensors
        input_ports:
        - state
        - acceleration
        - rotor_speed
        - accelerometer.noise
        - accelerometer.dropout
        output_ports:
        - accelerometer
        - accelerometer_valid

    The diagram exports all ports of the sensors. The block above shows a single accelerometer. An output port is named
    after its sensor, and a random input port after its stream. Other input ports keep their names.

    Args:
        sensors: systems by name. The first output port of a system is the reading; a second one is the validity.
        streams: streams of the sensors' random input ports, by the name of the sensor.
        available: names of the signals that the laboratory provides.

    Raises:
        InputError: if the laboratory does not provide an input signal of a sensor.
    """
    builder = DiagramBuilder()
    for name, sensor in sensors.items():
        builder.AddNamedSystem(name, sensor)
    connect_inputs(builder, sensors.values(), exported=available)
    export_streams(builder, sensors, streams)
    for name, sensor in sensors.items():
        for port in map(sensor.get_input_port, range(sensor.num_input_ports())):
            if not builder.IsConnectedOrExported(port):
                available_names = ", ".join(f"`{signal}`" for signal in available)
                raise InputError(
                    f"the sensor {name} needs the signal `{port.get_name()}`, but this laboratory provides only"
                    f" {available_names}"
                )
        reading, *validity = (sensor.get_output_port(i) for i in range(sensor.num_output_ports()))
        builder.ExportOutput(reading, name)
        for port in validity:
            builder.ExportOutput(port, valid_signal(name))
    return build(builder, "sensors")
