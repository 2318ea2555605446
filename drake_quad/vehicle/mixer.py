"""Which squared rotor speeds give a wrench: the inverse of eq (5)."""

from typing import Annotated, NamedTuple

from drake_quad.geometry.axes import Vector, cross, dot, minus
from drake_quad.signals import Quantity, Row
from drake_quad.vehicle.parameters import CentreOfMass, QuadrotorParameters
from drake_quad.vehicle.rotors import Rotor


class PerWrench(NamedTuple):
    """What a rotor has to add to its squared speed (rad²/s²) for each unit of a wrench."""

    thrust: Annotated[Row, Quantity("rad²/(N s²)")]
    tau_x: Annotated[Row, Quantity("rad²/(N m s²)")]
    tau_y: Annotated[Row, Quantity("rad²/(N m s²)")]
    tau_z: Annotated[Row, Quantity("rad²/(N m s²)")]


class Mixer(NamedTuple):
    """The inverse of eq (5): from a wrench to the squared speeds of the rotors."""

    rotor_1: PerWrench
    rotor_2: PerWrench
    rotor_3: PerWrench
    rotor_4: PerWrench


def mixer_of(parameters: QuadrotorParameters) -> Mixer:
    """Inverts eq (5) for any layout of rotors.

    The torque over the thrust is the mean of the rotors' levers, weighted by their thrusts: the thrusts are the
    barycentric coordinates of the wrench in the tetrahedron of the four levers. What a rotor carries is the distance
    from the face of the others, over its own.

    Args:
        parameters: of a vehicle; the levers of its rotors span a tetrahedron, see `drake_quad.vehicle.authority`.
    """
    rotors, centre = parameters.rotors, parameters.centre_of_mass
    levers = [_lever(rotor, centre) for rotor in rotors]
    rows = []
    for rotor, lever in zip(rotors, levers, strict=True):
        a, b, c = (other for other in levers if other is not lever)
        normal = cross(minus(b, a), minus(c, a))
        scale = 1.0 / (dot(normal, minus(lever, a)) * rotor.thrust_factor)
        rows.append(PerWrench(-dot(normal, a) * scale, normal.x * scale, normal.y * scale, normal.z * scale))
    return Mixer._make(rows)


def _lever(rotor: Rotor, centre: CentreOfMass) -> Vector:
    """Return the torque of a rotor over its thrust, m."""
    return Vector(rotor.y - centre.y, centre.x - rotor.x, -rotor.direction * (rotor.drag_factor / rotor.thrust_factor))
