"""LeafSystem for a fleet of vehicles, whose computations are declared as formulas.

A port, parameter or state with k rows has k N elements for N vehicles, in C order of the shape (k, N). A single vehicle
has a k-vector. The fields of a record name the rows; `drake_quad.signals` defines the records of the ports.

A system declares its ports, parameters and states, and the formula that computes each output or update from them:

    measurement, reference = self.input("measurement"), self.input("reference")
    gains = self.parameter("gains", lambda gains: gains)
    self.output("acceleration_command", pd_law, measurement, reference, gains)

Drake's callbacks for all scalar types, and the machine code for floats, are derived from the declaration. A formula
takes and returns records whose fields are rows. A row is a number for one vehicle, and an array for a fleet. It
consists of arithmetic, comparisons and functions of `drake_quad.framework.elementary`.

`declare` has two types of arguments. Structural arguments determine the ports and events. `parameters` is a record of
values that may differ between vehicles. Every numeric parameter and initial state has a recipe, a function that
computes it from `parameters`. `FleetSystem.reset` evaluates the recipes again, so that a diagram can be simulated again
with other parameters.
"""

import inspect
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from enum import Enum
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

from drake_quad.errors import lookup, not_connected
from drake_quad.framework.elementary import identity
from drake_quad.framework.formulas import INTERPRETED, TIME, CurrentTick, interpret, kernel, pack_rows
from drake_quad.framework.records import ABSENT, Layout, check_signs, layout_of
from drake_quad.signals import SIGNALS

if TYPE_CHECKING:
    from pydrake.systems.framework import LeafSystem as _Base
else:
    _Base = object

__all__ = ["REQUIRED", "TIME", "AutoDiffXd", "CurrentTick", "Expression", "FleetSystem", "fleet_system"]


class _Connection(Enum):
    """Requirement on the connection of an input port."""

    REQUIRED = "required"


REQUIRED = _Connection.REQUIRED
"""Value of `absent` for an input port that must be connected."""


@dataclass(frozen=True)
class Input:
    """Input port of a FleetSystem.

    Attributes:
        name: name of the port.
        index: Drake's index of the port.
        layout: layout of the port's value.
        absent: value that a formula receives if the port is not connected; `REQUIRED` if the port must be connected.
    """

    name: str
    index: InputPortIndex
    layout: Layout
    absent: Any

    def value_if_absent(self, system: "FleetSystem") -> Any:
        """Return the value that a formula receives if the port is not connected.

        Raises:
            InputError: if the port must be connected.
        """
        if self.absent is REQUIRED:
            raise not_connected(self.name, system)
        return self.absent

    def vector(self, system: "FleetSystem", context: Context) -> BasicVector:
        """Return the BasicVector that the port receives; None if the port is optional and not connected.

        Raises:
            InputError: if the port must be connected, and is not.
        """
        vector = system.EvalVectorInput(context, self.index)
        if vector is None:
            self.value_if_absent(system)
        return vector

    def ticket(self, system: "FleetSystem") -> Any:
        """Return Drake's dependency ticket of the port."""
        return system.input_port_ticket(self.index)


@dataclass(frozen=True)
class Parameter:
    """Numeric parameter in the context of a FleetSystem.

    Attributes:
        name: name of the parameter within the system.
        index: Drake's index of the numeric parameter.
        layout: layout of the parameter.
        recipe: function that computes the parameter from the system's argument `parameters`.
    """

    name: str
    index: NumericParameterIndex
    layout: Layout
    recipe: Callable[[Any], Any]

    def vector(self, system: "FleetSystem", context: Context) -> BasicVector:
        """Return the parameter's BasicVector in a context."""
        return context.get_numeric_parameter(self.index)

    def mutable_vector(self, context: Context) -> BasicVector:
        """Return the parameter's mutable BasicVector in a context."""
        return context.get_mutable_numeric_parameter(self.index)

    def ticket(self, system: "FleetSystem") -> Any:
        """Return Drake's dependency ticket of the parameter."""
        return system.numeric_parameter_ticket(self.index)


