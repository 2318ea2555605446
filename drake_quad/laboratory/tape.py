"""Random numbers for the random input ports of a fleet's systems."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from pydrake.common import RandomDistribution
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import DiagramBuilder

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


class Tape:
    """The random numbers of one port: rows for every vehicle at every tick.

    What stands at a tick depends on the seed, the samples, the stream and the tick alone. A block of ticks is kept at a
    time.

    Args:
        samples: that the N vehicles fly.
        kind: of random numbers.
        name: of the stream.
        rows: at each tick.
        period: of the ticks, s.
        distribution: standard normal (kGaussian), or uniform from 0 to 1 (kUniform).
    """

    def __init__(
        self, samples: Samples, *, kind: Kind, name: str, rows: int, period: float, distribution: RandomDistribution
    ) -> None:
        self.rows, self._period, self._normal = rows, period, distribution == RandomDistribution.kGaussian
        self._states = stream_states(samples.seed, samples.numbers, kind, name)
        self._ticks = 2 * max(1, _BLOCK_SIZE // (rows * len(samples.numbers)))
        self._number, self._block = -1, np.empty((0, 0))

    def at(self, time: float) -> np.ndarray:
        """The (rows · N,) numbers at the tick nearest to a time from 0 on (s), row after row."""
        number, place = divmod(round(time / self._period), self._ticks)
        if number != self._number:
            self._number, self._block = number, self._made(number)
        numbers: np.ndarray = self._block[place]
        return numbers

    def _made(self, number: int) -> np.ndarray:
        """The (ticks, rows · N) numbers of a block."""
        if not self._normal:
            count = self._ticks * self.rows
            return uniform_numbers(self._states, number * count, count).reshape(self._ticks, -1)
        # Normal numbers come in pairs: one for a tick, one for the next.
        count = self._ticks * self.rows // 2
        pairs = normal_pairs(self._states, number * count, count).reshape(2, self._ticks // 2, -1)
        return pairs.swapaxes(0, 1).reshape(self._ticks, -1)


@fleet_system(float, AutoDiffXd)
class TapePlayer(FleetSystem):
    """Plays tapes, tick by tick.

    .. pydrake_system::

        name: TapePlayer
        output_ports:
        - random

    The output packs the rows of all tapes, under their names. What is out at a time stands at the nearest tick;
    systems read at ticks. The only abstract parameter of the context is the tuple of tapes.

    Args:
        num_vehicles: N.
        tapes: by name.
    """

    def declare(self, *, num_vehicles: int = 1, tapes: Mapping[str, Tape]) -> None:
        """Declares the system; see the class for the arguments."""
        ends = np.cumsum([tape.rows * num_vehicles for tape in tapes.values()]).tolist()
        self._places = [slice(first, last) for first, last in zip([0, *ends], ends, strict=False)]
        self._tapes = self.DeclareAbstractParameter(AbstractValue.Make(tuple(tapes.values())))
        uses = {self.time_ticket(), self.all_parameters_ticket()}
        self.packed_output("random", {name: tape.rows for name, tape in tapes.items()}, self._calc, uses=uses)

    def _calc(self, context: Any, output: Any) -> None:
        tapes = context.get_abstract_parameter(self._tapes).get_value()
        if self.scalar is float:
            time, values = context.get_time(), output.get_mutable_value()
            for place, tape in zip(self._places, tapes):
                values[place] = tape.at(time)
        else:
            time = context.get_time().value()
            output.SetFromVector(np.concatenate([tape.at(time) for tape in tapes]))


def connect_tapes(builder: DiagramBuilder, systems: Mapping[str, Any], samples: Samples, kind: Kind) -> None:
    """Connects all random input ports of some systems to a tape player, which is added under the name `tapes`.

    For a fleet every port gets a player of its own: another call costs less than to take many rows apart.

    A stream is called after its system and port, so that it stays as it is when others come or go.

    Args:
        builder: that the player is added to.
        systems: by name; those that have random input ports take new numbers at every `period` of theirs.
        samples: that the vehicles fly.
        kind: of the random numbers.
    """
    tapes, ports = {}, {}
    for name, system in systems.items():
        for port_name, distribution in getattr(system, "random_inputs", {}).items():
            stream_name = f"{name}.{port_name}"
            port = ports[stream_name] = system.GetInputPort(port_name)
            tapes[stream_name] = Tape(
                samples,
                kind=kind,
                name=stream_name,
                rows=port.size() // system.num_vehicles,
                period=system.period,
                distribution=distribution,
            )
    n = len(samples.numbers)
    if n > 1:
        for name, tape in tapes.items():
            player = builder.AddNamedSystem(f"tape_{name}", TapePlayer(num_vehicles=n, tapes={name: tape}))
            builder.Connect(player.get_output_port(), ports[name])
    elif tapes:
        played = split_output(builder, "tapes", TapePlayer(tapes=tapes))
        for name, port in ports.items():
            builder.Connect(played[name], port)
