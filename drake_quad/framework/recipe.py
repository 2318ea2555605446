"""Recipes, which describe how to build systems and how to reset their contexts."""

from typing import Any, NamedTuple

from pydrake.systems.framework import Context, Diagram

from drake_quad.framework.wiring import subsystem


class Recipe(NamedTuple):
    """Recipe for a system.

    Attributes:
        system: class of the system, a `FleetSystem`; or a function that returns another Drake system.
        structure: arguments of the constructor that determine ports and events.
        parameters: record of numbers, each of which may be an (N,) array; None if the system has no argument
            `parameters`.
    """

    system: Any
    structure: dict[str, Any]
    parameters: Any

    def build(self, num_vehicles: int) -> Any:
        """Return the system for N vehicles."""
        parameters = {} if self.parameters is None else {"parameters": self.parameters}
        return self.system(num_vehicles=num_vehicles, **self.structure, **parameters)

    def reset(self, diagram: Diagram, path: str, context: Context) -> None:
        """Reset a system's context to the default context of a system that this recipe would build.

        Args:
            diagram: diagram that contains the system.
            path: path of the system in the diagram.
            context: context of the diagram.

        Raises:
            ValueError: if the system's structure differs from the recipe's.
        """
        system = subsystem(diagram, path.split("."))
        if not hasattr(system, "structure"):
            system.SetDefaultContext(system.GetMyMutableContextFromRoot(context))
            return
        if system.structure != self.structure:
            raise ValueError(f"{path} was built with {system.structure}, but this recipe requires {self.structure}")
        system.reset(system.GetMyMutableContextFromRoot(context), self.parameters)
