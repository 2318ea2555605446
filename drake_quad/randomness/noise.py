"""Sources of random numbers for the random input ports of a fleet's systems."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from pydrake.common import RandomDistribution
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector_, Context, DiagramBuilder
from pydrake.systems.primitives import RandomSource

from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.framework.records import ROW, Layout
from drake_quad.framework.wiring import split_output
from drake_quad.randomness.streams import Kind, normal_pairs, stream_states, uniform_numbers

# About twice as many numbers are made at a time: enough to hide NumPy's overhead, few enough for the cache.
_BLOCK_SIZE = 2048


class Samples(NamedTuple):
    """The samples of a study that the vehicles of a fleet fly.

    Attributes:
        seed: of all samples.
        numbers: one for each vehicle.
    """

    seed: int
    numbers: Sequence[int]


class Stream(NamedTuple):
    """Random numbers for one port.

    Attributes:
        name: which tells the stream from others of its kind.
        kind: of random numbers.
        num_rows: at each tick.
        distribution: standard normal (kGaussian), or uniform from 0 to 1 (kUniform).
        period: of the ticks, s.
    """

    name: str
    kind: Kind
    num_rows: int
    distribution: RandomDistribution
    period: float


class StreamNumbers:
    """The numbers of a stream: rows for every vehicle at every tick.

    What stands at a tick depends on the seed, the sample, the stream and the tick alone. A block of ticks is kept at a
    time.

    Args:
        stream: of which they are.
        samples: that the N vehicles fly.
    """

    def __init__(self, stream: Stream, samples: Samples) -> None:
        self._stream, num_vehicles = stream, len(samples.numbers)
        self._states = stream_states(samples.seed, samples.numbers, stream.kind, stream.name)
        self._ticks = 2 * max(1, _BLOCK_SIZE // (stream.num_rows * num_vehicles))
        self._number, self._block = -1, np.empty((0, 0))

    def at(self, time: float) -> np.ndarray:
        """The (rows · N,) numbers at the tick nearest to a time from 0 on (s), row after row."""
        number, place = divmod(round(time / self._stream.period), self._ticks)
        if number != self._number:
            self._number, self._block = number, self._made(number)
        numbers: np.ndarray = self._block[place]
        return numbers

    def _made(self, number: int) -> np.ndarray:
        """The (ticks, rows · N) numbers of a block."""
        count = self._ticks * self._stream.num_rows
        if self._stream.distribution == RandomDistribution.kUniform:
            return uniform_numbers(self._states, number * count, count).reshape(self._ticks, -1)
        # Normal numbers come in pairs: one for a tick, one for the next.
        count //= 2
        pairs = normal_pairs(self._states, number * count, count).reshape(2, self._ticks // 2, -1)
        return pairs.swapaxes(0, 1).reshape(self._ticks, -1)


@fleet_system(float, AutoDiffXd)
class NoiseSource(FleetSystem):
    """The random numbers of some streams, tick by tick.

    .. pydrake_system::

        name: NoiseSource
        output_ports:
        - random

    The output packs the rows of all streams, under their names. What is out at a time stands at the nearest tick;
    systems read at ticks. The only abstract parameter of the context is the tuple of their `StreamNumbers`.

    Args:
        num_vehicles: N.
        streams: one after another.
        numbers: the samples that the vehicles fly.
    """

    def declare(self, *, streams: Sequence[Stream], numbers: Samples) -> None:
        """Declares the system."""
        self.streams = tuple(streams)
        self._numbers_of_streams = self.DeclareAbstractParameter(AbstractValue.Make(self._made(numbers)))
        self.packed = {stream.name: Layout(tuple, (ROW,) * stream.num_rows, stream.num_rows) for stream in self.streams}
        size = sum(stream.num_rows for stream in self.streams) * self.num_vehicles
        uses = {self.time_ticket(), self.all_parameters_ticket()}
        self.DeclareVectorOutputPort("random", BasicVector_[self.scalar](size), self._calc, uses)

    def reset(self, context: Context, numbers: Samples) -> None:
        """Takes the numbers of other samples."""
        context.get_mutable_abstract_parameter(self._numbers_of_streams).set_value(self._made(numbers))

    def _made(self, samples: Samples) -> tuple[StreamNumbers, ...]:
        return tuple([StreamNumbers(stream, samples) for stream in self.streams])

    def _calc(self, context: Context, output: Any) -> None:
        made = context.get_abstract_parameter(self._numbers_of_streams).get_value()
        if self.scalar is float:
            time, values, first = context.get_time(), output.get_mutable_value(), 0
            for stream in made:
                numbers = stream.at(time)
                values[first : first + numbers.size] = numbers
                first += numbers.size
        else:
            time = context.get_time().value()
            output.SetFromVector(np.concatenate([stream.at(time) for stream in made]))


def random_streams(systems: Mapping[str, Any], kind: Kind) -> dict[str, list[Stream]]:
    """The streams for the random input ports of some systems, in the order of the ports; none for some systems.

    A stream is called after its system and port, so that its numbers do not change when other streams come or go.

    Args:
        systems: by name; only a FleetSystem can have such ports.
        kind: of the random numbers.
    """
    return {
        name: [
            Stream(f"{name}.{port}", kind, asked.num_rows, asked.distribution, asked.period)
            for port, asked in getattr(system, "random_inputs", {}).items()
        ]
        for name, system in systems.items()
    }


def connect_noise(builder: DiagramBuilder, ports: Mapping[Stream, Any], samples: Samples) -> None:
    """Connects random input ports to noise sources, which are added to the builder.

    A lone vehicle has one source, `noise`. For a fleet every port gets a source of its own: another call costs less
    than to take many rows apart.

    Args:
        builder: which has the ports' systems.
        ports: for each stream.
        samples: that the vehicles fly.
    """
    num_vehicles = len(samples.numbers)
    if num_vehicles > 1:
        for stream, port in ports.items():
            source = NoiseSource(num_vehicles=num_vehicles, streams=[stream], numbers=samples)
            builder.Connect(builder.AddNamedSystem(f"noise_{stream.name}", source).get_output_port(), port)
    elif ports:
        made = split_output(builder, "noise", NoiseSource(streams=list(ports), numbers=samples))
        for stream, port in ports.items():
            builder.Connect(made[stream.name], port)


def connect_random_sources(builder: DiagramBuilder, ports: Mapping[Stream, Any]) -> None:
    """Connects random input ports to Drake's random sources, which are added to the builder.

    Args:
        builder: which has the ports' systems.
        ports: for each stream.
    """
    for stream, port in ports.items():
        source = RandomSource(stream.distribution, port.size(), stream.period)
        builder.AddNamedSystem(f"random_{stream.name}", source)
        builder.Connect(source.get_output_port(), port)
