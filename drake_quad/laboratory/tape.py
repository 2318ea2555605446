"""Random numbers for the random input ports of a fleet's systems."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from pydrake.common import RandomDistribution
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import RandomSource

from drake_quad.fleet import AutoDiffXd, FleetSystem, fleet_system, split_output
from drake_quad.randomness import Kind, normal_pairs, stream_states, uniform_numbers

# About twice as many numbers are made at a time: enough to hide NumPy's overhead, few enough for the cache.
_BLOCK_SIZE = 2048


class Samples(NamedTuple):
    """The samples of a study that the vehicles of a fleet fly.

    Attributes:
        seed: of the study.
        numbers: of the samples, one for each vehicle.
    """

    seed: int
    numbers: Sequence[int]


class Stream(NamedTuple):
    """Random numbers for one port.

    Attributes:
        name: which tells the stream from others of its kind.
        kind: of random numbers.
        rows: at each tick.
        distribution: standard normal (kGaussian), or uniform from 0 to 1 (kUniform).
    """

    name: str
    kind: Kind
    rows: int
    distribution: RandomDistribution


class Tape:
    """The random numbers of some streams: rows for every vehicle at every tick.

    What stands at a tick depends on the seed, the sample, the stream and the tick alone. A block of ticks is kept at a
    time.

    Args:
        samples: that the N vehicles fly.
        streams: one after another.
        period: of the ticks, s.
    """

    def __init__(self, samples: Samples, streams: Sequence[Stream], *, period: float) -> None:
        self.num_vehicles, self.streams, self._period = len(samples.numbers), tuple(streams), period
        self.size = sum(stream.rows for stream in streams) * self.num_vehicles
        self._states = [stream_states(samples.seed, samples.numbers, stream.kind, stream.name) for stream in streams]
        self._ticks = 2 * max(1, _BLOCK_SIZE // self.size)
        self._number, self._block = -1, np.empty((0, 0))

    def of(self, samples: Samples) -> "Tape":
        """The tape of the same streams for other samples."""
        return Tape(samples, self.streams, period=self._period)

    def at(self, time: float) -> np.ndarray:
        """The (rows · N,) numbers at the tick nearest to a time from 0 on (s), row after row."""
        number, place = divmod(round(time / self._period), self._ticks)
        if number != self._number:
            made = [self._made(stream, states, number) for stream, states in zip(self.streams, self._states)]
            self._number, self._block = number, np.hstack(made) if len(made) > 1 else made[0]
        numbers: np.ndarray = self._block[place]
        return numbers

    def _made(self, stream: Stream, states: np.ndarray, number: int) -> np.ndarray:
        """The (ticks, rows · N) numbers of a stream in a block."""
        count = self._ticks * stream.rows
        if stream.distribution == RandomDistribution.kUniform:
            return uniform_numbers(states, number * count, count).reshape(self._ticks, -1)
        # Normal numbers come in pairs: one for a tick, one for the next.
        count //= 2
        pairs = normal_pairs(states, number * count, count).reshape(2, self._ticks // 2, -1)
        return pairs.swapaxes(0, 1).reshape(self._ticks, -1)


@fleet_system(float, AutoDiffXd)
class TapePlayer(FleetSystem):
    """Plays tapes, tick by tick.

    .. pydrake_system::

        name: TapePlayer
        output_ports:
        - random

    The output packs the rows of all streams, under their names. What is out at a time stands at the nearest tick;
    systems read at ticks. The only abstract parameter of the context is the tuple of tapes.

    Args:
        num_vehicles: N.
        tapes: to play, for that many vehicles.
    """

    def declare(self, *, num_vehicles: int = 1, tapes: Sequence[Tape]) -> None:
        """Declares the system; see the class for the arguments."""
        ends = np.cumsum([tape.size for tape in tapes]).tolist()
        self._places = [slice(first, last) for first, last in zip([0, *ends], ends, strict=False)]
        self._tapes = self.DeclareAbstractParameter(AbstractValue.Make(tuple(tapes)))
        uses = {self.time_ticket(), self.all_parameters_ticket()}
        parts = {stream.name: stream.rows for tape in tapes for stream in tape.streams}
        self.packed_output("random", parts, self._calc, uses=uses)

    def put_samples(self, context: Any, samples: Samples) -> None:
        """Puts the tapes of other samples, as many, into a context."""
        tapes = context.get_mutable_abstract_parameter(self._tapes)
        tapes.set_value(tuple(tape.of(samples) for tape in tapes.get_value()))

    def _calc(self, context: Any, output: Any) -> None:
        tapes = context.get_abstract_parameter(self._tapes).get_value()
        if self.scalar is float:
            time, values = context.get_time(), output.get_mutable_value()
            for place, tape in zip(self._places, tapes):
                values[place] = tape.at(time)
        else:
            time = context.get_time().value()
            output.SetFromVector(np.concatenate([tape.at(time) for tape in tapes]))


class RandomPort(NamedTuple):
    """An input port for random numbers.

    Attributes:
        port: of the system, or the one of a diagram around it to which it is exported.
        stream: of its numbers.
        period: after which it takes new ones, s.
    """

    port: Any
    stream: Stream
    period: float


def random_ports(systems: Mapping[str, Any], kind: Kind) -> list[RandomPort]:
    """All random input ports of some systems.

    A stream is called after its system and port, so that it stays as it is when others come or go.

    Args:
        systems: by name; those with such ports are FleetSystems that take new numbers at every `period` of theirs.
        kind: of the random numbers.
    """
    found = []
    for name, system in systems.items():
        for port_name, distribution in getattr(system, "random_inputs", {}).items():
            port = system.GetInputPort(port_name)
            stream = Stream(f"{name}.{port_name}", kind, port.size() // system.num_vehicles, distribution)
            found.append(RandomPort(port, stream, system.period))
    return found


def connect_tapes(builder: DiagramBuilder, ports: Sequence[RandomPort], samples: Samples) -> None:
    """Connects random input ports to tape players, which are added to the builder.

    A lone vehicle has one player, `tapes`, with a tape for each period. For a fleet every port gets a player of its
    own: another call costs less than to take many rows apart.
    """
    num_vehicles = len(samples.numbers)
    if num_vehicles > 1:
        for port, stream, period in ports:
            tape = Tape(samples, [stream], period=period)
            player = builder.AddNamedSystem(f"tape_{stream.name}", TapePlayer(num_vehicles=num_vehicles, tapes=[tape]))
            builder.Connect(player.get_output_port(), port)
    elif ports:
        tapes = [
            Tape(samples, [stream for _, stream, other in ports if other == period], period=period)
            for period in sorted({each.period for each in ports})
        ]
        played = split_output(builder, "tapes", TapePlayer(tapes=tapes))
        for port, stream, _ in ports:
            builder.Connect(played[stream.name], port)


def connect_random_sources(builder: DiagramBuilder, ports: Sequence[RandomPort]) -> None:
    """Connects random input ports to Drake's random sources, which are added to the builder."""
    for port, stream, period in ports:
        source = RandomSource(stream.distribution, port.size(), period)
        builder.AddNamedSystem(f"random_{stream.name}", source)
        builder.Connect(source.get_output_port(), port)
