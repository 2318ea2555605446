"""Force and torque on a vehicle that other systems compute, such as the downwash of other vehicles."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

from drake_quad.geometry.axes import Vector
from drake_quad.signals import SIGNALS, ForceB, TorqueB
from drake_quad.vehicle.aerodynamics import Flow, Load


class ExternalLoad(NamedTuple):
    """Force at the centre of mass and torque, along the axes of B. It is constant during a time step."""

    f_x: ForceB = 0.0
    f_y: ForceB = 0.0
    f_z: ForceB = 0.0
    tau_x: TorqueB = 0.0
    tau_y: TorqueB = 0.0
    tau_z: TorqueB = 0.0

    def load(self, flow: Flow) -> Load:
        """Return the load, which does not depend on the air."""
        return Load(Vector(self.f_x, self.f_y, self.f_z), Vector(self.tau_x, self.tau_y, self.tau_z))


SIGNALS["external_load"] = ExternalLoad


@dataclass(frozen=True)
class WithExternalLoad:
    """Function that calls a formula with an external load as an additional effect.

    Attributes:
        formula: formula of the vehicle.
        position: position of the effects among its arguments.
    """

    formula: Callable[..., Any]
    position: int

    def __call__(self, load: ExternalLoad, *arguments: Any) -> Any:
        """Return the result of the formula, given the load and the arguments of the formula."""
        loaded = [
            value._replace(loads=(*value.loads, load)) if position == self.position else value
            for position, value in enumerate(arguments)
        ]
        return self.formula(*loaded)
