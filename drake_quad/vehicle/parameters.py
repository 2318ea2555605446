"""The numbers that make a quadrotor."""

from typing import NamedTuple

from drake_quad.compiled import formula
from drake_quad.elementary import Row, Rows


class QuadrotorParameters(NamedTuple):
    """Parameters of the vehicle; the defaults are the paper's Table I where it has them.

    Each entry is a row: a number for one vehicle or an (N,) array for a fleet. The thrust factor of Table I is
    large for an 8-inch propeller; it is kept, since everything in the paper rests on it.

    Attributes:
        mass: m, kg.
        inertia: I_xx, I_yy, I_zz about the centre of mass, kg m².
        rotor_inertia: J_r of one rotor with its motor, kg m².
        thrust_factor: b of each rotor, N s².
        drag_factor: d, torque over squared rotor speed, N m s².
        arm_length: l, from the centre of mass to a rotor, m.
        gravity: g, m/s².
        linear_drag: drag force over airspeed, N s/m. The paper ignores drag: 0.
        quadratic_drag: drag force over squared airspeed, N s²/m². The paper ignores drag: 0.
        rotor_time_constant: lag of the rotor speed behind its command, s. Not in the paper; 50 ms is what
            hobby-class motors of this size show in step tests.
        min_rotor_speed: idle, rad/s. Not in the paper; a fifth of the top speed.
        max_rotor_speed: rad/s. Not in the paper; it gives 2.2 times the thrust of hover, a usual ratio.
        centre_of_mass: x and y in B's axes, seen from the middle of the rotors, m. In the paper it is there: 0.
    """

    mass: Row = 0.68
    inertia: Rows = (0.007, 0.007, 0.012)
    rotor_inertia: Row = 6.5e-5
    thrust_factor: Rows = (4.13e-5, 4.13e-5, 4.13e-5, 4.13e-5)
    drag_factor: Row = 8.5e-7
    arm_length: Row = 0.17
    gravity: Row = 9.81
    linear_drag: Row = 0.0
    quadratic_drag: Row = 0.0
    rotor_time_constant: Row = 0.05
    min_rotor_speed: Row = 60.0
    max_rotor_speed: Row = 300.0
    centre_of_mass: Rows = (0.0, 0.0)

    def to_rows(self) -> list[Row]:
        """The parameters as 19 rows, in the order above."""
        mass, inertia, rotor_inertia, thrust_factor, *rest, centre_of_mass = self
        return [mass, *inertia, rotor_inertia, *thrust_factor, *rest, *centre_of_mass]


@formula
def parameters_from_rows(rows: Rows) -> QuadrotorParameters:
    """The inverse of `QuadrotorParameters.to_rows`."""
    return QuadrotorParameters(
        rows[0],
        rows[1:4],
        rows[4],
        rows[5:9],
        rows[9],
        rows[10],
        rows[11],
        rows[12],
        rows[13],
        rows[14],
        rows[15],
        rows[16],
        rows[17:19],
    )
