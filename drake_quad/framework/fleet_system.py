"""A LeafSystem that carries many vehicles, says what it computes, and converts its scalar type.

A port, parameter or state with k rows has k N elements, row after row (C order, shape (k, N)); for one vehicle that is
the plain k-vector. What its rows mean is a record: `drake_quad.signals` has those of the ports.

A system declares its ports, parameters and states, and what follows from which of them by which formula:

    measurement, reference = self.input("measurement"), self.input("reference")
    gains = self.parameter("gains", lambda gains: gains)
    self.output("acceleration_command", pd_law, measurement, reference, gains)

Drake's callbacks follow from the declaration, for every scalar type, and so does the machine code that runs for plain
numbers. A formula takes and returns records whose fields are rows, numbers for one vehicle and arrays for a fleet; it
is made of arithmetic, comparisons and `drake_quad.framework.elementary`.

`declare` is told structure, that is which ports and events there are, apart from `numbers`, which may differ from
vehicle to vehicle. Parameters and states are recipes: functions of the numbers. `FleetSystem.reset` follows them once
more, so that a diagram that is built flies again with other numbers.
"""

import inspect
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from types import MethodType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from pydrake.autodiffutils import AutoDiffXd
from pydrake.common import RandomDistribution, cpp_template
from pydrake.symbolic import Expression
from pydrake.systems.framework import (
    BasicVector,
    BasicVector_,
    Context,
    DiscreteStateIndex,
    InputPortIndex,
    LeafSystem_,
    NumericParameterIndex,
)
from pydrake.systems.scalar_conversion import TemplateSystem

from drake_quad.errors import entry
from drake_quad.framework.elementary import identity
from drake_quad.framework.formulas import INTERPRETED, TIME, TickOf, interpret, kernel, packed
from drake_quad.framework.records import ABSENT, Layout, check_signs, layout_of
from drake_quad.signals import SIGNALS

if TYPE_CHECKING:
    from pydrake.systems.framework import LeafSystem as _Base
else:
    _Base = object

__all__ = ["TIME", "AutoDiffXd", "Expression", "FleetSystem", "TickOf", "fleet_system"]


@dataclass(frozen=True)
class Input:
    """An input port.

    Attributes:
        name: of the port.
        index: of the port.
        layout: of what it holds.
        absent: what a formula gets in its place where nothing is connected.
    """

    name: str
    index: InputPortIndex
    layout: Layout
    absent: Any

    def vector(self, system: "FleetSystem", context: Context) -> BasicVector:
        """The BasicVector at the port; None if nothing is connected."""
        return system.EvalVectorInput(context, self.index)

    def ticket(self, system: "FleetSystem") -> Any:
        """What Drake calls it when it asks what an output depends on."""
        return system.input_port_ticket(self.index)


@dataclass(frozen=True)
class Parameter:
    """A numeric parameter of the context.

    Attributes:
        name: in this system.
        index: among the numeric parameters.
        layout: of its rows.
        recipe: from the system's numbers to the record.
    """

    name: str
    index: NumericParameterIndex
    layout: Layout
    recipe: Callable[[Any], Any]

    def vector(self, system: "FleetSystem", context: Context) -> BasicVector:
        """Its BasicVector."""
        return context.get_numeric_parameter(self.index)

    def mutable_vector(self, context: Context) -> BasicVector:
        """Its BasicVector, to be written."""
        return context.get_mutable_numeric_parameter(self.index)

    def ticket(self, system: "FleetSystem") -> Any:
        """What Drake calls it when it asks what an output depends on."""
        return system.numeric_parameter_ticket(self.index)


@dataclass(frozen=True)
class StateGroup:
    """A group of the discrete state, or the continuous state.

    Attributes:
        name: in this system.
        index: among the discrete groups; None for the continuous state.
        layout: of its rows.
        recipe: from the system's numbers to the record at the beginning.
    """

    name: str
    index: DiscreteStateIndex | None
    layout: Layout
    recipe: Callable[[Any], Any]

    def vector(self, system: "FleetSystem", context: Context) -> BasicVector:
        """Its vector."""
        if self.index is None:
            return context.get_continuous_state_vector()
        return context.get_discrete_state(self.index)

    def mutable_vector(self, context: Context) -> BasicVector:
        """Its vector, to be written."""
        if self.index is None:
            return context.get_mutable_continuous_state_vector()
        return context.get_mutable_discrete_state(self.index)

    def ticket(self, system: "FleetSystem") -> Any:
        """What Drake calls it when it asks what an output depends on."""
        return system.xc_ticket() if self.index is None else system.discrete_state_ticket(self.index)


