"""Mixer: the linear map from a wrench to squared rotor speeds, which is the inverse of eq (5) of the paper."""

from typing import Annotated, NamedTuple

from drake_quad.geometry.axes import Vector, cross, dot, minus
from drake_quad.signals import Quantity, Row
from drake_quad.vehicle.parameters import CentreOfMass, QuadrotorParameters
from drake_quad.vehicle.rotors import Rotor


class MixerRow(NamedTuple):
    """Change of one rotor's squared speed (rad²/s²) per unit of thrust (N) and of each torque (N m)."""

    thrust: Annotated[Row, Quantity("rad²/(N s²)")]
    tau_x: Annotated[Row, Quantity("rad²/(N m s²)")]
    tau_y: Annotated[Row, Quantity("rad²/(N m s²)")]
    tau_z: Annotated[Row, Quantity("rad²/(N m s²)")]


class Mixer(NamedTuple):
    """Inverse of eq (5) of the paper, with one row for each rotor."""

    rotor_1: MixerRow
    rotor_2: MixerRow
    rotor_3: MixerRow
    rotor_4: MixerRow


def mixer_from_parameters(parameters: QuadrotorParameters) -> Mixer:
    """Return the mixer of a vehicle with any layout of four rotors.

    The lever of a rotor is the ratio of its torque to its thrust, a vector. The ratio of the total torque to the total
    thrust is the mean of the four levers, weighted by the thrusts of the rotors. The fractions of the thrust that the
    rotors carry are therefore the barycentric coordinates of this ratio in the tetrahedron of the four levers. The
    fraction of a rotor is the distance of the ratio from the face that the other three levers span, divided by the
    distance of the rotor's lever from this face.

    Args:
        parameters: parameters of a vehicle. The levers of its rotors must span a tetrahedron, which
            `drake_quad.vehicle.authority` checks.
    """
    rotors, centre = parameters.rotors, parameters.centre_of_mass
    levers = [_lever(rotor, centre) for rotor in rotors]
    rows = []
    for rotor, lever in zip(rotors, levers, strict=True):
        a, b, c = (other for other in levers if other is not lever)
        normal = cross(minus(b, a), minus(c, a))
        scale = 1.0 / (dot(normal, minus(lever, a)) * rotor.thrust_factor)
        rows.append(MixerRow(-dot(normal, a) * scale, normal.x * scale, normal.y * scale, normal.z * scale))
    return Mixer._make(rows)


def _lever(rotor: Rotor, centre: CentreOfMass) -> Vector:
    """Return a rotor's ratio of torque to thrust, m."""
    return Vector(rotor.y - centre.y, centre.x - rotor.x, -rotor.direction * (rotor.drag_factor / rotor.thrust_factor))
