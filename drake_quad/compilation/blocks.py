"""Leaf systems as the compiler sees them: which rows they hold, and what they compute of which.

A FleetSystem says all that by itself. Of Drake's own systems those are known that a fleet needs, which rename rows, add
them up or hold them.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from functools import reduce
from typing import Any, NamedTuple

import numpy as np
from pydrake.systems.framework import PortDataType
from pydrake.systems.primitives import (
    Adder,
    ConstantVectorSource,
    Demultiplexer,
    Gain,
    Multiplexer,
    PassThrough,
    TrajectorySource,
    ZeroOrderHold,
)

from drake_quad.compilation.trace import Around, Rows
from drake_quad.errors import InputError
from drake_quad.framework.broadcast import Broadcast
from drake_quad.framework.fleet_system import Computation, FleetSystem, Input, Parameter, StateGroup
from drake_quad.framework.formulas import TIME, TickOf, hashable_key, traced
from drake_quad.framework.records import ABSENT


class Work(NamedTuple):
    """What a block computes at an event.

    Attributes:
        compute: from what it sees, the rows that groups of its state will hold, by group.
        period: of the event, s; None for one when a simulation begins.
        unrestricted: whether it is done before the discrete updates of its instant.
        at_start: whether anything is done at time zero.
    """

    compute: Callable[[Around], dict[int, Rows]]
    period: float | None
    unrestricted: bool = False
    at_start: bool = True


class Block(ABC):
    """A leaf system.

    Args:
        system: that it is.

    Attributes:
        works: what it computes at events.
    """

    works: Sequence[Work] = ()

    def __init__(self, system: Any) -> None:
        self.system = system

    @property
    def signature(self) -> tuple[Any, ...]:
        """All that what it computes depends on, beside what it sees and the number of vehicles."""
        return type(self), *[work.period for work in self.works]

    @abstractmethod
    def output(self, index: int, around: Around) -> Rows:
        """The rows of an output port."""

    def passes(self, index: int) -> Sequence[int]:
        """The input ports on which an output port depends at once."""
        return range(self.system.num_input_ports())


def block_of(system: Any) -> Block | None:
    """The leaf system as the compiler sees it; None if it cannot."""
    kind = next((_BLOCKS[base] for base in type(system).__mro__ if base in _BLOCKS), None)
    if kind is not None:
        return kind(system) if has_vectors(system) and _begins_at_zero(system) else None
    if isinstance(system, FleetSystem) and _is_declared(system):
        return _Declared(system)
    return None


def why_not(system: Any) -> str:
    """Why a leaf system cannot be compiled."""
    if isinstance(system, FleetSystem):
        if "continuous" in system.states:
            return "its state is continuous"
        return "it declares ports, states or events by Drake's own methods"
    return "only systems that declare formulas can be, and the simplest of Drake's own"


def has_vectors(system: Any) -> bool:
    """Whether all of a system's ports hold vectors."""
    ports = [
        *map(system.get_input_port, range(system.num_input_ports())),
        *map(system.get_output_port, range(system.num_output_ports())),
    ]
    return all(port.get_data_type() == PortDataType.kVectorValued for port in ports)


def _begins_at_zero(system: Any) -> bool:
    timing = system.GetUniquePeriodicDiscreteUpdateAttribute()
    return timing is None or timing.offset_sec() == 0.0


def _is_declared(system: FleetSystem) -> bool:
    context = system.CreateDefaultContext()
    return (
        system.num_output_ports() == len(system.outputs)
        and context.num_discrete_state_groups() == len(system.states)
        and system.num_events == len(system.updates) + len(system.initializations)
        and not context.num_continuous_states()
        and not context.num_abstract_states()
    )


class _Declared(Block):
    """A FleetSystem."""

    def __init__(self, system: FleetSystem) -> None:
        super().__init__(system)
        works = [
            Work(_writing(update.computation), update.period, update.unrestricted, update.at_start)
            for update in system.updates
        ]
        self.works = [*works, *(Work(_writing(computation), None) for computation in system.initializations)]

    @property
    def signature(self) -> tuple[Any, ...]:
        """As for every block."""
        outputs = [_signature(each) for each in self.system.outputs.values()]
        updates = [(_signature(each.computation), *each[:1], *each[2:]) for each in self.system.updates]
        return *outputs, *updates, *map(_signature, self.system.initializations)

    def output(self, index: int, around: Around) -> Rows:
        (rows,) = _computed(self._shown(index), around)
        return rows

    def passes(self, index: int) -> Sequence[int]:
        return [int(read.index) for read in self._shown(index).reads if isinstance(read, Input)]

    def _shown(self, index: int) -> Computation:
        shown: Computation = self.system.outputs[self.system.get_output_port(index).get_name()]
        return shown


def _signature(shown: Computation) -> tuple[Any, ...]:
    """All that a computation depends on, beside what it reads."""
    reads: list[tuple[Any, ...]] = []
    for read in shown.reads:
        if isinstance(read, Input):
            reads.append(("input", int(read.index), read.layout, *hashable_key(read.absent)))
        elif isinstance(read, Parameter):
            reads.append(("parameter", int(read.index), read.layout))
        elif isinstance(read, StateGroup):
            reads.append(("state", _number(read), read.layout))
        else:
            reads.append(("constant", *hashable_key(read)))
    return shown.formula, *reads, *shown.results, *map(_number, shown.writes)