_Read = Input | Parameter | StateGroup


class Computation:
    """What a system computes: by which formula, from what, and what it writes.

    Attributes:
        formula: a function of records and constants.
        reads: its arguments: ports, parameters, states, `TIME`, a `TickOf`, or constants.
        results: layouts of the results; `ABSENT` for a state that the system does not have.
        writes: the states that it changes; none for an output.
    """

    def __init__(self, formula: Callable[..., Any], reads: Sequence[Any], targets: Sequence[Any]) -> None:
        self.formula, self.reads = formula, tuple(reads)
        self.results = tuple([_layout_of_target(target) for target in targets])
        self.writes = tuple([target for target in targets if isinstance(target, StateGroup)])
        self._timed = any(read is TIME or isinstance(read, TickOf) for read in self.reads)
        # What is read of what is written stands where it will be written.
        written = {write.index: place for place, write in enumerate(self.writes)}
        self._sources = [
            (read, written.get(read.index) if isinstance(read, StateGroup) else None)
            for read in self.reads
            if isinstance(read, _Read)
        ]
        # By place among the sources, since this is looked up thousands of times a second.
        reads_and_places = [(place, read) for place, (read, target) in enumerate(self._sources) if target is None]
        self._inputs = [(place, read.index) for place, read in reads_and_places if isinstance(read, Input)]
        self._parameters = [(place, read.index) for place, read in reads_and_places if isinstance(read, Parameter)]
        self._states = [(place, read.index) for place, read in reads_and_places if isinstance(read, StateGroup)]
        self._own = [(place, target) for place, (_, target) in enumerate(self._sources) if target is not None]
        self._kernels: dict[tuple[Any, ...], Callable[..., None]] = {}

    def tickets(self, system: "FleetSystem") -> set[Any]:
        """What the result depends on, as Drake asks for it."""
        found = {read.ticket(system) for read, _ in self._sources}
        if self._timed:
            found.add(system.time_ticket())
        return found or {system.nothing_ticket()}

    def run(self, system: "FleetSystem", context: Context, vectors: Sequence[Any]) -> None:
        """Computes the results and writes them into BasicVectors, which hold what was before if they are states."""
        if system.scalar is not float or INTERPRETED:
            self.interpret(system, context, vectors)
            return
        targets = [vector.get_mutable_value() for vector in vectors]
        sources: list[Any] = [None] * len(self._sources)
        absent: tuple[Any, ...] = ()
        for place, index in self._inputs:
            vector = system.EvalVectorInput(context, index)
            if vector is None:
                absent += (index,)
            else:
                sources[place] = vector.value()
        for place, index in self._parameters:
            sources[place] = context.get_numeric_parameter(index).value()
        for place, index in self._states:
            if index is None:
                sources[place] = context.get_continuous_state_vector().CopyToVector()
            else:
                sources[place] = context.get_discrete_state(index).value()
        for place, target in self._own:
            sources[place] = targets[target]
        if absent:
            sources = [source for source in sources if source is not None]
        run = self._kernels.get(absent) or self._made(absent, lone=system.num_vehicles == 1)
        run(system.num_vehicles, context.get_time() if self._timed else 0.0, *targets, *sources)

    def interpret(self, system: "FleetSystem", context: Context, vectors: Sequence[Any]) -> None:
        """The same without machine code."""
        sources: list[Any] = []
        absent: tuple[Any, ...] = ()
        for read, place in self._sources:
            vector = read.vector(system, context) if place is None else vectors[place]
            if vector is None:
                absent += (read.index,)
            else:
                sources.append(vector.CopyToVector())
        results = interpret(
            self.formula,
            self._arguments(absent),
            sources,
            self.results,
            system.num_vehicles,
            context.get_time() if self._timed else 0.0,
        )
        for vector, elements in zip(vectors, results, strict=True):
            vector.SetFromVector(elements.astype(system.scalar))

    def _made(self, absent: tuple[Any, ...], *, lone: bool) -> Callable[..., None]:
        self._kernels[absent] = kernel(self.formula, self._arguments(absent), self.results, lone=lone)
        return self._kernels[absent]

    def _arguments(self, absent: tuple[Any, ...]) -> tuple[Any, ...]:
        """The arguments of the formula where nothing is connected to some input ports."""
        arguments = []
        for read in self.reads:
            if isinstance(read, Input) and read.index in absent:
                arguments.append(read.absent)
            else:
                arguments.append(read.layout if isinstance(read, _Read) else read)
        return tuple(arguments)


