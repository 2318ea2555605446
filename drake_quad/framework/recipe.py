"""Recipe for a system: its class, its structure and its numbers."""

from typing import Any, NamedTuple

from pydrake.systems.framework import Context, Diagram

from drake_quad.framework.wiring import subsystem


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
