"""A load on a cable: a point mass on a rod without mass that hangs at the centre of mass of the vehicle.

The rod is always taut: it pulls, and would push. The load feels no air. With q the direction of the rod from the
vehicle to the load, l its length, m and m_L the masses, and F the force on the vehicle without its weight and without
the rod's,

    m a = F - m g z + T q,    m_L (a + l q̈) = -m_L g z - T q
    T = m_L (m l |q̇|² - F · q) / (m + m_L)
    l q̈ = -(F - (F · q) q) / m - l |q̇|² q

(Sreenath, Michael and Kumar, "Trajectory generation and control of a quadrotor with a cable-suspended load", ICRA
2013).
The rod turns from the vertical by its pitch β about Y and then by its roll α about X of W:

    q = Rx(α) Ry(β) (0, 0, -1)ᵀ = (-sβ, sα cβ, -cα cβ)ᵀ
    l (β̈ + sβ cβ α̇²) = -F · (-cβ, -sα sβ, cα sβ) / m
    l (cβ α̈ - 2 sβ α̇ β̇) = -F · (0, cα, sα) / m

which is singular where the rod is horizontal along X.
"""

from typing import Annotated, NamedTuple

from drake_quad.axes import Vector, dot, times
from drake_quad.framework.elementary import sin_cos
from drake_quad.signals import Quantity, Row, Swing


class SlungLoad(NamedTuple):
    """A load on a cable.

    Attributes:
        mass: m_L.
        length: l.
    """

    mass: Annotated[Row, Quantity("kg")]
    length: Annotated[Row, Quantity("m")]


HANGING = Swing(0.0, 0.0, 0.0, 0.0)


def direction(swing: Swing) -> Vector:
    """q, from the vehicle to the load, in W."""
    sin_roll, cos_roll = sin_cos(swing.roll)
    sin_pitch, cos_pitch = sin_cos(swing.pitch)
    return Vector(-sin_pitch, sin_roll * cos_pitch, -cos_roll * cos_pitch)


def pull(force: Vector, swing: Swing, mass: Row, load: SlungLoad) -> Vector:
    """T q, the force of the rod on the vehicle in W, N.

    Args:
        force: F in W, N.
        swing: of the load.
        mass: m of the vehicle, kg.
        load: its numbers.
    """
    q = direction(swing)
    _, cos_pitch = sin_cos(swing.pitch)
    around = cos_pitch * swing.roll_rate
    squared_rate = around * around + swing.pitch_rate * swing.pitch_rate
    tension = load.mass * (mass * load.length * squared_rate - dot(force, q)) / (mass + load.mass)
    return times(tension, q)


def swing_rates(force: Vector, swing: Swing, mass: Row, load: SlungLoad) -> Swing:
    """The rates of the swing, per second; arguments as for `pull`."""
    sin_roll, cos_roll = sin_cos(swing.roll)
    sin_pitch, cos_pitch = sin_cos(swing.pitch)
    inverse = -1.0 / (mass * load.length)
    along_pitch = dot(force, Vector(-cos_pitch, -sin_roll * sin_pitch, cos_roll * sin_pitch))
    along_roll = force.y * cos_roll + force.z * sin_roll
    return Swing(
        swing.roll_rate,
        swing.pitch_rate,
        (inverse * along_roll + 2.0 * sin_pitch * swing.roll_rate * swing.pitch_rate) / cos_pitch,
        inverse * along_pitch - sin_pitch * cos_pitch * swing.roll_rate * swing.roll_rate,
    )
