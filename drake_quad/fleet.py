"""A LeafSystem that carries many vehicles and converts its scalar type.

A port with k rows has k·N elements, row after row (C order, shape (k, N)); for one vehicle that is the plain
k-vector. `FleetSystem.rows` unpacks such a vector into k rows and `FleetSystem.write` packs rows into one, so that
the formulas in between are written once: a row is a Python number for one vehicle and an array for a fleet.

A numeric parameter that is the same for all vehicles has k elements, not k·N, and its rows are numbers.

Where it counts, a formula is applied to a fleet by machine code: `FleetSystem.mapped`.

All the boilerplate of Drake's scalar conversion in Python is here.
"""

import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from types import MethodType
from typing import TYPE_CHECKING, Any

import numpy as np
from pydrake.autodiffutils import AutoDiffXd
from pydrake.common import RandomDistribution, cpp_template
from pydrake.symbolic import Expression
from pydrake.systems.framework import BasicVector_, DiagramBuilder, DiscreteStateIndex, LeafSystem_
from pydrake.systems.primitives import Demultiplexer
from pydrake.systems.scalar_conversion import TemplateSystem

from drake_quad.compiled import fleet_map, stays_python
from drake_quad.elementary import Row

if TYPE_CHECKING:
    from pydrake.systems.framework import LeafSystem as _Base
else:
    _Base = object

__all__ = ["AutoDiffXd", "Expression", "FleetSystem", "fleet_rows", "fleet_system", "split_output"]


