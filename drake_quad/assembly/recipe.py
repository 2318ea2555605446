"""Recipes for systems: from the fields of a scenario to what a system is made of."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from pydrake.systems.framework import Context, Diagram

from drake_quad.framework.wiring import subsystem
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.distributions import Distribution, Model
from drake_quad.scenario.paths import joined


class FleetScenario:
    """A scenario as a fleet flies it: where numbers vary from vehicle to vehicle, a field is an (N,) array.

    Fields are attributes, as in the scenario, and lists are tuples. Only the assembly of diagrams sees this; a scenario
    that is written out, planned for or shown has numbers in all its fields.

    Args:
        batch: that is flown.
    """

    def __init__(self, batch: Batch) -> None:
        self._value: Any = batch.scenario
        self._path, self._varying = "", batch.varying

    def __getattr__(self, name: str) -> Any:
        return _inside(getattr(self._value, name), joined(self._path, name), self._varying)


def _inside(value: Any, path: str, varying: Mapping[str, np.ndarray]) -> Any:
    if path in varying:
        return varying[path]
    if isinstance(value, tuple):
        return tuple([_inside(item, joined(path, i), varying) for i, item in enumerate(value)])
    if isinstance(value, Model) and not isinstance(value, Distribution):
        part = FleetScenario.__new__(FleetScenario)
        part._value, part._path, part._varying = value, path, varying
        return part
    return value


class Recipe(NamedTuple):
    """Recipe for a system.

    Attributes:
        system: its class, a FleetSystem.
        structure: which ports and events it has, as arguments of its constructor.
        numbers: what may differ from vehicle to vehicle; each row may be an (N,) array. None for a system without any.
    """

    system: Any
    structure: dict[str, Any]
    numbers: Any

    def build(self, num_vehicles: int) -> Any:
        """The system, for N vehicles."""
        numbers = {} if self.numbers is None else {"numbers": self.numbers}
        return self.system(num_vehicles=num_vehicles, **self.structure, **numbers)

    def reset(self, diagram: Diagram, path: str, context: Context) -> None:
        """Makes the context of a system of this recipe what it would be, had the system been made of these numbers.

        Args:
            diagram: that has the system.
            path: of the system in the diagram.
            context: of a diagram around it.

        Raises:
            ValueError: the system has been built for other ports or events than the numbers need.
        """
        system = subsystem(diagram, path.split("."))
        if system.structure != self.structure:
            raise ValueError(f"{path} was built with {system.structure}, but these numbers need {self.structure}")
        system.reset(system.GetMyMutableContextFromRoot(context), self.numbers)