@dataclass(frozen=True)
class StateGroup:
    """Group of a FleetSystem's discrete state, or its continuous state.

    Attributes:
        name: name of the group within the system.
        index: Drake's index of the discrete group; None for the continuous state.
        layout: layout of the state.
        recipe: function that computes the initial state from the system's argument `parameters`.
        is_scheduled: True for a state that linear models omit and replace by its value at the operating point. Small
            changes of the inputs must affect such a state, or its effect on the outputs, only in second order. Examples
            are a counter, and the covariance of a Kalman filter in equilibrium.
    """

    name: str
    index: DiscreteStateIndex | None
    layout: Layout
    recipe: Callable[[Any], Any]
    is_scheduled: bool = False

    def vector(self, system: "FleetSystem", context: Context) -> BasicVector:
        """Return the vector of this state group in a context."""
        if self.index is None:
            return context.get_continuous_state_vector()
        return context.get_discrete_state(self.index)

    def mutable_vector(self, context: Context) -> BasicVector:
        """Return the mutable vector of this state group in a context."""
        if self.index is None:
            return context.get_mutable_continuous_state_vector()
        return context.get_mutable_discrete_state(self.index)

    def ticket(self, system: "FleetSystem") -> Any:
        """Return Drake's dependency ticket of the state group."""
        return system.xc_ticket() if self.index is None else system.discrete_state_ticket(self.index)


_Read = Input | Parameter | StateGroup


class Computation:
    """Formula of a FleetSystem, with its arguments and the layouts of its results.

    Attributes:
        formula: function of records and constants.
        reads: arguments of the formula: ports, parameters, states, `TIME`, a `CurrentTick`, or constants.
        results: layout of each result. It is `ABSENT` if the result is for an optional state that the system does not
            declare.
        writes: state groups to which the results are written; empty if the results belong to an output port.
    """

    def __init__(self, formula: Callable[..., Any], reads: Sequence[Any], targets: Sequence[Any]) -> None:
        self.formula, self.reads = formula, tuple(reads)
        self.results = tuple([_layout_of_target(target) for target in targets])
        self.writes = tuple([target for target in targets if isinstance(target, StateGroup)])
        self._timed = any(read is TIME or isinstance(read, CurrentTick) for read in self.reads)
        # If a state is both read and written, its previous value is read from the vector that receives the result.
        written = {write.index: argument_index for argument_index, write in enumerate(self.writes)}
        self._sources = [
            (read, written.get(read.index) if isinstance(read, StateGroup) else None)
            for read in self.reads
            if isinstance(read, _Read)
        ]
        # Arguments are sorted by type in advance, since `run` is called thousands of times per second.
        reads_and_indices = [
            (argument_index, read) for argument_index, (read, target) in enumerate(self._sources) if target is None
        ]
        self._inputs = [
            (argument_index, read.index) for argument_index, read in reads_and_indices if isinstance(read, Input)
        ]
        self._parameters = [
            (argument_index, read.index) for argument_index, read in reads_and_indices if isinstance(read, Parameter)
        ]
        self._states = [
            (argument_index, read.index) for argument_index, read in reads_and_indices if isinstance(read, StateGroup)
        ]
        self._updated_states = [
            (argument_index, target) for argument_index, (_, target) in enumerate(self._sources) if target is not None
        ]
        self._kernels: dict[tuple[Any, ...], Callable[..., None]] = {}

    def tickets(self, system: "FleetSystem") -> set[Any]:
        """Return the dependency tickets of all inputs, parameters and states on which the results depend."""
        tickets = {read.ticket(system) for read, _ in self._sources}
        if self._timed:
            tickets.add(system.time_ticket())
        return tickets or {system.nothing_ticket()}

    def run(self, system: "FleetSystem", context: Context, vectors: Sequence[Any]) -> None:
        """Compute the results and write them to BasicVectors. State vectors must contain the previous values."""
        if system.scalar is not float or INTERPRETED:
            self.interpret(system, context, vectors)
            return
        targets = [vector.get_mutable_value() for vector in vectors]
        sources: list[Any] = [None] * len(self._sources)
        absent: tuple[Any, ...] = ()
        for argument_index, index in self._inputs:
            vector = system.EvalVectorInput(context, index)
            if vector is None:
                absent += (index,)
            else:
                sources[argument_index] = vector.value()
        for argument_index, index in self._parameters:
            sources[argument_index] = context.get_numeric_parameter(index).value()
        for argument_index, index in self._states:
            if index is None:
                sources[argument_index] = context.get_continuous_state_vector().CopyToVector()
            else:
                sources[argument_index] = context.get_discrete_state(index).value()
        for argument_index, target in self._updated_states:
            sources[argument_index] = targets[target]
        if absent:
            sources = [source for source in sources if source is not None]
        run = self._kernels.get(absent) or self._compiled(system, absent)
        run(system.num_vehicles, context.get_time() if self._timed else 0.0, *targets, *sources)

    def interpret(self, system: "FleetSystem", context: Context, vectors: Sequence[Any]) -> None:
        """Compute the results as `run` does, but without machine code."""
        sources: list[Any] = []
        absent: tuple[Any, ...] = ()
        for read, argument_index in self._sources:
            vector = read.vector(system, context) if argument_index is None else vectors[argument_index]
            if vector is None:
                absent += (read.index,)
            else:
                sources.append(vector.CopyToVector())
        results = interpret(
            self.formula,
            self._arguments(system, absent),
            sources,
            self.results,
            system.num_vehicles,
            context.get_time() if self._timed else 0.0,
        )
        for vector, elements in zip(vectors, results, strict=True):
            vector.SetFromVector(elements.astype(system.scalar))

    def _compiled(self, system: "FleetSystem", absent: tuple[Any, ...]) -> Callable[..., None]:
        arguments, single_vehicle = self._arguments(system, absent), system.num_vehicles == 1
        self._kernels[absent] = kernel(self.formula, arguments, self.results, single_vehicle=single_vehicle)
        return self._kernels[absent]

    def _arguments(self, system: "FleetSystem", absent: tuple[Any, ...]) -> tuple[Any, ...]:
        """Return the arguments of the formula if the input ports with given indices are not connected.

        Raises:
            InputError: if one of these ports must be connected.
        """
        arguments = []
        for read in self.reads:
            if isinstance(read, Input) and read.index in absent:
                arguments.append(read.value_if_absent(system))
            else:
                arguments.append(read.layout if isinstance(read, _Read) else read)
        return tuple(arguments)