class FleetSystem(_Base):
    """What the systems of this project have in common; a subclass is made a Drake system by `fleet_system`.

    A subclass defines `declare(self, *, num_vehicles=1, ...)` in place of a constructor: it is called with the
    keyword arguments of the constructor, and again with the same ones on the converted copy.
    """

    scalar: type
    declared_by: Any
    num_vehicles: int
    rows: Callable[[Any], Any]
    write: Callable[[Any, Iterable[Row]], None]
    copy: Callable[[Any, Any], None]
    parts: dict[str, int]
    random_inputs: dict[str, RandomDistribution]
    group_names: list[str]
    _parameter_rows: dict[int, int]

    def declare(self, *args: Any, **options: Any) -> None:
        """Declares ports, state, parameters and events; every subclass has its own."""

    def input(self, name: str, rows: int) -> int:
        """Declares an input port of that many rows and returns its index."""
        return int(self.DeclareVectorInputPort(name, self.vector([0.0] * rows)).get_index())

    def random_input(self, name: str, rows: int, distribution: RandomDistribution) -> int:
        """Declares an input port for random numbers, as Drake's RandomSource gives them, and returns its index."""
        self.random_inputs[name] = distribution
        return int(self.DeclareVectorInputPort(name, self.vector([0.0] * rows), distribution).get_index())

    def output(self, name: str, rows: int, calc: Callable[..., None], *, uses: Iterable[Any]) -> Any:
        """Declares and returns an output port of that many rows, computed from what the tickets stand for."""
        return self.DeclareVectorOutputPort(name, self.vector([0.0] * rows), calc, set(uses))

    def packed_output(
        self, name: str, parts: Mapping[str, int], calc: Callable[..., None], *, uses: Iterable[Any]
    ) -> None:
        """Declares an output port that holds several parts, each of so many rows, for `split_output` to take apart."""
        self.parts = dict(parts)
        self.output(name, sum(parts.values()), calc, uses=uses)

    def discrete_state(self, name: str, rows: Iterable[Row]) -> int:
        """Declares a discrete-state group with these rows as default and returns its index."""
        self.group_names.append(name)
        return int(self.DeclareDiscreteState(self.vector(rows)))

    def state_output(self, rows: int, index: int) -> None:
        """Declares an output port that shows a discrete-state group of that many rows, under its name."""
        group, name = DiscreteStateIndex(index), self.group_names[index]
        if self.num_vehicles == 1:
            self.DeclareStateOutputPort(name, group)
            return

        # Drake would make a virtual call for every element.
        def show(system: FleetSystem, context: Any, output: Any) -> None:
            system.copy(output, context.get_discrete_state(index))

        self.output(name, rows, MethodType(show, self), uses={self.discrete_state_ticket(group)})

    def numeric_parameter(self, rows: Iterable[Row]) -> int:
        """Declares a numeric parameter with these rows as default and returns its index.

        It has an element for each row if all are numbers, which stand for all vehicles, and else N for each.
        """
        rows = list(rows)
        for row in rows:
            if np.shape(row) not in ((), (1,), (self.num_vehicles,)):
                raise ValueError(
                    f"a parameter must be a number or an array of {self.num_vehicles}, not {np.shape(row)}"
                )
        width = max(np.size(row) for row in rows)
        index = int(
            self.DeclareNumericParameter(BasicVector_[self.scalar](fleet_rows(rows, width).astype(self.scalar)))
        )
        self._parameter_rows[index] = len(rows)
        return index

    def parameter_rows(self, context: Any, index: int) -> Any:
        """The rows of a numeric parameter: numbers that stand for all vehicles, or arrays."""
        values = self.values(context.get_numeric_parameter(index))
        num_rows = self._parameter_rows[index]
        return values.tolist() if len(values) == num_rows else values.reshape(num_rows, -1)

    def parameter_table(self, context: Any, index: int) -> np.ndarray:
        """The (k, N) elements of a numeric parameter, or (k, 1) that stand for all vehicles."""
        return self.values(context.get_numeric_parameter(index)).reshape(self._parameter_rows[index], -1)

    def write_parameter(self, context: Any, index: int, rows: Iterable[Row]) -> None:
        """Writes rows into a numeric parameter: numbers, and (N,) arrays if one of them was one at construction."""
        rows, vector = list(rows), context.get_mutable_numeric_parameter(index)
        width = vector.size() // self._parameter_rows[index]
        if any(np.size(row) > width for row in rows):
            raise ValueError("parameters that were numbers for all vehicles at construction must stay numbers")
        vector.SetFromVector(fleet_rows(rows, width).astype(self.scalar))

    def mapped(
        self, formula: Callable[..., Any], *, inputs: Sequence[int], outputs: Sequence[int]
    ) -> Callable[..., None]:
        """Returns the function that applies a formula to every vehicle, as machine code for float.

        It takes a sequence of BasicVectors or arrays to write; a sequence of them to read, one for each group of rows
        that the formula takes, where None stands for zeros; and the formula's numbers.

        Args:
            formula: as in `drake_quad.compiled`.
            inputs: rows of each group that it takes.
            outputs: rows of each group that it returns.
        """
        if self.scalar is not float or stays_python(formula):
            return self.interpreted(formula, inputs=inputs)
        apply, num_vehicles = fleet_map(formula, tuple(inputs), tuple(outputs)), self.num_vehicles
        zeros = [BasicVector_[float](np.zeros(rows)).value() for rows in inputs]

        def apply_to_vectors(targets: Sequence[Any], sources: Sequence[Any], *numbers: float) -> None:
            apply(
                num_vehicles,
                tuple([_elements_to_write(vector) for vector in targets]),
                tuple([_elements(vector, zero) for vector, zero in zip(sources, zeros)]),
                numbers,
            )

        return apply_to_vectors

    def interpreted(self, formula: Callable[..., Any], *, inputs: Sequence[int]) -> Callable[..., None]:
        """The same without machine code, which would take longer to make for what happens once in a flight."""
        return partial(_apply, formula, tuple(inputs), self.num_vehicles, self.write)

    def parameter(self, context: Any, index: int | None) -> Any:
        """The BasicVector of a numeric parameter; None where there is none."""
        return None if index is None else context.get_numeric_parameter(index)

    def inputs(self, context: Any, *indices: int | None) -> list[Any]:
        """The BasicVectors at input ports; None where there is no port, or nothing connected."""
        return [None if index is None else self.EvalVectorInput(context, index) for index in indices]

    def some_rows(self, vector: Any, rows: Sequence[int]) -> np.ndarray:
        """The elements of some rows of a BasicVector, row after row; a view for neighbours."""
        values, n = self.values(vector), self.num_vehicles
        if rows[-1] - rows[0] < len(rows):
            return values[rows[0] * n : (rows[-1] + 1) * n]
        return values.reshape(-1, n)[rows].ravel()

    def values(self, vector: Any) -> np.ndarray:
        """The elements of a BasicVector: a view for float, a copy for the other scalar types."""
        return vector.value() if self.scalar is float else vector.CopyToVector()

    def values_to_change(self, vector: Any) -> np.ndarray:
        """The same of a mutable BasicVector, to be changed: in place for float, else to be written back."""
        return vector.get_mutable_value() if self.scalar is float else vector.CopyToVector()

    def packed(self, rows: Iterable[Row]) -> np.ndarray:
        """The rows as a vector of this system's scalar type; a number stands for a row of equal numbers."""
        return fleet_rows(rows, self.num_vehicles).astype(self.scalar)

    def vector(self, rows: Iterable[Row]) -> Any:
        """The rows as a BasicVector."""
        return BasicVector_[self.scalar](self.packed(rows))


