"""Sources of random numbers for the random input ports of a fleet's systems."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from pydrake.common import RandomDistribution
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import RandomSource

from drake_quad.errors import InputError
from drake_quad.framework.elementary import nearest, where
from drake_quad.framework.fleet_system import AutoDiffXd, CurrentTick, FleetSystem, fleet_system
from drake_quad.framework.formulas import Tick
from drake_quad.framework.records import ROW, Layout
from drake_quad.framework.wiring import split_output
from drake_quad.randomness.streams import Samples, StreamKind, StreamState, random_numbers, stream_states
from drake_quad.signals import Row

# Prefix of the names of exported input ports for random numbers, followed by the name of the stream.
EXPORTED_PREFIX = "random."


class ExportedRandomNumbers(NamedTuple):
    """Option to export random numbers as input ports of the diagram.

    A port supplies all random numbers of a period, tick after tick, and is read at the start of the period.

    Attributes:
        period: period, s, which is a multiple of the periods of all streams.
    """

    period: float


class Stream(NamedTuple):
    """Stream of random numbers for one input port.

    Attributes:
        name: name of the stream, which is unique among the streams of its kind.
        kind: purpose of the random numbers.
        num_rows: number of random numbers at each tick for one vehicle.
        distribution: standard normal (kGaussian), or uniform from 0 to 1 (kUniform).
        period: period of the ticks, s.
    """

    name: str
    kind: StreamKind
    num_rows: int
    distribution: RandomDistribution
    period: float


def stream_numbers(
    states: tuple[tuple[StreamState, ...], ...], kinds: Sequence[tuple[int, bool, float]], *ticks: Tick
) -> tuple[tuple[Row, ...], ...]:
    """Return the random numbers of several streams.

    Args:
        states: tuple for each stream. It contains one state for each noise period, with which the stream starts; see
            `NoiseSource`.
        kinds: (num_rows, is_normal, num_ticks) of each stream: the number of random numbers per tick, True for normal
            or False for uniform numbers, and the number of ticks in a noise period.
        ticks: tick of each stream.
    """
    return tuple(
        [
            random_numbers(state_in_period(of_periods, tick, num_ticks), tick, num_rows, normal)
            for of_periods, (num_rows, normal, num_ticks), tick in zip(states, kinds, ticks, strict=True)
        ]
    )


def state_in_period(states: tuple[StreamState, ...], tick: Tick, num_ticks: float) -> StreamState:
    """Return the initial state of a stream for the noise period that contains a tick.

    Args:
        states: initial state in each noise period.
        tick: tick of the stream.
        num_ticks: number of ticks in a noise period.
    """
    first, *others = states
    if not others:
        return first
    number, state = 2.0 * tick.pair + where(tick.second, 1.0, 0.0), first
    for k, other in enumerate(others, start=1):
        has_begun = number > k * num_ticks - 0.5
        state = StreamState(where(has_begun, other.high, state.high), where(has_begun, other.low, state.low))
    return state


@fleet_system(float, AutoDiffXd)
class NoiseSource(FleetSystem):
    """Source of the random numbers of several streams, tick by tick.

    .. pydrake_system::

        name: NoiseSource
        output_ports:
        - random

    The output contains the random numbers of all streams, under the names of the streams. Its value at any time is the
    value of the nearest tick, since systems read the output at ticks. The numbers of a tick depend only on the seed,
    the sample, the stream and the tick. The only parameter of the context is `streams`.

    Args:
        num_vehicles: number N of vehicles.
        streams: streams of the output, in order.
        noise_period: length of a noise period, s. In each period, a vehicle can have the noise of a different sample.
        parameters: samples of the vehicles.

    Raises:
        InputError: if the noise period is not a multiple of the period of a stream.
    """

    def declare(self, *, streams: Sequence[Stream], noise_period: float = math.inf, parameters: Samples) -> None:
        """Declare the ports and parameters of this system."""

        def states(samples: Samples) -> tuple[tuple[StreamState, ...], ...]:
            periods = samples.indices, *samples.later_indices

            def initial(stream: Stream, indices: Sequence[int]) -> StreamState:
                seed = samples.seed_of(stream.kind)
                return StreamState.of(stream_states(seed, indices, stream.kind, stream.name))

            return tuple([tuple([initial(stream, each) for each in periods]) for stream in streams])

        kinds = tuple(
            [
                (
                    stream.num_rows,
                    stream.distribution == RandomDistribution.kGaussian,
                    _ticks_in_period(noise_period, stream) if parameters.later_indices else math.inf,
                )
                for stream in streams
            ]
        )
        self.packed = {stream.name: Layout(tuple, (ROW,) * stream.num_rows, stream.num_rows) for stream in streams}
        parts = tuple(self.packed.values())
        layout = Layout(tuple, parts, sum(part.num_rows for part in parts))
        ticks = [CurrentTick(stream.period) for stream in streams]
        self.output("random", stream_numbers, self.parameter("streams", states), kinds, *ticks, layout=layout)


def _ticks_in_period(period: float, stream: Stream) -> float:
    """Return the number of ticks of a stream in a period.

    Raises:
        InputError: if the number is not whole.
    """
    number = period / stream.period
    if not abs(number - round(number)) < 1e-6:
        raise InputError(
            f"noise.period is {period:g} s, but must be a multiple of the period of {stream.name}, {stream.period:g} s"
        )
    return float(round(number))


def random_streams(systems: Mapping[str, Any], kind: StreamKind) -> dict[str, list[Stream]]:
    """Return the streams for the random input ports of each system, in the order of the ports.

    Streams are named after system and port, so that their numbers do not depend on other streams.

    Args:
        systems: systems by name; only a FleetSystem can have such ports.
        kind: purpose of the random numbers.
    """
    return {
        name: [
            Stream(f"{name}.{port}", kind, properties.num_rows, properties.distribution, properties.period)
            for port, properties in getattr(system, "random_inputs", {}).items()
        ]
        for name, system in systems.items()
    }


def export_streams(
    builder: DiagramBuilder, systems: Mapping[str, Any], streams: Mapping[str, Sequence[Stream]]
) -> None:
    """Export random input ports of systems as input ports of the diagram, under the names of their streams.

    Args:
        builder: builder with the systems.
        systems: systems by name.
        streams: streams from `random_streams`; systems without streams may be left out.
    """
    for name, system in systems.items():
        for stream in streams.get(name, ()):
            builder.ExportInput(system.GetInputPort(stream.name.removeprefix(f"{name}.")), stream.name)


def connect_noise(builder: DiagramBuilder, ports: Mapping[Stream, Any], samples: Samples) -> None:
    """Connect random input ports to noise sources, which are added to the builder.

    One source named `noise` serves all ports of a single vehicle. Every port of a fleet has its own source, since
    additional calls take less time than splitting a long output vector.

    Args:
        builder: builder with the systems of the ports.
        ports: random input port of each stream.
        samples: samples of the vehicles.
    """
    num_vehicles = len(samples.indices)
    if num_vehicles > 1:
        for stream, port in ports.items():
            source = NoiseSource(
                num_vehicles=num_vehicles, streams=[stream], noise_period=samples.period, parameters=samples
            )
            builder.Connect(builder.AddNamedSystem(f"noise_{stream.name}", source).get_output_port(), port)
    elif ports:
        source = NoiseSource(streams=list(ports), noise_period=samples.period, parameters=samples)
        outputs = split_output(builder, "noise", source)
        for stream, port in ports.items():
            builder.Connect(outputs[stream.name], port)


def numbers_of_tick(numbers: tuple[Row, ...], count: int, tick: Tick) -> tuple[Row, ...]:
    """Return the numbers of one tick, given the numbers of a period of `count` ticks."""
    num_rows = len(numbers) // count
    tick_number = 2.0 * tick.pair + where(tick.second, 1.0, 0.0)
    index = tick_number - count * nearest(tick_number / count - 0.5 + 0.5 / count)
    rows = numbers[:num_rows]
    for k in range(1, count):
        next_rows = numbers[k * num_rows : (k + 1) * num_rows]
        rows = tuple([where(index > k - 0.5, new, row) for new, row in zip(next_rows, rows, strict=True)])
    return rows


@fleet_system(float, AutoDiffXd)
class TickByTick(FleetSystem):
    """Converter from the random numbers of a whole period to the random numbers of each tick.

    .. pydrake_system::

        name: TickByTick
        input_ports:
        - numbers
        output_ports:
        - random

    Args:
        num_vehicles: number N of vehicles.
        stream: stream of the output.
        period: period of the input, s.
    """

    def declare(self, *, stream: Stream, period: float) -> None:
        """Declare the ports of this system."""
        count = round(period / stream.period)
        of_period, of_tick = (Layout(tuple, (ROW,) * rows, rows) for rows in (count * stream.num_rows, stream.num_rows))
        numbers = self.input("numbers", layout=of_period)
        self.output("random", numbers_of_tick, numbers, count, CurrentTick(stream.period), layout=of_tick)


def export_noise(
    builder: DiagramBuilder, ports: Mapping[Stream, Any], exported: ExportedRandomNumbers, num_vehicles: int
) -> None:
    """Export random input ports as input ports of the diagram, named `random.` followed by the name of the stream."""
    for stream, port in ports.items():
        system = TickByTick(num_vehicles=num_vehicles, stream=stream, period=exported.period)
        builder.Connect(builder.AddNamedSystem(f"random_{stream.name}", system).get_output_port(), port)
        builder.ExportInput(system.get_input_port(), f"{EXPORTED_PREFIX}{stream.name}")


def connect_random_sources(builder: DiagramBuilder, ports: Mapping[Stream, Any]) -> None:
    """Connect random input ports to Drake's random sources, which are added to the builder.

    Args:
        builder: builder with the systems of the ports.
        ports: random input port of each stream.
    """
    for stream, port in ports.items():
        source = RandomSource(stream.distribution, port.size(), stream.period)
        builder.AddNamedSystem(f"random_{stream.name}", source)
        builder.Connect(source.get_output_port(), port)
