"""The numbers of a quadrotor."""

from typing import Annotated, NamedTuple

from drake_quad.signals import Quantity, Row

_Mass = Annotated[Row, Quantity("kg")]
_Inertia = Annotated[Row, Quantity("kg m²", "B")]
_ThrustFactor = Annotated[Row, Quantity("N s²")]
_Length = Annotated[Row, Quantity("m", "B")]


class Inertia(NamedTuple):
    """Moments of inertia about the centre of mass."""

    i_xx: _Inertia = 0.007
    i_yy: _Inertia = 0.007
    i_zz: _Inertia = 0.012


class ThrustFactors(NamedTuple):
    """Thrust over squared speed of each rotor."""

    rotor_1: _ThrustFactor = 4.13e-5
    rotor_2: _ThrustFactor = 4.13e-5
    rotor_3: _ThrustFactor = 4.13e-5
    rotor_4: _ThrustFactor = 4.13e-5


class CentreOfMass(NamedTuple):
    """Where the centre of mass is, seen from the middle of the rotors."""

    x: _Length = 0.0
    y: _Length = 0.0


class QuadrotorParameters(NamedTuple):
    """Parameters of the vehicle; the defaults are the paper's Table I where it has them.

    Each row is a number for one vehicle or an (N,) array for a fleet. The thrust factor of Table I is large for an
    8-inch propeller; it is kept, since everything in the paper rests on it.

    Attributes:
        mass: m.
        inertia: I_xx, I_yy, I_zz about the centre of mass.
        rotor_inertia: J_r of one rotor with its motor.
        thrust_factor: b of each rotor.
        drag_factor: d, torque over squared rotor speed.
        arm_length: l, from the middle of the rotors to each.
        gravity: g.
        linear_drag: drag force over airspeed. The paper ignores drag: 0.
        quadratic_drag: drag force over squared airspeed. The paper ignores drag: 0.
        rotor_time_constant: lag of the rotor speed behind its command. Not in the paper; 50 ms is what hobby-class
            motors of this size show in step tests.
        min_rotor_speed: idle. Not in the paper; a fifth of the top speed.
        max_rotor_speed: not in the paper; it gives 2.2 times the thrust of hover, a usual ratio.
        centre_of_mass: in B's axes, seen from the middle of the rotors. In the paper it is there: 0.
    """

    mass: _Mass = 0.68
    inertia: Inertia = Inertia()
    rotor_inertia: Annotated[Row, Quantity("kg m²")] = 6.5e-5
    thrust_factor: ThrustFactors = ThrustFactors()
    drag_factor: Annotated[Row, Quantity("N m s²")] = 8.5e-7
    arm_length: Annotated[Row, Quantity("m")] = 0.17
    gravity: Annotated[Row, Quantity("m/s²")] = 9.81
    linear_drag: Annotated[Row, Quantity("N s/m")] = 0.0
    quadratic_drag: Annotated[Row, Quantity("N s²/m²")] = 0.0
    rotor_time_constant: Annotated[Row, Quantity("s")] = 0.05
    min_rotor_speed: Annotated[Row, Quantity("rad/s")] = 60.0
    max_rotor_speed: Annotated[Row, Quantity("rad/s")] = 300.0
    centre_of_mass: CentreOfMass = CentreOfMass()