def _elements_to_write(vector: Any) -> np.ndarray:
    elements: np.ndarray = vector if vector.__class__ is np.ndarray else vector.get_mutable_value()
    return elements


def _elements(vector: Any, zeros: np.ndarray) -> np.ndarray:
    if vector is None:
        return zeros
    elements: np.ndarray
    if vector.__class__ is not np.ndarray:
        elements = vector.value()
    else:
        # Machine code wants arrays of one type, and Drake 1.51 gives out what must not be written.
        elements = vector.view()
        elements.flags.writeable = zeros.flags.writeable and vector.flags.writeable
    return elements


def _apply(
    formula: Callable[..., Any],
    inputs: Sequence[int],
    num_vehicles: int,
    write: Callable[[Any, Iterable[Row]], None],
    targets: Sequence[Any],
    sources: Sequence[Any],
    *numbers: Any,
) -> None:
    """Applies a formula to the rows of BasicVectors or arrays; see `FleetSystem.mapped`."""
    groups = []
    for vector, rows in zip(sources, inputs, strict=True):
        if vector is None:
            groups.append((0.0,) * rows)
        else:
            values = vector if isinstance(vector, np.ndarray) else vector.CopyToVector()
            groups.append(tuple(values.tolist() if len(values) == rows else values.reshape(rows, -1)))
    result = [row for group in formula(*groups, *numbers) for row in group]
    for target in targets:
        if isinstance(target, np.ndarray):
            rows = target.size // num_vehicles
            target[:] = fleet_rows(result[:rows], num_vehicles)
        else:
            rows = target.size() // num_vehicles
            write(target, result[:rows])
        del result[:rows]


def _reader(scalar: type, num_vehicles: int) -> Callable[[Any], Any]:
    """The function that gives the rows of a BasicVector: Python numbers for one vehicle, arrays for a fleet.

    Rows of float arrays are views into the vector.
    """
    if num_vehicles > 1:
        if scalar is float:
            return lambda vector: vector.value().reshape(-1, num_vehicles)
        return lambda vector: vector.CopyToVector().reshape(-1, num_vehicles)
    if scalar is float:
        return lambda vector: vector.value().tolist()
    return lambda vector: vector.CopyToVector().tolist()


def _copier(scalar: type, num_vehicles: int) -> Callable[[Any, Any], None]:
    """The function that copies a BasicVector's elements into another."""

    def copy_elements(target: Any, source: Any) -> None:
        target.SetFrom(source)

    # SetFrom makes a virtual call for every element: the fastest for a few, the slowest for a fleet.
    def copy_block(target: Any, source: Any) -> None:
        target.get_mutable_value()[:] = source.value()

    return copy_block if scalar is float and num_vehicles > 1 else copy_elements