class FleetSystem(_Base):
    """What the systems of this project have in common; a subclass is made a Drake system by `fleet_system`.

    A subclass defines `declare` in place of a constructor: it is called with the keyword arguments of the constructor
    other than `num_vehicles`, and again with the same ones on the converted copy. If it has an argument `numbers`, that
    is what the recipes of its parameters and states are functions of.

    Attributes:
        scalar: float, AutoDiffXd or Expression.
        num_vehicles: N.
        structure: the arguments of the constructor, but for `num_vehicles` and `numbers`, where they were given.
        parameters: the numeric parameters, by name.
        states: the groups of the state, by name.
        random_inputs: the input ports for random numbers, by name.
        outputs: computations of the output ports, by name.
        updates: what is computed at periodic events.
        initializations: what is computed when a simulation begins.
        packed: the layouts of the signals that the only output port packs, by name; empty if it packs none.
        num_events: how many events were declared, by `update`, by `initialize` or by Drake's own methods.
    """

    scalar: type
    num_vehicles: int
    structure: dict[str, Any]
    _numbers: Any

    def begin(self) -> None:
        """Makes room for what will be declared."""
        self.parameters: dict[str, Parameter] = {}
        self.states: dict[str, StateGroup] = {}
        self.random_inputs: dict[str, RandomInput] = {}
        self.outputs: dict[str, Computation] = {}
        self.updates: list[Update] = []
        self.initializations: list[Computation] = []
        self.packed: dict[str, Layout] = {}
        self._derivative: Computation | None = None
        self.num_events = 0

    def declare(self, *args: Any, **options: Any) -> None:
        """Declares ports, state, parameters and events; every subclass has its own."""

    def input(self, name: str, *, layout: Layout | None = None, absent: Any = None) -> Input:
        """Declare an input port.

        Args:
            name: name of the port.
            layout: layout of the port; that of the signal `name` in `drake_quad.signals` if not given.
            absent: value that a formula gets if the port is not connected.

        Raises:
            InputError: no layout is given, and there is no signal with this name.
        """
        layout = layout or _layout_of_signal(name)
        return Input(name, self.DeclareVectorInputPort(name, self._model(layout)).get_index(), layout, absent)

    def random_input(self, name: str, kind: Any, distribution: RandomDistribution, *, period: float) -> Input:
        """Declares an input port for random numbers, as Drake's RandomSource gives them.

        Args:
            name: of the port.
            kind: of record that it holds.
            distribution: of each of its rows.
            period: after which the system takes new ones, s.
        """
        layout = layout_of(kind)
        index = self.DeclareVectorInputPort(name, self._model(layout), distribution).get_index()
        self.random_inputs[name] = RandomInput(layout.num_rows, distribution, period)
        return Input(name, index, layout, None)

    def parameter(self, name: str, recipe: Callable[[Any], Any]) -> Parameter:
        """Declares a numeric parameter, given its record as a function of the system's numbers."""
        record = recipe(self._numbers)
        layout = layout_of(type(record), record)
        index = self.DeclareNumericParameter(self._vector(layout, record))
        self.parameters[name] = Parameter(name, NumericParameterIndex(int(index)), layout, recipe)
        return self.parameters[name]

    def state(self, name: str, recipe: Callable[[Any], Any], *, layout: Layout | None = None) -> StateGroup:
        """Declares a group of the discrete state, given its record at the beginning as a function of the numbers."""
        record = recipe(self._numbers)
        layout = layout or layout_of(type(record), record)
        index = self.DeclareDiscreteState(self._vector(layout, record))
        self.states[name] = StateGroup(name, DiscreteStateIndex(int(index)), layout, recipe)
        return self.states[name]

    def continuous_state(self, recipe: Callable[[Any], Any]) -> StateGroup:
        """Declares the continuous state, given its record at the beginning as a function of the numbers."""
        record = recipe(self._numbers)
        layout = layout_of(type(record), record)
        self.DeclareContinuousState(self._vector(layout, record))
        self.states["continuous"] = StateGroup("continuous", None, layout, recipe)
        return self.states["continuous"]

    def output(self, name: str, formula: Callable[..., Any], *reads: Any, layout: Layout | None = None) -> None:
        """Declare an output port.

        Args:
            name: name of the port.
            formula: function that returns the value of the port.
            reads: arguments of the formula: ports, parameters, states, `TIME`, a `TickOf`, or constants.
            layout: layout of the port; that of the signal `name` in `drake_quad.signals` if not given.

        Raises:
            InputError: no layout is given, and there is no signal with this name.
        """
        layout = layout or _layout_of_signal(name)
        computation = Computation(formula, reads, [layout])
        self.outputs[name] = computation

        def calc(system: FleetSystem, context: Context, output: BasicVector) -> None:
            computation.run(system, context, [output])

        self.DeclareVectorOutputPort(name, self._model(layout), MethodType(calc, self), computation.tickets(self))

    def packed_output(self, name: str, kind: Any, formula: Callable[..., Any], *reads: Any) -> None:
        """Declares an output port that packs several signals; `drake_quad.framework.wiring.split_output` unpacks them.

        Args:
            name: of the port.
            kind: a record of signals, which are the ports that result; the formula returns one.
            formula: which returns the record.
            reads: the formula's arguments: ports, parameters, states, `TIME`, a `TickOf`, or constants.
        """
        layout = layout_of(kind)
        self.packed = dict(zip(kind._fields, layout.parts, strict=True))
        self.output(name, formula, *reads, layout=layout)

    def state_output(self, group: StateGroup) -> None:
        """Declares an output port that shows a group of the discrete state, under its name."""
        self.outputs[group.name] = Computation(identity, [group], [group.layout])
        if self.num_vehicles == 1:
            self.DeclareStateOutputPort(group.name, group.index)
            return

        # DeclareStateOutputPort makes a virtual call for every element, which is slow for a fleet.
        def show(system: FleetSystem, context: Context, output: BasicVector) -> None:
            state = context.get_discrete_state(group.index)
            if system.scalar is float:
                output.get_mutable_value()[:] = state.value()
            else:
                output.SetFrom(state)

        self.DeclareVectorOutputPort(
            group.name, self._model(group.layout), MethodType(show, self), {group.ticket(self)}
        )

    def update(
        self,
        period: float,
        formula: Callable[..., Any],
        *reads: Any,
        writes: Sequence[Any],
        unrestricted: bool = False,
        at_start: bool = True,
    ) -> None:
        """Declares a periodic update of groups of the discrete state, at 0, h, 2h, ...

        Args:
            period: h, s.
            formula: which returns what they will hold: a record, or one after another if there are several.
            reads: the formula's arguments: ports, parameters, states, `TIME`, a `TickOf`, or constants. Of the discrete
                state it reads what it was before this instant.
            writes: the groups that change; no other update may write them. None or an empty tuple stands for a group
                that this system does not have; that part of the result is left out.
            unrestricted: whether it is done before the discrete updates of that instant, which then see the result.
            at_start: whether anything is done at time zero.
        """
        computation = Computation(formula, reads, writes)
        self.updates.append(Update(period, computation, unrestricted, at_start))
        indices = [group.index for group in computation.writes]

        def write(system: FleetSystem, context: Context, values: Any) -> None:
            if at_start or context.get_time() != 0.0:
                groups = values.get_mutable_discrete_state() if unrestricted else values
                computation.run(system, context, [groups.get_mutable_vector(index) for index in indices])

        event = self.DeclarePeriodicUnrestrictedUpdateEvent if unrestricted else self.DeclarePeriodicDiscreteUpdateEvent
        event(period, 0.0, MethodType(write, self))

    def initialize(self, formula: Callable[..., Any], *reads: Any, writes: Sequence[Any]) -> None:
        """Declares an update that is done when a simulation begins.

        Args:
            formula: which returns what the groups will hold.
            reads: the formula's arguments: ports, parameters, states, `TIME`, a `TickOf`, or constants.
            writes: the groups that change, as for `update`.
        """
        computation = Computation(formula, reads, writes)
        self.initializations.append(computation)
        indices = [group.index for group in computation.writes]

        # Once in a flight: machine code would take longer to make.
        def write(system: FleetSystem, context: Context, groups: Any) -> None:
            computation.interpret(system, context, [groups.get_mutable_vector(index) for index in indices])

        self.DeclareInitializationDiscreteUpdateEvent(MethodType(write, self))

    def derivative(self, formula: Callable[..., Any], *reads: Any) -> None:
        """Declares the time derivative of the continuous state, which the formula returns."""
        self._derivative = Computation(formula, reads, [self.states["continuous"].layout])

    def DoCalcTimeDerivatives(self, context: Context, derivatives: Any) -> None:
        """Drake's hook for a continuous state."""
        if self._derivative is None:
            return
        # The floating-point flags that arithmetic on objects leaves behind mean nothing.
        with np.errstate(all=None if self.scalar is float else "ignore"):
            slope = BasicVector_[self.scalar](derivatives.size())
            self._derivative.run(self, context, [slope])
        derivatives.get_mutable_vector().SetFromVector(slope.CopyToVector())

    def reset(self, context: Context, numbers: Any) -> None:
        """Makes parameters and state of a context what they would be by default, had these been the numbers.

        Args:
            context: of this system.
            numbers: as at construction; each row may be an (N,) array.
        """
        self.set_numbers(context, numbers)
        for part in self.states.values():
            part.mutable_vector(context).SetFromVector(self._elements(part.layout, part.recipe(numbers)))

    def set_numbers(self, context: Context, numbers: Any) -> None:
        """Set the parameters of a context to what they would be by default, had these been the numbers.

        Args:
            context: context of this system.
            numbers: numbers as at construction; each row may be an (N,) array.
        """
        for part in self.parameters.values():
            part.mutable_vector(context).SetFromVector(self._elements(part.layout, part.recipe(numbers)))

    def get_parameter(self, context: Context, name: str) -> Any:
        """Return a copy of the record of a numeric parameter."""
        return self._record(entry(self.parameters, name, "parameter"), context)

    def set_parameter(self, context: Context, name: str, record: Any) -> None:
        """Set a numeric parameter to a record; each row is a number for all vehicles, or an (N,) array."""
        parameter = entry(self.parameters, name, "parameter")
        parameter.mutable_vector(context).SetFromVector(self._elements(parameter.layout, record))

    def get_state(self, context: Context, name: str) -> Any:
        """Return a copy of the record of a group of the state."""
        return self._record(entry(self.states, name, "group of the state"), context)

    def set_state(self, context: Context, name: str, record: Any) -> None:
        """Set a group of the state to a record; each row is a number for all vehicles, or an (N,) array."""
        group = entry(self.states, name, "group of the state")
        group.mutable_vector(context).SetFromVector(self._elements(group.layout, record))

    def _record(self, part: Parameter | StateGroup, context: Context) -> Any:
        elements = part.vector(self, context).CopyToVector()
        rows = elements.tolist() if self.num_vehicles == 1 else elements.reshape(-1, self.num_vehicles)
        return part.layout.build(rows)

    def _elements(self, layout: Layout, record: Any) -> np.ndarray:
        return packed(layout.flatten(record), self.num_vehicles).astype(self.scalar)

    def _vector(self, layout: Layout, record: Any) -> Any:
        return BasicVector_[self.scalar](self._elements(layout, record))

    def _model(self, layout: Layout) -> Any:
        return BasicVector_[self.scalar](layout.num_rows * self.num_vehicles)


