"""A LeafSystem that carries many vehicles and converts its scalar type.

A port with k rows has k·N elements, row after row (C order, shape (k, N)); for one vehicle that is the plain
k-vector. `FleetSystem.rows` unpacks such a vector into k rows and `FleetSystem.write` packs rows into one, so that
the formulas in between are written once: a row is a Python number for one vehicle and an array for a fleet.

A row of a numeric parameter that is the same for all vehicles is a single number, in the context as in the formulas:
what does not differ is neither stored nor read N times.

All the boilerplate of Drake's scalar conversion in Python is here.
"""

import sys
from collections.abc import Callable, Iterable, Mapping
from types import MethodType
from typing import TYPE_CHECKING, Any

import numpy as np
from pydrake.autodiffutils import AutoDiffXd
from pydrake.common import RandomDistribution
from pydrake.symbolic import Expression
from pydrake.systems.framework import BasicVector_, DiagramBuilder, DiscreteStateIndex, LeafSystem_
from pydrake.systems.primitives import Demultiplexer
from pydrake.systems.scalar_conversion import TemplateSystem

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
    num_vehicles: int
    rows: Callable[[Any], Any]
    write: Callable[[Any, Iterable[Row]], None]
    copy: Callable[[Any, Any], None]
    plain: bool
    parts: dict[str, int]
    random_inputs: dict[str, RandomDistribution]
    group_names: list[str]
    _layouts: dict[int, list[int | slice] | None]

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

        It has one element for a number, which stands for all vehicles, and N for an (N,) array.
        """
        parts = [np.atleast_1d(row) for row in rows]
        for part in parts:
            if part.shape not in ((1,), (self.num_vehicles,)):
                raise ValueError(f"a parameter must be a number or an array of {self.num_vehicles}, not {part.shape}")
        vector = BasicVector_[self.scalar](np.concatenate(parts).astype(self.scalar))
        index = int(self.DeclareNumericParameter(vector))
        ends = np.cumsum([len(part) for part in parts]).tolist()
        places: list[int | slice] = [
            first if end - first == 1 else slice(first, end) for first, end in zip([0, *ends], ends, strict=False)
        ]
        self._layouts[index] = None if vector.size() == len(parts) else places
        return index

    def input_rows(self, context: Any, index: int) -> Any:
        """The rows of an input port's value."""
        vector = self.EvalVectorInput(context, index)
        return vector.value().tolist() if self.plain else self.rows(vector)

    def optional_input_rows(self, context: Any, index: int, *, default: Any) -> Any:
        """The rows of an input port's value, or the default where nothing is connected."""
        vector = self.EvalVectorInput(context, index)
        if vector is None:
            return default
        return vector.value().tolist() if self.plain else self.rows(vector)

    def parameter_rows(self, context: Any, index: int) -> Any:
        """The rows of a numeric parameter: a number for all vehicles, or a view of an array for a float."""
        vector, layout = context.get_numeric_parameter(index), self._layouts[index]
        values = vector.value() if self.scalar is float else vector.CopyToVector()
        if layout is None:
            return values.tolist()
        return [values.item(place) if place.__class__ is int else values[place] for place in layout]

    def write_parameter(self, context: Any, index: int, rows: Iterable[Row]) -> None:
        """Writes rows into a numeric parameter: a number for what is one for all vehicles, else also (N,) arrays."""
        layout = self._layouts[index]
        vector = context.get_mutable_numeric_parameter(index)
        values = self.values(vector).copy()
        for place, row in zip(layout or range(len(values)), rows, strict=True):
            if np.ndim(row) and not isinstance(place, slice):
                raise ValueError("a parameter that was one number for all vehicles at construction must stay one")
            values[place] = row
        vector.SetFromVector(values)

    def state_rows(self, context: Any, index: int) -> Any:
        """The rows of a discrete-state group."""
        vector = context.get_discrete_state(index)
        return vector.value().tolist() if self.plain else self.rows(vector)

    def values(self, vector: Any) -> np.ndarray:
        """The elements of a BasicVector: a view for float, a copy for the other scalar types."""
        return vector.value() if self.scalar is float else vector.CopyToVector()

    def packed(self, rows: Iterable[Row]) -> np.ndarray:
        """The rows as a vector of this system's scalar type; a number stands for a row of equal numbers."""
        return fleet_rows(rows, self.num_vehicles).astype(self.scalar)

    def vector(self, rows: Iterable[Row]) -> Any:
        """The rows as a BasicVector."""
        return BasicVector_[self.scalar](self.packed(rows))


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

                def _construct(self, *, converter: Any = None, num_vehicles: int = 1, **options: Any) -> None:
                    LeafSystem_[T].__init__(self, converter)
                    self.num_vehicles = num_vehicles
                    # Called thousands of times a second: what they depend on is decided here.
                    self.rows, self.write = _reader(T, num_vehicles), _writer(T, num_vehicles)
                    self.copy = _copier(T, num_vehicles)
                    # One vehicle of plain numbers is worth a short cut past `rows`.
                    self.plain = T is float and num_vehicles == 1
                    self._options = options
                    self._layouts: dict[int, list[int | slice] | None] = {}
                    self.random_inputs: dict[str, RandomDistribution] = {}
                    self.group_names: list[str] = []
                    self.declare(num_vehicles=num_vehicles, **options)

                def _construct_copy(self, other: Any, converter: Any = None) -> None:
                    Impl._construct(self, converter=converter, num_vehicles=other.num_vehicles, **other._options)

            return Impl

        template.add_instantiations(instantiate, [(T,) for T in scalars])
        instance = template[scalars[0]]
        instance.template = template
        instance.__name__ = instance.__qualname__ = cls.__name__
        return instance

    return decorate
