"""Slung load: a point mass on a massless rod that is attached to the centre of mass of the vehicle.

The rod models a taut cable; unlike a cable, it can also push. The load has no aerodynamic drag. Let q be the direction
of the rod from the vehicle to the load, l its length, m and m_L the masses of vehicle and load, and F the force on the
vehicle, excluding its weight and the force of the rod. Then

    m a = F - m g z + T q,    m_L (a + l q̈) = -m_L g z - T q
    T = m_L (m l |q̇|² - F · q) / (m + m_L)
    l q̈ = -(F - (F · q) q) / m - l |q̇|² q

(Sreenath, Michael and Kumar, "Trajectory generation and control of a quadrotor with a cable-suspended load", ICRA
2013).
A time step integrates q and q̇ along the axes of W. Ports and states contain the angles of the rod, which rotate it
from the vertical by the pitch β about Y and then by the roll α about X of W, and the rates of these angles:

    q = Rx(α) Ry(β) (0, 0, -1)ᵀ = (-sβ, sα cβ, -cα cβ)ᵀ
    q̇ = β̇ e_β + cβ α̇ e_α,    e_β = (-cβ, -sα sβ, cα sβ)ᵀ,    e_α = (0, cα, sα)ᵀ
    q̈ · e_β = β̈ + sβ cβ α̇²,    q̈ · e_α = cβ α̈ - 2 sβ α̇ β̇

α̇ is infinite if the rod is horizontal along X. A continuous state is singular there, but a time step is not. After a
time step β is between -90° and 90°, and α between -180° and 180°.
"""

from typing import Annotated, NamedTuple

from drake_quad.framework.elementary import arctan2, sin_cos, sqrt
from drake_quad.geometry.axes import Vector, dot, times
from drake_quad.signals import Quantity, Row, Swing


class SlungLoad(NamedTuple):
    """Parameters of a load on a cable.

    Attributes:
        mass: mass m_L of the load.
        length: length l of the cable.
    """

    mass: Annotated[Row, Quantity("kg")]
    length: Annotated[Row, Quantity("m")]


HANGING_AT_REST = Swing(0.0, 0.0, 0.0, 0.0)
"""Swing of a load that hangs straight down at rest."""

# Offset that is added to -q · z, to avoid 0 / 0 if the rod is horizontal along X. It does not change components above
# 1e-14.
_COMPONENT_OFFSET = 1e-30


class Rod(NamedTuple):
    """Direction of the rod and rate of this direction, or their time derivatives.

    Attributes:
        direction: direction q in W, a unit vector.
        rate: rate q̇ in W, 1/s.
    """

    direction: Vector
    rate: Vector


def rod_from_swing(swing: Swing) -> Rod:
    """Return the direction of the rod, and the rate of this direction, for a given swing."""
    roll, pitch, roll_rate, pitch_rate = swing
    sin_roll, cos_roll = sin_cos(roll)
    sin_pitch, cos_pitch = sin_cos(pitch)
    around, inward = cos_pitch * roll_rate, sin_pitch * pitch_rate
    return Rod(
        Vector(-sin_pitch, sin_roll * cos_pitch, -cos_roll * cos_pitch),
        Vector(-cos_pitch * pitch_rate, cos_roll * around - sin_roll * inward, sin_roll * around + cos_roll * inward),
    )


def swing_from_rod(rod: Rod) -> Swing:
    """Return the swing for a given direction and rate of the rod.

    The direction need not have unit length. The component of the rate along the direction is ignored.
    """
    (x, y, z), rate = rod
    down = _COMPONENT_OFFSET - z
    across = sqrt(y * y + down * down)
    size = sqrt(x * x + across * across)
    sin_roll, cos_roll, sin_pitch, cos_pitch = y / across, down / across, -x / size, across / size
    return Swing(
        arctan2(y, down),
        arctan2(-x, across),
        (cos_roll * rate.y + sin_roll * rate.z) / (size * cos_pitch),
        (sin_pitch * (cos_roll * rate.z - sin_roll * rate.y) - cos_pitch * rate.x) / size,
    )


def rod_force(force: Vector, rod: Rod, mass: Row, load: SlungLoad) -> Vector:
    """Return the force of the rod on the vehicle in W, N.

    The force is T q, where T is the tension of the rod and q the direction from the vehicle to the load.

    Args:
        force: force F on the vehicle in W, excluding its weight and the force of the rod, N.
        rod: direction of the rod and rate of this direction.
        mass: mass m of the vehicle, kg.
        load: parameters of the load.
    """
    squared_rate = dot(rod.rate, rod.rate)
    tension = load.mass * (mass * load.length * squared_rate - dot(force, rod.direction)) / (mass + load.mass)
    return times(tension, rod.direction)


def rod_rates(force: Vector, rod: Rod, mass: Row, load: SlungLoad) -> Rod:
    """Return the first and second derivatives of the rod's direction q in W: q̇ in 1/s, and q̈ in 1/s².

    The arguments are those of `rod_force`.
    """
    q = rod.direction
    inverse = -1.0 / (mass * load.length)
    along = dot(force, q) * inverse + dot(rod.rate, rod.rate)
    return Rod(rod.rate, Vector._make(inverse * f - along * part for f, part in zip(force, q, strict=True)))


def swing_rates(swing: Swing, acceleration: Vector) -> Swing:
    """Return the time derivative of a swing.

    Args:
        swing: swing of the load.
        acceleration: second derivative q̈ of the rod's direction in W, 1/s².
    """
    sin_roll, cos_roll = sin_cos(swing.roll)
    sin_pitch, cos_pitch = sin_cos(swing.pitch)
    x, y, z = acceleration
    along_roll = cos_roll * y + sin_roll * z
    along_pitch = sin_pitch * (cos_roll * z - sin_roll * y) - cos_pitch * x
    return Swing(
        swing.roll_rate,
        swing.pitch_rate,
        (along_roll + 2.0 * sin_pitch * swing.roll_rate * swing.pitch_rate) / cos_pitch,
        along_pitch - sin_pitch * cos_pitch * swing.roll_rate * swing.roll_rate,
    )
