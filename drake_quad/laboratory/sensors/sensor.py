"""Sensors on board: periodic readings with noise and latency, and the diagram of all sensors.

A sensor takes a reading at the start of a simulation and at every multiple of the period. The reading becomes available
after a whole number of periods. Discrete updates of other systems at the same instant still use the previous reading,
as with motion capture.
"""

from collections.abc import Callable, Collection, Mapping
from typing import Any, NamedTuple

from pydrake.common import RandomDistribution
from pydrake.systems.framework import Diagram, DiagramBuilder

from drake_quad.errors import InputError
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.framework.records import layout_of
from drake_quad.framework.wiring import append, build, connect_inputs
from drake_quad.laboratory.delay_line import declare_delay_line, delay_line_step
from drake_quad.randomness.noise import Stream, export_streams


class SensorLaw(NamedTuple):
    """Measurement equation of a sensor.

    Attributes:
        reading: type of the record of a reading.
        formula: function that returns a reading. Its arguments are the parameters of the sensor, the noise, and the
            input signals of the sensor. The parameters are a record with a field `latency_samples`. The noise is a
            record of type `reading` with a standard normal sample in each row, or None if there is no noise.
        reads: names of the input signals of the sensor.
    """

    reading: type
    formula: Callable[..., Any]
    reads: tuple[str, ...]


def first_reading(
    formula: Callable[..., Any], longest_latency: int, parameters: Any, noise: Any, *signals: Any
) -> tuple[Any, tuple[Any, ...]]:
    """Return the initial states of a `Sensor`."""
    reading = formula(parameters, noise, *signals)
    return reading, (reading,) * longest_latency


def next_reading(
    formula: Callable[..., Any], in_transit: tuple[Any, ...], parameters: Any, noise: Any, *signals: Any
) -> tuple[Any, tuple[Any, ...]]:
    """Return the states of a `Sensor` after a reading."""
    return delay_line_step(formula(parameters, noise, *signals), in_transit, parameters.latency_samples)


@fleet_system(float, AutoDiffXd)
class Sensor(FleetSystem):
    """Sensor on board.

    .. pydrake_system::

        name: Sensor
        input_ports:
        - state
        - acceleration
        - noise
        output_ports:
        - accelerometer

    The block above shows an accelerometer. The output port is named after the sensor. The input ports are the signals
    that the measurement equation needs. A sensor with noise has the random input port `noise`, with a standard normal
    sample for each row of a reading.

    The parameter of the context is `parameters`. The states are the states of a `DelayLine`: the latest reading that
    has arrived, under the name of the sensor, and, if there is latency, the readings in transit.

    Args:
        num_vehicles: number N of vehicles.
        name: name of the sensor.
        law: measurement equation of the sensor.
        period: time between readings, s.
        noisy: True if the readings have noise.
        longest_latency: largest possible latency, in periods.
        parameters: record of the parameters of the measurement equation.
    """

    def declare(
        self,
        *,
        name: str,
        law: SensorLaw,
        period: float = 0.01,
        noisy: bool = False,
        longest_latency: int = 0,
        parameters: Any,
    ) -> None:
        """Declare ports, states and parameters."""
        signals = [self.input(signal) for signal in law.reads]
        parameter = self.parameter("parameters", lambda parameters: parameters)
        noise = None
        if noisy:
            noise = self.random_input("noise", law.reading, RandomDistribution.kGaussian, period=period)
        layout = layout_of(law.reading)
        zero_reading = layout.build([0.0] * layout.num_rows)
        line = declare_delay_line(self, name, lambda parameters: zero_reading, longest_latency)
        self.initialize(first_reading, law.formula, longest_latency, parameter, noise, *signals, writes=line)
        self.update(period, next_reading, law.formula, line.in_transit, parameter, noise, *signals, writes=line)
        self.state_output(line.out)


def build_sensors(
    sensors: Mapping[str, Any], *, streams: Mapping[str, list[Stream]], available: Collection[str]
) -> Diagram:
    """Build the diagram `sensors`.

    .. pydrake_system::

        name: sensors
        input_ports:
        - state
        - acceleration
        - accelerometer.noise
        output_ports:
        - accelerometer

    The diagram exports all ports of the sensors. The block above shows a single accelerometer. An output port is named
    after its sensor, and a random input port after its stream. Other input ports keep their names.

    Args:
        sensors: systems with one output port, by name.
        streams: streams of the sensors' random input ports, by the name of the sensor.
        available: names of the signals that the laboratory provides.

    Raises:
        InputError: if the laboratory does not provide an input signal of a sensor.
    """
    builder = DiagramBuilder()
    outputs = {name: append(builder, name, sensor) for name, sensor in sensors.items()}
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
        builder.ExportOutput(outputs[name], name)
    return build(builder, "sensors")
