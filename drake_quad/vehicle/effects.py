"""Effects on a vehicle in addition to the paper's equations, each of which can be switched on."""

from collections.abc import Sequence
from typing import Annotated, NamedTuple

from drake_quad.signals import PositionW, Quantity, Row
from drake_quad.vehicle.aerodynamics import AirLoad, BodyDrag, GroundEffect, RotorAerodynamics, ground_effect
from drake_quad.vehicle.battery import Battery
from drake_quad.vehicle.motors import SpinDown, ThrustCurve
from drake_quad.vehicle.parameters import CentreOfMass, QuadrotorParameters
from drake_quad.vehicle.payload import Payload, loaded_body
from drake_quad.vehicle.slung_load import SlungLoad


class ReactionTorque(NamedTuple):
    """Reaction torque on the body when the rotors accelerate: τ_z -= J_r dω_r/dt.

    Attributes:
        rotor_inertia: moment of inertia J_r of one rotor with its motor, as in `QuadrotorParameters`.
    """

    rotor_inertia: Annotated[Row, Quantity("kg m²")]


class Effects(NamedTuple):
    """Parameters of the effects that are switched on; None for an effect that is switched off.

    Effects that the equations of motion treat individually have a field each. All other effects are in `loads`.

    Attributes:
        body_drag: drag of the body along each of its axes, at a centre of pressure.
        rotor_aerodynamics: lift, climb, drag and inflow of the rotors.
        ground_effect: increase of thrust close to the ground.
        reaction_torque: reaction torque of accelerating rotors.
        spin_down: time constant of decelerating rotors.
        thrust_curve: thrust as a function of the throttle, for motors that are commanded by throttles.
        payload: mass that is picked up or dropped.
        battery: battery that the rotors discharge.
        slung_load: load on a cable.
        loads: further loads that depend on the air and on the rotors, such as user-defined loads.
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
    loads: tuple[AirLoad, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects that are switched on."""
        return tuple(name for name, parameters in self._asdict().items() if parameters is not None and parameters != ())

    @property
    def air_loads(self) -> tuple[AirLoad, ...]:
        """All loads that depend on the air and on the rotors."""
        paper_loads = self.body_drag, self.rotor_aerodynamics
        return (*(load for load in paper_loads if load is not None), *self.loads)

    @property
    def depend_on_height(self) -> bool:
        """True if an effect can depend on the height of the vehicle."""
        return self.ground_effect is not None or bool(self.loads)

    @property
    def add_body_forces(self) -> bool:
        """True if forces act on the body that the paper's equations do not contain."""
        return bool(self.air_loads) or self.payload is not None or self.slung_load is not None

    def only(self, names: Sequence[str]) -> "Effects":
        """Return these effects with all except the named effects switched off.

        Raises:
            ValueError: if a named effect is switched off.
        """
        for name in names:
            if name not in self.names:
                raise ValueError(f"no parameters are given for the effect {name}")
        return Effects(**{name: getattr(self, name) for name in names})


NO_EFFECTS = Effects()
"""Effects that are all switched off."""


def hover_equivalent(parameters: QuadrotorParameters, effects: Effects, height: PositionW) -> QuadrotorParameters:
    """Return the parameters of a vehicle without effects that hovers at the same rotor speeds.

    The result accounts for a payload that is attached at time zero, for a slung load and for ground effect.

    Args:
        parameters: parameters of the vehicle.
        effects: effects on the vehicle.
        height: height of the hover, m.
    """
    mass, (x, y) = parameters.mass, parameters.centre_of_mass
    if effects.payload is not None:
        body = loaded_body(mass, parameters.inertia, effects.payload, 0.0)
        mass, x, y = body.mass, x + body.centre.x, y + body.centre.y
    if effects.slung_load is not None:
        mass = mass + effects.slung_load.mass
    if effects.ground_effect is not None:
        mass = mass / ground_effect(height, effects.ground_effect)
    return parameters._replace(mass=mass, centre_of_mass=CentreOfMass(x, y))
