"""Parameters of a quadrotor."""

from typing import Annotated, NamedTuple

from drake_quad.signals import Quantity, Row
from drake_quad.vehicle.rotors import Length, Rotors

_Mass = Annotated[Row, Quantity("kg", sign="positive")]
_Inertia = Annotated[Row, Quantity("kg m²", "B", "nonnegative")]


class Inertia(NamedTuple):
    """Moments of inertia about the centre of mass."""

    i_xx: _Inertia = 0.007
    i_yy: _Inertia = 0.007
    i_zz: _Inertia = 0.012


class CentreOfMass(NamedTuple):
    """Position of the centre of mass relative to the origin of the rotors' layout."""

    x: Length = 0.0
    y: Length = 0.0


class QuadrotorParameters(NamedTuple):
    """Parameters of the vehicle; the defaults are from the paper's Table I unless stated otherwise.

    Each value is a number for one vehicle, or an (N,) array for a fleet.

    Attributes:
        mass: mass m.
        inertia: moments of inertia I_xx, I_yy, I_zz about the centre of mass.
        rotor_inertia: moment of inertia J_r of one rotor with its motor.
        rotors: positions, directions of rotation, and factors b and d of the rotors.
        gravity: gravitational acceleration g.
        linear_drag: ratio of drag force to airspeed. The default is 0, since the paper neglects drag.
        quadratic_drag: ratio of drag force to squared airspeed. The default is 0, since the paper neglects drag.
        rotor_time_constant: time constant of the lag from the command to the rotor speed. The paper gives no value; the
            default, 50 ms, is typical of step tests of hobby-class motors of this size.
        min_rotor_speed: idle speed. The paper gives no value; the default is a fifth of the maximum speed.
        max_rotor_speed: maximum speed. The paper gives no value; the default gives 2.2 times the thrust in hover, a
            usual ratio.
        centre_of_mass: position relative to the origin of the rotors' layout, along the axes of B; 0 in the paper.
    """

    mass: _Mass = 0.68
    inertia: Inertia = Inertia()
    rotor_inertia: Annotated[Row, Quantity("kg m²", sign="nonnegative")] = 6.5e-5
    rotors: Rotors = Rotors.plus()
    gravity: Annotated[Row, Quantity("m/s²")] = 9.81
    linear_drag: Annotated[Row, Quantity("N s/m", sign="nonnegative")] = 0.0
    quadratic_drag: Annotated[Row, Quantity("N s²/m²", sign="nonnegative")] = 0.0
    rotor_time_constant: Annotated[Row, Quantity("s", sign="nonnegative")] = 0.05
    min_rotor_speed: Annotated[Row, Quantity("rad/s", sign="nonnegative")] = 60.0
    max_rotor_speed: Annotated[Row, Quantity("rad/s", sign="positive")] = 300.0
    centre_of_mass: CentreOfMass = CentreOfMass()