def _layout_of_target(target: Any) -> Layout:
    """Return the layout of a result: that of an output port, or that of a state group."""
    if isinstance(target, Layout):
        return target
    return target.layout if isinstance(target, StateGroup) else ABSENT


def _layout_of_signal(name: str) -> Layout:
    return layout_of(entry(SIGNALS, name, "signal"))


class RandomInput(NamedTuple):
    """What an input port for random numbers asks for.

    Attributes:
        num_rows: for each vehicle.
        distribution: of each row.
        period: after which it takes new ones, s.
    """

    num_rows: int
    distribution: RandomDistribution
    period: float


class Update(NamedTuple):
    """A periodic update of the discrete state.

    Attributes:
        period: s.
        computation: what is computed, and what is written.
        unrestricted: whether it is done before the discrete updates of its instant.
        at_start: whether anything is done at time zero.
    """

    period: float
    computation: Computation
    unrestricted: bool
    at_start: bool


# Drake's methods that declare events which happen by themselves.
_EVENTS = [
    f"Declare{when}{what}Event"
    for when in ("Initialization", "Periodic", "PerStep")
    for what in ("", "DiscreteUpdate", "Publish", "UnrestrictedUpdate")
]


def _counted(declare: Callable[..., None]) -> Callable[..., None]:
    """A method of Drake's that declares an event, which is counted."""

    def counted(self: FleetSystem, *args: Any, **options: Any) -> None:
        """Declares an event as Drake's method does, and counts it.

        :meta private:
        """
        self.num_events += 1
        declare(self, *args, **options)

    return counted