class FleetSystem(_Base):
    """Base class of this package's systems. The decorator `fleet_system` converts a subclass to a Drake system.

    A subclass defines `declare` instead of a constructor. `declare` is called with the keyword arguments of the
    constructor except for `num_vehicles`, and again with the same arguments when Drake converts the system to another
    scalar type. If `declare` has an argument `parameters`, it is passed to the recipes of parameters and states.

    Attributes:
        scalar: scalar type: float, AutoDiffXd or Expression.
        num_vehicles: number N of vehicles.
        structure: arguments of the constructor other than `num_vehicles` and `parameters`.
        parameters: numeric parameters, by name.
        states: groups of the state, by name.
        random_inputs: properties of the random input ports, by name.
        outputs: computations of the output ports, by name.
        updates: periodic updates of the discrete state.
        initializations: computations at the start of a simulation.
        packed: layouts of the signals in the packed output port, by name; empty if there is no such port.
        num_events: number of declared events, including events declared directly with Drake's methods.
    """

    scalar: type
    num_vehicles: int
    structure: dict[str, Any]
    _parameter_record: Any

    def begin(self) -> None:
        """Initialize the attributes that collect the declarations."""
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
        """Declare ports, state, parameters and events; subclasses override this method."""

    def input(self, name: str, *, layout: Layout | None = None, absent: Any = REQUIRED) -> Input:
        """Declare an input port.

        Args:
            name: name of the port.
            layout: layout of the port; by default the layout of the signal `name` in `drake_quad.signals`.
            absent: value that a formula receives if the port is not connected, such as None; by default, the port must
                be connected.

        Raises:
            InputError: if no layout is given and there is no signal with this name.
        """
        layout = layout or _layout_of_signal(name)
        return Input(name, self.DeclareVectorInputPort(name, self._model(layout)).get_index(), layout, absent)

    def random_input(self, name: str, kind: Any, distribution: RandomDistribution, *, period: float) -> Input:
        """Declare a random input port, which can be connected to Drake's RandomSource.

        Args:
            name: name of the port.
            kind: type of the record at the port, or its layout.
            distribution: distribution of each random number.
            period: period at which the system uses new random numbers, s.
        """
        layout = kind if isinstance(kind, Layout) else layout_of(kind)
        index = self.DeclareVectorInputPort(name, self._model(layout), distribution).get_index()
        self.random_inputs[name] = RandomInput(layout.num_rows, distribution, period)
        return Input(name, index, layout, REQUIRED)

    def parameter(self, name: str, recipe: Callable[[Any], Any]) -> Parameter:
        """Declare a numeric parameter, given the function of `parameters` that computes its record."""
        record = recipe(self._parameter_record)
        layout = layout_of(type(record), record)
        index = self.DeclareNumericParameter(self._vector(layout, record))
        self.parameters[name] = Parameter(name, NumericParameterIndex(int(index)), layout, recipe)
        return self.parameters[name]

    def state(
        self, name: str, recipe: Callable[[Any], Any], *, layout: Layout | None = None, is_scheduled: bool = False
    ) -> StateGroup:
        """Declare a discrete state group, given the function of `parameters` that computes its initial record.

        Args:
            name: name of the group.
            recipe: function of `parameters` that computes the initial record.
            layout: layout of the record; by default that of the initial record.
            is_scheduled: True for a group that linear models leave out; see `StateGroup`.
        """
        record = recipe(self._parameter_record)
        layout = layout or layout_of(type(record), record)
        index = self.DeclareDiscreteState(self._vector(layout, record))
        self.states[name] = StateGroup(name, DiscreteStateIndex(int(index)), layout, recipe, is_scheduled)
        return self.states[name]

    def continuous_state(self, recipe: Callable[[Any], Any]) -> StateGroup:
        """Declare the continuous state, given the function of `parameters` that computes its initial record."""
        record = recipe(self._parameter_record)
        layout = layout_of(type(record), record)
        self.DeclareContinuousState(self._vector(layout, record))
        self.states["continuous"] = StateGroup("continuous", None, layout, recipe)
        return self.states["continuous"]

    def output(self, name: str, formula: Callable[..., Any], *reads: Any, layout: Layout | None = None) -> None:
        """Declare an output port.

        Args:
            name: name of the port.
            formula: function that returns the value of the port.
            reads: arguments of the formula: ports, parameters, states, `TIME`, a `CurrentTick`, or constants.
            layout: layout of the port; by default the layout of the signal `name` in `drake_quad.signals`.

        Raises:
            InputError: if no layout is given and there is no signal with this name.
        """
        layout = layout or _layout_of_signal(name)
        computation = Computation(formula, reads, [layout])
        self.outputs[name] = computation

        def calc(system: FleetSystem, context: Context, output: BasicVector) -> None:
            computation.run(system, context, [output])

        self.DeclareVectorOutputPort(name, self._model(layout), MethodType(calc, self), computation.tickets(self))

    def packed_output(self, name: str, kind: Any, formula: Callable[..., Any], *reads: Any) -> None:
        """Declare a single output port for several signals, which `wiring.split_output` separates.

        Args:
            name: name of the port.
            kind: type of a record whose fields are the signals.
            formula: function that returns a record of this type.
            reads: arguments of the formula: ports, parameters, states, `TIME`, a `CurrentTick`, or constants.
        """
        layout = layout_of(kind)
        self.packed = dict(zip(kind._fields, layout.parts, strict=True))
        self.output(name, formula, *reads, layout=layout)

    def state_output(self, group: StateGroup) -> None:
        """Declare an output port for a discrete state group; the port has the name of the group."""
        self.outputs[group.name] = Computation(identity, [group], [group.layout])
        if self.num_vehicles == 1:
            self.DeclareStateOutputPort(group.name, group.index)
            return

        # DeclareStateOutputPort makes a virtual call for every element, which is slow for a fleet.
        def copy_state(system: FleetSystem, context: Context, output: BasicVector) -> None:
            state = context.get_discrete_state(group.index)
            if system.scalar is float:
                output.get_mutable_value()[:] = state.value()
            else:
                output.SetFrom(state)

        self.DeclareVectorOutputPort(
            group.name, self._model(group.layout), MethodType(copy_state, self), {group.ticket(self)}
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
        """Declare a periodic update of discrete state groups, at the times 0, h, 2h, ...

        Args:
            period: period h, s.
            formula: function that returns the new value of the group, or a tuple with the new values of several groups.
            reads: arguments of the formula: ports, parameters, states, `TIME`, a `CurrentTick`, or constants.
                States are passed with their values before the update.
            writes: groups that only this update writes. None or an empty tuple stands for an optional
                group that is not declared; the corresponding result is ignored.
            unrestricted: True for an update before all discrete updates of the same instant, which use its result.
            at_start: True if the update also takes place at time zero.
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
        """Declare an update of discrete state groups at the start of a simulation.

        Args:
            formula: function that returns the new values of the groups.
            reads: arguments of the formula: ports, parameters, states, `TIME`, a `CurrentTick`, or constants.
            writes: groups to update, as in `update`.
        """
        computation = Computation(formula, reads, writes)
        self.initializations.append(computation)
        indices = [group.index for group in computation.writes]

        def write(system: FleetSystem, context: Context, groups: Any) -> None:
            computation.run(system, context, [groups.get_mutable_vector(index) for index in indices])

        self.DeclareInitializationDiscreteUpdateEvent(MethodType(write, self))

    def derivative(self, formula: Callable[..., Any], *reads: Any) -> None:
        """Declare the formula that returns the time derivative of the continuous state."""
        self._derivative = Computation(formula, reads, [self.states["continuous"].layout])

    def DoCalcTimeDerivatives(self, context: Context, derivatives: Any) -> None:
        """Compute the time derivatives of the continuous state; Drake calls this method."""
        if self._derivative is None:
            return
        # NumPy issues spurious floating-point warnings for arithmetic on arrays of objects.
        with np.errstate(all=None if self.scalar is float else "ignore"):
            rates = BasicVector_[self.scalar](derivatives.size())
            self._derivative.run(self, context, [rates])
        derivatives.get_mutable_vector().SetFromVector(rates.CopyToVector())

    def reset(self, context: Context, parameters: Any) -> None:
        """Set numeric parameters and state in a context to those of a new system that is constructed with `parameters`.

        Args:
            context: context of this system.
            parameters: record of numbers, as for the constructor. Instead of a number, the record may contain an (N,)
                array with the number of each vehicle.
        """
        self.set_parameters(context, parameters)
        for part in self.states.values():
            part.mutable_vector(context).SetFromVector(self._elements(part.layout, part.recipe(parameters)))

    def set_parameters(self, context: Context, parameters: Any) -> None:
        """Set the numeric parameters in a context to those of a new system that is constructed with `parameters`.

        Args:
            context: context of this system.
            parameters: record of numbers, as for the constructor. Instead of a number, the record may contain an (N,)
                array with the number of each vehicle.
        """
        for part in self.parameters.values():
            part.mutable_vector(context).SetFromVector(self._elements(part.layout, part.recipe(parameters)))

    def get_parameter(self, context: Context, name: str) -> Any:
        """Return a copy of a numeric parameter, as a record."""
        return self._record(lookup(self.parameters, name, "parameter"), context)

    def set_parameter(self, context: Context, name: str, record: Any) -> None:
        """Set a numeric parameter to a record; each row is a number for all vehicles, or an (N,) array."""
        parameter = lookup(self.parameters, name, "parameter")
        parameter.mutable_vector(context).SetFromVector(self._elements(parameter.layout, record))

    def get_state(self, context: Context, name: str) -> Any:
        """Return a copy of a state group, as a record."""
        return self._record(lookup(self.states, name, "group of the state"), context)

    def set_state(self, context: Context, name: str, record: Any) -> None:
        """Set a state group to a record; each row is a number for all vehicles, or an (N,) array."""
        group = lookup(self.states, name, "group of the state")
        group.mutable_vector(context).SetFromVector(self._elements(group.layout, record))

    def _record(self, part: Parameter | StateGroup, context: Context) -> Any:
        elements = part.vector(self, context).CopyToVector()
        rows = elements.tolist() if self.num_vehicles == 1 else elements.reshape(-1, self.num_vehicles)
        return part.layout.build(rows)

    def _elements(self, layout: Layout, record: Any) -> np.ndarray:
        return pack_rows(layout.flatten(record), self.num_vehicles).astype(self.scalar)

    def _vector(self, layout: Layout, record: Any) -> Any:
        return BasicVector_[self.scalar](self._elements(layout, record))

    def _model(self, layout: Layout) -> Any:
        return BasicVector_[self.scalar](layout.num_rows * self.num_vehicles)


def _layout_of_target(target: Any) -> Layout:
    """Return a layout unchanged, the layout of a state group, or `ABSENT` for a group that is not declared."""
    if isinstance(target, Layout):
        return target
    return target.layout if isinstance(target, StateGroup) else ABSENT


def _layout_of_signal(name: str) -> Layout:
    return layout_of(lookup(SIGNALS, name, "signal"))


class RandomInput(NamedTuple):
    """Properties of a random input port.

    Attributes:
        num_rows: number of random numbers for each vehicle.
        distribution: distribution of each random number.
        period: period at which new random numbers are used, s.
    """

    num_rows: int
    distribution: RandomDistribution
    period: float


class Update(NamedTuple):
    """Periodic update of the discrete state.

    Attributes:
        period: period of the update, s.
        computation: formula, its arguments, and the state groups that it updates.
        unrestricted: True for an update that precedes all discrete updates of the same instant.
        at_start: True if the update also takes place at time zero.
    """

    period: float
    computation: Computation
    unrestricted: bool
    at_start: bool


# Names of Drake's methods that declare events for a simulator.
_EVENT_METHODS = [
    f"Declare{when}{what}Event"
    for when in ("Initialization", "Periodic", "PerStep")
    for what in ("", "DiscreteUpdate", "Publish", "UnrestrictedUpdate")
]


def _counted(declare: Callable[..., None]) -> Callable[..., None]:
    """Wrap a Drake method that declares events, to count these events."""

    def counted(self: FleetSystem, *args: Any, **options: Any) -> None:
        """Call Drake's method of the same name, which declares an event, and increase `num_events` by one.

        :meta private:
        """
        self.num_events += 1
        declare(self, *args, **options)

    return counted


@contextmanager
def _without_module_search() -> Iterator[None]:
    """Skip Drake's search for the module in which a template is instantiated.

    The search reads the source file of every caller, which took half of this package's import time.
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
    """Return the signature of a system's constructor: the number of vehicles, then the arguments of `declare`."""
    _, *declared = inspect.signature(cls.declare).parameters.values()
    num_vehicles = inspect.Parameter("num_vehicles", inspect.Parameter.POSITIONAL_OR_KEYWORD, default=1, annotation=int)
    options = (parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY) for parameter in declared)
    return inspect.Signature([num_vehicles, *options])


