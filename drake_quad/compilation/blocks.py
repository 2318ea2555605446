"""Blocks: leaf systems that can be compiled, with the formulas of their outputs and updates.

A FleetSystem declares its formulas. The compiler also supports the Drake systems that select, join, add, scale or hold
components of a vector.
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

from drake_quad.compilation.trace import BlockView, Rows
from drake_quad.errors import InputError
from drake_quad.framework.broadcast import Broadcast
from drake_quad.framework.fleet_system import REQUIRED, Computation, FleetSystem, Input, Parameter, StateGroup
from drake_quad.framework.formulas import TIME, CurrentTick, hashable_key, trace_formula
from drake_quad.framework.records import ABSENT


class BlockUpdate(NamedTuple):
    """Update of a block's state.

    Attributes:
        compute: function that takes the `BlockView` of a trace, and returns the new values of the state groups that
            change, by group number.
        period: period of the update, s; None for an update at the start of a simulation.
        unrestricted: True for an update that precedes all discrete updates of the same instant.
        at_start: True if the update also takes place at time zero.
    """

    compute: Callable[[BlockView], dict[int, Rows]]
    period: float | None
    unrestricted: bool = False
    at_start: bool = True


class Block(ABC):
    """Leaf system that the compiler supports.

    Attributes:
        system: leaf system of Drake.
        updates: updates of the state.
    """

    updates: Sequence[BlockUpdate] = ()

    def __init__(self, system: Any) -> None:
        self.system = system

    @property
    def signature(self) -> tuple[Any, ...]:
        """Hashable key. Blocks with equal keys have the same computations, for any number of vehicles."""
        return type(self), *[work.period for work in self.updates]

    @abstractmethod
    def output(self, index: int, view: BlockView) -> Rows:
        """Return the components of the signal at an output port of this block.

        Args:
            index: index of the output port.
            view: inputs, states and parameters of this block in a `Trace`.
        """

    def feedthrough(self, index: int) -> Sequence[int]:
        """Return the indices of the input ports with direct feedthrough to an output port."""
        return range(self.system.num_input_ports())


def find_block(system: Any) -> Block | None:
    """Return the block of a leaf system; None if the system cannot be compiled."""
    kind = next((_BLOCK_TYPES[base] for base in type(system).__mro__ if base in _BLOCK_TYPES), None)
    if kind is not None:
        return kind(system) if has_vectors(system) and _starts_at_zero(system) else None
    if isinstance(system, FleetSystem) and _is_declared(system):
        return _FleetSystemBlock(system)
    return None


def reason_not_compilable(system: Any) -> str:
    """Return the reason why a leaf system cannot be compiled, for an error message."""
    if isinstance(system, FleetSystem):
        if "continuous" in system.states:
            return "its state is continuous"
        return "it declares ports, states or events directly with Drake's methods"
    return "only systems that declare formulas, and some simple systems of Drake, can be compiled"


def has_vectors(system: Any) -> bool:
    """Return whether all ports of a system are vector-valued."""
    ports = [
        *map(system.get_input_port, range(system.num_input_ports())),
        *map(system.get_output_port, range(system.num_output_ports())),
    ]
    return all(port.get_data_type() == PortDataType.kVectorValued for port in ports)


def _starts_at_zero(system: Any) -> bool:
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


class _FleetSystemBlock(Block):
    """Block of a FleetSystem, with the computations that the system declares."""

    def __init__(self, system: FleetSystem) -> None:
        super().__init__(system)
        updates = [
            BlockUpdate(_update_function(update.computation), update.period, update.unrestricted, update.at_start)
            for update in system.updates
        ]
        self.updates = [
            *updates,
            *(BlockUpdate(_update_function(computation), None) for computation in system.initializations),
        ]

    @property
    def signature(self) -> tuple[Any, ...]:
        """Hashable key of the computations; see `Block`."""
        outputs = [_signature(each) for each in self.system.outputs.values()]
        updates = [(_signature(each.computation), *each[:1], *each[2:]) for each in self.system.updates]
        return *outputs, *updates, *map(_signature, self.system.initializations)

    def output(self, index: int, view: BlockView) -> Rows:
        (rows,) = _results(self._computation(index), view)
        return rows

    def feedthrough(self, index: int) -> Sequence[int]:
        return [int(read.index) for read in self._computation(index).reads if isinstance(read, Input)]

    def _computation(self, index: int) -> Computation:
        computation: Computation = self.system.outputs[self.system.get_output_port(index).get_name()]
        return computation


def _signature(computation: Computation) -> tuple[Any, ...]:
    """Return a key of a computation: its formula, and the types and layouts of its arguments and results."""
    reads: list[tuple[Any, ...]] = []
    for read in computation.reads:
        if isinstance(read, Input):
            reads.append(("input", int(read.index), read.layout, *hashable_key(read.absent)))
        elif isinstance(read, Parameter):
            reads.append(("parameter", int(read.index), read.layout))
        elif isinstance(read, StateGroup):
            reads.append(("state", _group_number(read), read.layout))
        else:
            reads.append(("constant", *hashable_key(read)))
    return computation.formula, *reads, *computation.results, *map(_group_number, computation.writes)


def _update_function(computation: Computation) -> Callable[[BlockView], dict[int, Rows]]:
    groups = [_group_number(group) for group in computation.writes]
    return lambda view: dict(zip(groups, _results(computation, view), strict=True))


def _results(computation: Computation, view: BlockView) -> list[Rows]:
    """Run the formula of a computation on symbols, and return the rows of each result."""
    values = []
    for read in computation.reads:
        match read:
            case Input():
                index = int(read.index)
                rows = view.required_input(index) if read.absent is REQUIRED else view.input(index)
                values.append(read.absent if rows is None else read.layout.build(rows))
            case Parameter():
                values.append(read.layout.build(view.parameter(int(read.index))))
            case StateGroup():
                values.append(read.layout.build(view.state(_group_number(read))))
            case CurrentTick():
                values.append(view.argument(read))
            case _:
                values.append(view.argument(read) if read is TIME else read)
    returned = iter(trace_formula(computation.formula, values, computation.results))
    present = [layout for layout in computation.results if layout is not ABSENT]
    return [[next(returned) for _ in range(layout.num_rows)] for layout in present]


def _group_number(group: StateGroup) -> int:
    """Return the index of a discrete state group in the context of its system."""
    return int(group.index)  # type: ignore[arg-type]


class _PassThroughBlock(Block):
    """Block of a system whose output equals its input."""

    def output(self, index: int, view: BlockView) -> Rows:
        return view.required_input(0)


class _Demultiplexer(Block):
    @property
    def signature(self) -> tuple[Any, ...]:
        ports = [self.system.get_output_port(index).size() for index in range(self.system.num_output_ports())]
        return *super().signature, *(size // math.gcd(*ports) for size in ports)

    def output(self, index: int, view: BlockView) -> Rows:
        rows = view.required_input(0)
        unit = self.system.get_input_port().size() // len(rows)
        sizes = [self.system.get_output_port(other).size() for other in range(index + 1)]
        if any(size % unit for size in sizes):
            raise InputError(
                f"{self.system.get_name()} cannot be compiled: an output contains only some vehicles of the fleet"
            )
        return rows[sum(sizes[:index]) // unit : sum(sizes) // unit]


class _Multiplexer(Block):
    def output(self, index: int, view: BlockView) -> Rows:
        inputs = (view.required_input(number) for number in range(self.system.num_input_ports()))
        return [row for rows in inputs for row in rows]


class _Adder(Block):
    def output(self, index: int, view: BlockView) -> Rows:
        inputs = [view.required_input(number) for number in range(self.system.num_input_ports())]
        return reduce(lambda total, rows: [a + b for a, b in zip(total, rows, strict=True)], inputs)


class _Gain(Block):
    @property
    def signature(self) -> tuple[Any, ...]:
        factors = [hashable_key(factor) for factor in self._factors]
        return *super().signature, *(factors[:1] if len(set(factors)) == 1 else factors)

    @property
    def _factors(self) -> list[float]:
        # Drake's Gain has no method that returns its factors, so the gain is evaluated for inputs of 1.
        context = self.system.CreateDefaultContext()
        self.system.get_input_port().FixValue(context, np.ones(self.system.get_input_port().size()))
        factors: list[float] = self.system.get_output_port().Eval(context).tolist()
        return factors

    def output(self, index: int, view: BlockView) -> Rows:
        rows = view.required_input(0)
        factors = np.reshape(self._factors, (len(rows), -1))
        if (factors != factors[:, :1]).any():
            raise InputError(f"{self.system.get_name()} cannot be compiled: its gain differs from vehicle to vehicle")
        return [factor * row for factor, row in zip(factors[:, 0].tolist(), rows, strict=True)]


class _Constant(Block):
    def output(self, index: int, view: BlockView) -> Rows:
        return view.parameter(0)


class _Hold(Block):
    def __init__(self, system: ZeroOrderHold) -> None:
        super().__init__(system)
        period = system.GetUniquePeriodicDiscreteUpdateAttribute().period_sec()
        self.updates = [BlockUpdate(lambda view: {0: view.required_input(0)}, period)]

    def output(self, index: int, view: BlockView) -> Rows:
        return view.state(0)

    def feedthrough(self, index: int) -> Sequence[int]:
        return ()


class _Trajectory(Block):
    @property
    def signature(self) -> tuple[Any, ...]:
        return *super().signature, self.system.get_output_port().size()

    def output(self, index: int, view: BlockView) -> Rows:
        return [view.source(index, element) for element in range(self.system.get_output_port().size())]


_BLOCK_TYPES: dict[type, Callable[[Any], Block]] = {
    Adder: _Adder,
    Broadcast: _PassThroughBlock,
    ConstantVectorSource: _Constant,
    Demultiplexer: _Demultiplexer,
    Gain: _Gain,
    Multiplexer: _Multiplexer,
    PassThrough: _PassThroughBlock,
    TrajectorySource: _Trajectory,
    ZeroOrderHold: _Hold,
}
