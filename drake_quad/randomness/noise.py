"""Sources of random numbers for the random input ports of a fleet's systems."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from pydrake.common import RandomDistribution
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import RandomSource

from drake_quad.framework.elementary import nearest, where
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, TickOf, fleet_system
from drake_quad.framework.formulas import Tick
from drake_quad.framework.records import ROW, Layout
from drake_quad.framework.wiring import split_output
from drake_quad.randomness.streams import Seeds, StreamKind, StreamState, random_numbers, stream_states
from drake_quad.signals import Row

# What input ports of exported random numbers are called, before the names of their streams.
EXPORTED = "random."


class Samples(NamedTuple):
    """The samples of a study that the vehicles of a fleet fly.

    Attributes:
        seed: of all samples, or of each.
        numbers: one for each vehicle.
    """

    seed: Seeds
    numbers: Sequence[int]


class Exported(NamedTuple):
    """Stands for random numbers that are inputs of the diagram: all of a period at its beginning, tick by tick.

    Attributes:
        period: s, a multiple of the periods of all streams.
    """

    period: float


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
    kind: StreamKind
    num_rows: int
    distribution: RandomDistribution
    period: float


def stream_numbers(
    states: tuple[StreamState, ...], kinds: Sequence[tuple[int, bool]], *ticks: Tick
) -> tuple[tuple[Row, ...], ...]:
    """The numbers of some streams at a tick of each; by the number of its rows, and whether it is a normal one."""
    return tuple([random_numbers(state, tick, *kind) for state, kind, tick in zip(states, kinds, ticks, strict=True)])


@fleet_system(float, AutoDiffXd)
class NoiseSource(FleetSystem):
    """The random numbers of some streams, tick by tick.

    .. pydrake_system::

        name: NoiseSource
        output_ports:
        - random

    The output packs the rows of all streams, under their names. What is out at a time stands at the nearest tick;
    systems read at ticks. What stands at a tick depends on the seed, the sample, the stream and the tick alone. The
    only parameter of the context is `streams`.

    Args:
        num_vehicles: N.
        streams: one after another.
        numbers: the samples that the vehicles fly.
    """

    def declare(self, *, streams: Sequence[Stream], numbers: Samples) -> None:
        """Declare the system."""

        def states(samples: Samples) -> tuple[StreamState, ...]:
            seed, sample_numbers = samples
            words = (stream_states(seed, sample_numbers, stream.kind, stream.name) for stream in streams)
            return tuple([StreamState.of(each) for each in words])

        kinds = tuple([(stream.num_rows, stream.distribution == RandomDistribution.kGaussian) for stream in streams])
        self.packed = {stream.name: Layout(tuple, (ROW,) * stream.num_rows, stream.num_rows) for stream in streams}
        parts = tuple(self.packed.values())
        layout = Layout(tuple, parts, sum(part.num_rows for part in parts))
        ticks = [TickOf(stream.period) for stream in streams]
        self.output("random", stream_numbers, self.parameter("streams", states), kinds, *ticks, layout=layout)


def random_streams(systems: Mapping[str, Any], kind: StreamKind) -> dict[str, list[Stream]]:
    """Return the streams for the random input ports of some systems, in the order of the ports; none for some systems.

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


def export_streams(
    builder: DiagramBuilder, systems: Mapping[str, Any], streams: Mapping[str, Sequence[Stream]]
) -> None:
    """Make random input ports of systems input ports of the diagram, under the names of their streams.

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


def of_this_tick(numbers: tuple[Row, ...], count: int, tick: Tick) -> tuple[Row, ...]:
    """Return the numbers for one tick out of the numbers for a period of `count` ticks."""
    num_rows = len(numbers) // count
    number = 2.0 * tick.pair + where(tick.second, 1.0, 0.0)
    place = number - count * nearest(number / count - 0.5 + 0.5 / count)
    rows = numbers[:num_rows]
    for k in range(1, count):
        here = numbers[k * num_rows : (k + 1) * num_rows]
        rows = tuple([where(place > k - 0.5, new, row) for new, row in zip(here, rows, strict=True)])
    return rows


@fleet_system(float, AutoDiffXd)
class TickByTick(FleetSystem):
    """A stream whose numbers of a whole period come in at once.

    .. pydrake_system::

        name: TickByTick
        input_ports:
        - numbers
        output_ports:
        - random

    Args:
        num_vehicles: N.
        stream: that goes out.
        period: of what comes in, s.
    """

    def declare(self, *, stream: Stream, period: float) -> None:
        """Declare the system."""
        count = round(period / stream.period)
        whole, one = (Layout(tuple, (ROW,) * rows, rows) for rows in (count * stream.num_rows, stream.num_rows))
        numbers = self.input("numbers", layout=whole)
        self.output("random", of_this_tick, numbers, count, TickOf(stream.period), layout=one)


def export_noise(builder: DiagramBuilder, ports: Mapping[Stream, Any], exported: Exported, num_vehicles: int) -> None:
    """Make the numbers of random input ports input ports of the diagram, called `random.` and after their streams."""
    for stream, port in ports.items():
        system = TickByTick(num_vehicles=num_vehicles, stream=stream, period=exported.period)
        builder.Connect(builder.AddNamedSystem(f"random_{stream.name}", system).get_output_port(), port)
        builder.ExportInput(system.get_input_port(), f"{EXPORTED}{stream.name}")


def connect_random_sources(builder: DiagramBuilder, ports: Mapping[Stream, Any]) -> None:
    """Connect random input ports to Drake's random sources, which are added to the builder.

    Args:
        builder: which has the ports' systems.
        ports: for each stream.
    """
    for stream, port in ports.items():
        source = RandomSource(stream.distribution, port.size(), stream.period)
        builder.AddNamedSystem(f"random_{stream.name}", source)
        builder.Connect(source.get_output_port(), port)
