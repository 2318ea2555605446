"""A system to be: its class and the numbers that it is made of."""

from typing import Any, NamedTuple

import numpy as np
from pydrake.systems.framework import Diagram
from pydrake.systems.primitives import ConstantVectorSource

from drake_quad.defaults import put_defaults


class Part(NamedTuple):
    """A system of a scenario.

    Attributes:
        system: its class, a FleetSystem or Drake's ConstantVectorSource.
        options: arguments of its constructor; numbers may be arrays, an entry a vehicle.
    """

    system: Any
    options: dict[str, Any]

    def build(self) -> Any:
        """The system."""
        return self.system(**self.options)

    def put(self, system: Any, context: Any) -> None:
        """Makes a context of a system of this part what it would be, had the system been made of these numbers."""
        if self.system is ConstantVectorSource:
            system.get_mutable_source_value(context).SetFromVector(np.asarray(self.options["source_value"]))
        else:
            options = {name: value for name, value in self.options.items() if name != "num_vehicles"}
            put_defaults(system, context, **options)


def subsystem(diagram: Diagram, path: str) -> Any:
    """The subsystem at a path, such as `laboratory.vehicle`."""
    system: Any = diagram
    for name in path.split("."):
        system = system.GetSubsystemByName(name)
    return system