def _writing(computation: Computation) -> Callable[[Around], dict[int, Rows]]:
    groups = [_number(group) for group in computation.writes]
    return lambda around: dict(zip(groups, _computed(computation, around), strict=True))


def _computed(computation: Computation, around: Around) -> list[Rows]:
    """Return the rows of each result of a computation."""
    values = []
    for read in computation.reads:
        match read:
            case Input():
                rows = around.input(int(read.index))
                values.append(read.absent if rows is None else read.layout.build(rows))
            case Parameter():
                values.append(read.layout.build(around.parameter(int(read.index))))
            case StateGroup():
                values.append(read.layout.build(around.state(_number(read))))
            case TickOf():
                values.append(around.argument(read))
            case _:
                values.append(around.argument(read) if read is TIME else read)
    returned = iter(traced(computation.formula, values, computation.results))
    present = [layout for layout in computation.results if layout is not ABSENT]
    return [[next(returned) for _ in range(layout.num_rows)] for layout in present]


def _number(group: StateGroup) -> int:
    """The number of a group of the discrete state."""
    return int(group.index)  # type: ignore[arg-type]


class _Same(Block):
    """What leaves its rows as they are."""

    def output(self, index: int, around: Around) -> Rows:
        return _connected(around.input(0))


class _Demultiplexer(Block):
    @property
    def signature(self) -> tuple[Any, ...]:
        ports = [self.system.get_output_port(index).size() for index in range(self.system.num_output_ports())]
        return *super().signature, *(size // math.gcd(*ports) for size in ports)

    def output(self, index: int, around: Around) -> Rows:
        rows = _connected(around.input(0))
        unit = self.system.get_input_port().size() // len(rows)
        sizes = [self.system.get_output_port(other).size() for other in range(index + 1)]
        if any(size % unit for size in sizes):
            raise InputError(f"{self.system.get_name()} cannot be compiled: it takes the vehicles of a fleet apart")
        return rows[sum(sizes[:index]) // unit : sum(sizes) // unit]


class _Multiplexer(Block):
    def output(self, index: int, around: Around) -> Rows:
        inputs = (around.input(number) for number in range(self.system.num_input_ports()))
        return [row for rows in inputs for row in _connected(rows)]


class _Adder(Block):
    def output(self, index: int, around: Around) -> Rows:
        inputs = [_connected(around.input(number)) for number in range(self.system.num_input_ports())]
        return reduce(lambda total, rows: [a + b for a, b in zip(total, rows, strict=True)], inputs)


class _Gain(Block):
    @property
    def signature(self) -> tuple[Any, ...]:
        factors = [hashable_key(factor) for factor in self._factors]
        return *super().signature, *(factors[:1] if len(set(factors)) == 1 else factors)

    @property
    def _factors(self) -> list[float]:
        # Drake does not tell them.
        context = self.system.CreateDefaultContext()
        self.system.get_input_port().FixValue(context, np.ones(self.system.get_input_port().size()))
        factors: list[float] = self.system.get_output_port().Eval(context).tolist()
        return factors

    def output(self, index: int, around: Around) -> Rows:
        rows = _connected(around.input(0))
        factors = np.reshape(self._factors, (len(rows), -1))
        if (factors != factors[:, :1]).any():
            raise InputError(f"{self.system.get_name()} cannot be compiled: its gain differs from vehicle to vehicle")
        return [factor * row for factor, row in zip(factors[:, 0].tolist(), rows, strict=True)]


class _Constant(Block):
    def output(self, index: int, around: Around) -> Rows:
        return around.parameter(0)


class _Hold(Block):
    def __init__(self, system: ZeroOrderHold) -> None:
        super().__init__(system)
        period = system.GetUniquePeriodicDiscreteUpdateAttribute().period_sec()
        self.works = [Work(lambda around: {0: _connected(around.input(0))}, period)]

    def output(self, index: int, around: Around) -> Rows:
        return around.state(0)

    def passes(self, index: int) -> Sequence[int]:
        return ()


class _Trajectory(Block):
    @property
    def signature(self) -> tuple[Any, ...]:
        return *super().signature, self.system.get_output_port().size()

    def output(self, index: int, around: Around) -> Rows:
        return [around.source(index, element) for element in range(self.system.get_output_port().size())]


def _connected(rows: Rows | None) -> Rows:
    if rows is None:
        raise ValueError("an input port of one of Drake's systems is not connected")
    return rows


_BLOCKS: dict[type, Callable[[Any], Block]] = {
    Adder: _Adder,
    Broadcast: _Same,
    ConstantVectorSource: _Constant,
    Demultiplexer: _Demultiplexer,
    Gain: _Gain,
    Multiplexer: _Multiplexer,
    PassThrough: _Same,
    TrajectorySource: _Trajectory,
    ZeroOrderHold: _Hold,
}