def _writer(scalar: type, num_vehicles: int) -> Callable[[Any, Iterable[Row]], None]:
    """The function that writes rows into a BasicVector; a number stands for a row of equal numbers."""

    def write_objects(vector: Any, rows: Iterable[Row]) -> None:
        vector.SetFromVector(fleet_rows(rows, num_vehicles).astype(scalar))

    def write_numbers(vector: Any, rows: Iterable[Row]) -> None:
        vector.get_mutable_value()[:] = rows

    def write_arrays(vector: Any, rows: Iterable[Row]) -> None:
        values = vector.get_mutable_value().reshape(-1, num_vehicles)
        if isinstance(rows, np.ndarray) and rows.ndim == 2:
            values[:] = rows
            return
        for i, row in enumerate(rows):
            values[i] = row

    if scalar is not float:
        return write_objects
    return write_numbers if num_vehicles == 1 else write_arrays


def split_output(builder: DiagramBuilder, name: str, system: Any) -> dict[str, Any]:
    """Adds a system with a packed output under a name, takes the output apart and returns a port for each part.

    Where several outputs follow from one computation, a system computes them together: a call into Python costs far
    more than Drake's Demultiplexer, which stands beside the system as `name` with `_parts` appended.
    """
    builder.AddNamedSystem(name, system)
    sizes = [rows * system.num_vehicles for rows in system.parts.values()]
    parts = builder.AddNamedSystem(f"{name}_parts", Demultiplexer(sizes))
    builder.Connect(system.get_output_port(), parts.get_input_port())
    return {part: parts.get_output_port(i) for i, part in enumerate(system.parts)}


def fleet_rows(rows: Iterable[Row], num_vehicles: int) -> np.ndarray:
    """Packs rows, each a number or (num_vehicles,), into a (rows · num_vehicles,) vector."""
    return np.concatenate([np.broadcast_to(row, (num_vehicles,)) for row in rows])


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


def fleet_system(*scalars: type) -> Callable[[type[FleetSystem]], Any]:
    """Makes a FleetSystem a Drake system for these scalar types, float first, that converts between them.

    The class that results is the one for float; its attribute `template` holds the others.
    """

    def decorate(cls: type[FleetSystem]) -> Any:
        template = TemplateSystem(f"{cls.__name__}_", T_list=list(scalars), scope=sys.modules[cls.__module__])

        def instantiate(param: tuple[type]) -> type:
            (T,) = param

            class Impl(cls, LeafSystem_[T]):  # type: ignore[misc, valid-type]
                __doc__ = cls.__doc__
                scalar = T
                declared_by = cls

                def _construct(self, *, converter: Any = None, num_vehicles: int = 1, **options: Any) -> None:
                    LeafSystem_[T].__init__(self, converter)
                    self.num_vehicles = num_vehicles
                    # Called thousands of times a second: what they depend on is decided here.
                    self.rows, self.write = _reader(T, num_vehicles), _writer(T, num_vehicles)
                    self.copy = _copier(T, num_vehicles)
                    self._options = options
                    self._parameter_rows: dict[int, int] = {}
                    self.random_inputs: dict[str, RandomDistribution] = {}
                    self.group_names: list[str] = []
                    self.declare(num_vehicles=num_vehicles, **options)

                def _construct_copy(self, other: Any, converter: Any = None) -> None:
                    Impl._construct(self, converter=converter, num_vehicles=other.num_vehicles, **other._options)

            return Impl

        template.add_instantiations(instantiate, [(T,) for T in scalars])
        with _quick_templates():
            instance = template[scalars[0]]
        instance.template = template
        instance.__name__ = instance.__qualname__ = cls.__name__
        return instance

    return decorate