def fleet_system(*scalars: type) -> Callable[[type[FleetSystem]], Any]:
    """Return a class decorator that converts a FleetSystem to a Drake system with scalar conversion.

    The decorator returns the class for the first scalar type. The attribute `template` of this class contains the
    classes for all scalar types.

    Args:
        scalars: supported scalar types; the first must be float.
    """

    def decorate(cls: type[FleetSystem]) -> Any:
        template = TemplateSystem(f"{cls.__name__}_", T_list=list(scalars), scope=sys.modules[cls.__module__])
        signature = _constructor_signature(cls)
        parameters = signature.parameters.get("parameters")
        default = None if parameters is None or parameters.default is parameters.empty else parameters.default

        def instantiate(param: tuple[type]) -> type:
            (T,) = param

            class Impl(cls, LeafSystem_[T]):  # type: ignore[misc, valid-type]
                __doc__ = cls.__doc__
                scalar = T

                def _construct(self, num_vehicles: int = 1, *, converter: Any = None, **options: Any) -> None:
                    LeafSystem_[T].__init__(self, converter)
                    self.num_vehicles, self._options = num_vehicles, options
                    self.structure = {name: value for name, value in options.items() if name != "parameters"}
                    self.begin()
                    self._parameter_record = options.get("parameters", default)
                    if T is float:
                        check_signs(self._parameter_record)
                    self.declare(**options)

                def _construct_copy(self, other: Any, converter: Any = None) -> None:
                    Impl._construct(self, other.num_vehicles, converter=converter, **other._options)

            for name in _EVENT_METHODS:
                setattr(Impl, name, _counted(getattr(LeafSystem_[T], name)))
            return Impl

        template.add_instantiations(instantiate, [(T,) for T in scalars])
        with _without_module_search():
            instance = template[scalars[0]]
        instance.template = template
        instance.__name__ = instance.__qualname__ = cls.__name__
        instance.__signature__ = signature
        return instance

    return decorate
