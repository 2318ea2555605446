"""Sensors on board: periodic readings with noise and latency, and the diagram of all sensors.

A reading is taken when a simulation begins and at every multiple of the period, and it arrives whole periods later.
Other discrete updates see it from their next instant on, as they see a frame of motion capture.
"""

from collections.abc import Callable, Collection, Mapping
from typing import Any, NamedTuple

from pydrake.common import RandomDistribution
from pydrake.systems.framework import Diagram, DiagramBuilder

from drake_quad.errors import InputError
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.framework.records import layout_of
from drake_quad.framework.wiring import append, build, connect_inputs
from drake_quad.laboratory.delay_line import carried, declare_delay_line
from drake_quad.randomness.noise import Stream, export_streams


class SensorLaw(NamedTuple):
    """Measurement equation of a sensor.

    Attributes:
        reading: type of the record of a reading.
        formula: function of the sensor's numbers, of the noise, which is None if there is none, and of the signals that
            the sensor reads; it returns a reading. The numbers have a field `latency_samples`. The noise is a reading
            with a normal number in each row.
        reads: names of the signals that the sensor reads.
    """

    reading: type
    formula: Callable[..., Any]
    reads: tuple[str, ...]


def first_reading(
    formula: Callable[..., Any], longest_latency: int, numbers: Any, noise: Any, *signals: Any
) -> tuple[Any, tuple[Any, ...]]:
    """Return what the states of a `Sensor` contain at the beginning."""
    reading = formula(numbers, noise, *signals)
    return reading, (reading,) * longest_latency


def next_reading(
    formula: Callable[..., Any], under_way: tuple[Any, ...], numbers: Any, noise: Any, *signals: Any
) -> tuple[Any, tuple[Any, ...]]:
    """Return what the states of a `Sensor` contain after a reading."""
    return carried(formula(numbers, noise, *signals), under_way, numbers.latency_samples)


@fleet_system(float, AutoDiffXd)
class Sensor(FleetSystem):
    """A sensor on board.

    .. pydrake_system::

        name: Sensor
        input_ports:
        - state
        - acceleration
        - noise
        output_ports:
        - accelerometer

    The output port has the name of the sensor, and the input ports are the signals that its law reads, here those of an
    accelerometer. The random input port `noise`, a normal number for each row of a reading, is there for a sensor with
    noise.

    The parameter of the context is `numbers`. The states are those of a `DelayLine`: under the name of the sensor, the
    reading that arrived last, and with a latency those that are under way.

    Args:
        num_vehicles: N.
        name: name of the sensor.
        law: law that the sensor measures by.
        period: time between readings, s.
        noisy: True for readings with noise.
        longest_latency: largest possible latency, in periods.
        numbers: record of the numbers of the law.
    """

    def declare(
        self,
        *,
        name: str,
        law: SensorLaw,
        period: float = 0.01,
        noisy: bool = False,
        longest_latency: int = 0,
        numbers: Any,
    ) -> None:
        """Declare the system."""
        signals = [self.input(signal) for signal in law.reads]
        own = self.parameter("numbers", lambda numbers: numbers)
        noise = None
        if noisy:
            noise = self.random_input("noise", law.reading, RandomDistribution.kGaussian, period=period)
        layout = layout_of(law.reading)
        nothing = layout.build([0.0] * layout.num_rows)
        line = declare_delay_line(self, name, lambda numbers: nothing, longest_latency)
        self.initialize(first_reading, law.formula, longest_latency, own, noise, *signals, writes=line)
        self.update(period, next_reading, law.formula, line.under_way, own, noise, *signals, writes=line)
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

    Ports of the sensors are ports of the diagram, here for an accelerometer: the output port of each under the name of
    the sensor, random input ports under the names of their streams, and other input ports under their own.

    Args:
        sensors: systems with one output port, by name.
        streams: streams of the random input ports of the sensors, by the name of the sensor.
        available: names of the signals that sensors can read.

    Raises:
        InputError: a sensor reads a signal that is not available.
    """
    builder = DiagramBuilder()
    outputs = {name: append(builder, name, sensor) for name, sensor in sensors.items()}
    connect_inputs(builder, sensors.values(), exported=available)
    export_streams(builder, sensors, streams)
    for name, sensor in sensors.items():
        for port in map(sensor.get_input_port, range(sensor.num_input_ports())):
            if not builder.IsConnectedOrExported(port):
                there = ", ".join(f"`{signal}`" for signal in available)
                raise InputError(f"the sensor {name} reads `{port.get_name()}`, but this laboratory has {there}")
        builder.ExportOutput(outputs[name], name)
    return build(builder, "sensors")