@contextmanager
def _quick_templates() -> Iterator[None]:
    """Spares Drake the search for the module in which a method is made a template.

    For its name alone it reads the source of every caller: half of the time that it took to import this package.
    """
    search = getattr(cpp_template, "_get_module_from_stack", None)
    if search is None:
        yield
        return
    cpp_template._get_module_from_stack = lambda frame=2: sys.modules[__name__]
    try:
        yield
    finally:
        cpp_template._get_module_from_stack = search


def _constructor_signature(cls: type[FleetSystem]) -> inspect.Signature:
    """Return the signature of a system's constructor: the number of vehicles and the arguments of `declare`."""
    _, *declared = inspect.signature(cls.declare).parameters.values()
    num_vehicles = inspect.Parameter("num_vehicles", inspect.Parameter.POSITIONAL_OR_KEYWORD, default=1, annotation=int)
    options = (parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY) for parameter in declared)
    return inspect.Signature([num_vehicles, *options])


def fleet_system(*scalars: type) -> Callable[[type[FleetSystem]], Any]:
    """Makes a FleetSystem a Drake system for these scalar types, float first, that converts between them.

    The class that results is the one for float; its attribute `template` holds the others.
    """

    def decorate(cls: type[FleetSystem]) -> Any:
        template = TemplateSystem(f"{cls.__name__}_", T_list=list(scalars), scope=sys.modules[cls.__module__])
        signature = _constructor_signature(cls)
        numbers = signature.parameters.get("numbers")
        default = None if numbers is None or numbers.default is numbers.empty else numbers.default

        def instantiate(param: tuple[type]) -> type:
            (T,) = param

            class Impl(cls, LeafSystem_[T]):  # type: ignore[misc, valid-type]
                __doc__ = cls.__doc__
                scalar = T

                def _construct(self, num_vehicles: int = 1, *, converter: Any = None, **options: Any) -> None:
                    LeafSystem_[T].__init__(self, converter)
                    self.num_vehicles, self._options = num_vehicles, options
                    self.structure = {name: value for name, value in options.items() if name != "numbers"}
                    self.begin()
                    self._numbers = options.get("numbers", default)
                    if T is float:
                        check_signs(self._numbers)
                    self.declare(**options)

                def _construct_copy(self, other: Any, converter: Any = None) -> None:
                    Impl._construct(self, other.num_vehicles, converter=converter, **other._options)

            for name in _EVENTS:
                setattr(Impl, name, _counted(getattr(LeafSystem_[T], name)))
            return Impl

        template.add_instantiations(instantiate, [(T,) for T in scalars])
        with _quick_templates():
            instance = template[scalars[0]]
        instance.template = template
        instance.__name__ = instance.__qualname__ = cls.__name__
        instance.__signature__ = signature
        return instance

    return decorate
