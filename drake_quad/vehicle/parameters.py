"""The numbers of a quadrotor."""

from typing import Annotated, NamedTuple

from drake_quad.signals import Quantity, Row
from drake_quad.vehicle.rotors import Length, Rotors

_Mass = Annotated[Row, Quantity("kg")]
_Inertia = Annotated[Row, Quantity("kg m²", "B")]


class Inertia(NamedTuple):
    """Moments of inertia about the centre of mass."""

    i_xx: _Inertia = 0.007
    i_yy: _Inertia = 0.007
    i_zz: _Inertia = 0.012


class CentreOfMass(NamedTuple):
    """Where the centre of mass is, seen from the origin of the rotors' layout."""

    x: Length = 0.0
    y: Length = 0.0


class QuadrotorParameters(NamedTuple):
    """Parameters of the vehicle; the defaults are the paper's Table I where it has them.

    Each row is a number for one vehicle or an (N,) array for a fleet.

    Attributes:
        mass: m.
        inertia: I_xx, I_yy, I_zz about the centre of mass.
        rotor_inertia: J_r of one rotor with its motor.
        rotors: where they are, which way they turn, and their factors b and d.
        gravity: g.
        linear_drag: drag force over airspeed. The paper ignores drag: 0.
        quadratic_drag: drag force over squared airspeed. The paper ignores drag: 0.
        rotor_time_constant: lag of the rotor speed behind its command. Not in the paper; 50 ms is what hobby-class
            motors of this size show in step tests.
        min_rotor_speed: idle. Not in the paper; a fifth of the top speed.
        max_rotor_speed: not in the paper; it gives 2.2 times the thrust of hover, a usual ratio.
        centre_of_mass: in B's axes, seen from the origin of the rotors' layout. In the paper it is there: 0.
    """

    mass: _Mass = 0.68
    inertia: Inertia = Inertia()
    rotor_inertia: Annotated[Row, Quantity("kg m²")] = 6.5e-5
    rotors: Rotors = Rotors.plus()
    gravity: Annotated[Row, Quantity("m/s²")] = 9.81
    linear_drag: Annotated[Row, Quantity("N s/m")] = 0.0
    quadratic_drag: Annotated[Row, Quantity("N s²/m²")] = 0.0
    rotor_time_constant: Annotated[Row, Quantity("s")] = 0.05
    min_rotor_speed: Annotated[Row, Quantity("rad/s")] = 60.0
    max_rotor_speed: Annotated[Row, Quantity("rad/s")] = 300.0
    centre_of_mass: CentreOfMass = CentreOfMass()
