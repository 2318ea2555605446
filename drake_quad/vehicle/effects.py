"""What acts on a vehicle beside the paper's equations, each by itself switched on or off."""

from collections.abc import Sequence
from typing import Annotated, NamedTuple

from drake_quad.signals import PositionW, Quantity, Row
from drake_quad.vehicle.aerodynamics import BodyDrag, GroundEffect, RotorAerodynamics, ground_effect
from drake_quad.vehicle.battery import Battery
from drake_quad.vehicle.motors import SpinDown, ThrustCurve
from drake_quad.vehicle.parameters import CentreOfMass, QuadrotorParameters
from drake_quad.vehicle.payload import Payload, whole
from drake_quad.vehicle.slung_load import SlungLoad


class ReactionTorque(NamedTuple):
    """The reaction of the body to rotors that accelerate: τ_z -= J_r dω_r/dt.

    Attributes:
        rotor_inertia: J_r of one rotor with its motor, as in `QuadrotorParameters`.
    """

    rotor_inertia: Annotated[Row, Quantity("kg m²")]


class Effects(NamedTuple):
    """The numbers of what is switched on; None for what is off.

    Attributes:
        body_drag: drag of the body, each axis by itself, at a centre of pressure.
        rotor_aerodynamics: lift, climb, drag and inflow of the rotors.
        ground_effect: thrust that rotors gain close above the ground.
        reaction_torque: of rotors that accelerate.
        spin_down: a lag of its own for rotors that slow down.
        thrust_curve: the motors take throttles.
        payload: a mass that is picked up or dropped.
        battery: that is drawn empty.
        slung_load: a load on a cable.
    """

    body_drag: BodyDrag | None = None
    rotor_aerodynamics: RotorAerodynamics | None = None
    ground_effect: GroundEffect | None = None
    reaction_torque: ReactionTorque | None = None
    spin_down: SpinDown | None = None
    thrust_curve: ThrustCurve | None = None
    payload: Payload | None = None
    battery: Battery | None = None
    slung_load: SlungLoad | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """The names of what is switched on."""
        return tuple(name for name, numbers in self._asdict().items() if numbers is not None)

    @property
    def load_the_body(self) -> bool:
        """True if there are forces on the body other than those of the paper's equations."""
        loads = self.body_drag, self.rotor_aerodynamics, self.payload, self.slung_load
        return any(numbers is not None for numbers in loads)

    def only(self, names: Sequence[str]) -> "Effects":
        """The effects of these names.

        Raises:
            ValueError: one of them has no numbers.
        """
        for name in names:
            if getattr(self, name) is None:
                raise ValueError(f"the effect {name} has no numbers")
        return Effects(**{name: getattr(self, name) for name in names})


NO_EFFECTS = Effects()


def as_in_hover(parameters: QuadrotorParameters, effects: Effects, height: PositionW) -> QuadrotorParameters:
    """The parameters of a vehicle without effects whose rotors turn as fast in hover, at the beginning of a flight.

    Args:
        parameters: of the vehicle.
        effects: on it.
        height: at which it hovers, m.
    """
    mass, (x, y) = parameters.mass, parameters.centre_of_mass
    if effects.payload is not None:
        body = whole(mass, parameters.inertia, effects.payload, 0.0)
        mass, x, y = body.mass, x + body.centre.x, y + body.centre.y
    if effects.slung_load is not None:
        mass = mass + effects.slung_load.mass
    if effects.ground_effect is not None:
        mass = mass / ground_effect(height, effects.ground_effect)
    return parameters._replace(mass=mass, centre_of_mass=CentreOfMass(x, y))
