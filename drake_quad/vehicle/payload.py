"""A mass that is fixed to the vehicle and is picked up or dropped at a time.

State and equations stay those of one point, P: the centre of mass of the vehicle without its payload. Its velocity and
the body rates go on when the payload comes or goes: what is dropped leaves with the velocity that it has, and what is
picked up has the vehicle's when it is gripped. With the payload, the centre of mass C of the whole is at c from P:

    M = m + m_p,    c = m_p r / M
    I_C = I + I_p + (m m_p / M) (|r|² 1 - r rᵀ)                   parallel axes; products of inertia stay
    I_C α = τ_P - c x F - ω x (I_C ω + J_r ω_r z)
    a_P = F / M - α x c - ω x (ω x c)                             without gravity, in the axes of B

where F and τ_P are the force on the vehicle without its weight, and the torque about P.
"""

import math
from typing import Annotated, NamedTuple

from drake_quad.framework.elementary import where
from drake_quad.geometry.axes import Vector, cross, dot, plus, times
from drake_quad.signals import Quantity, Row, Time
from drake_quad.vehicle.parameters import Inertia
from drake_quad.vehicle.rotors import Length


class PayloadPosition(NamedTuple):
    """Where the centre of mass of the payload is, seen from the vehicle's own."""

    x: Length
    y: Length
    z: Length


class Payload(NamedTuple):
    """A mass that the vehicle carries for some time.

    Attributes:
        mass: m_p.
        position: r.
        inertia: I_p, about its own centre of mass, along the axes of B.
        picked_up: when it comes; 0 if it is there from the beginning.
        dropped: when it goes; infinite if it stays.
    """

    mass: Annotated[Row, Quantity("kg")]
    position: PayloadPosition
    inertia: Inertia
    picked_up: Time = 0.0
    dropped: Time = math.inf


class Whole(NamedTuple):
    """Vehicle and payload as one body.

    Attributes:
        mass: M, kg.
        centre: c, m.
        diagonal: moments of inertia about C: xx, yy, zz, kg m².
        products: the elements yz, zx and xy of the same matrix, kg m².
    """

    mass: Row
    centre: Vector
    diagonal: Vector
    products: Vector


def whole(mass: Row, inertia: Inertia, payload: Payload, time: Row) -> Whole:
    """Vehicle and payload, or what is left of them, at a time.

    Args:
        mass: of the vehicle.
        inertia: of the vehicle.
        payload: that it carries for some time.
        time: s.
    """
    load = where(time >= payload.dropped, 0.0, where(time >= payload.picked_up, payload.mass, 0.0))
    share = load / payload.mass
    total = mass + load
    r = Vector(*payload.position)
    reduced = mass * load / total
    xx, yy, zz = reduced * r.x * r.x, reduced * r.y * r.y, reduced * r.z * r.z
    i_x, i_y, i_z = (own + share * other for own, other in zip(inertia, payload.inertia, strict=True))
    return Whole(
        total,
        times(load / total, r),
        Vector(i_x + (yy + zz), i_y + (zz + xx), i_z + (xx + yy)),
        times(-reduced, Vector(r.y * r.z, r.z * r.x, r.x * r.y)),
    )


def whole_accelerations(force: Vector, torque: Vector, rates: Vector, spin: Row, body: Whole) -> tuple[Vector, Vector]:
    """Acceleration of P without that of gravity (m/s²) and angular acceleration (rad/s²), in the axes of B.

    Args:
        force: F, N.
        torque: τ_P, N m.
        rates: ω, rad/s.
        spin: J_r ω_r, N m s.
        body: vehicle and payload.
    """
    x, y, z = rates
    (i_x, i_y, i_z), (i_yz, i_zx, i_xy) = body.diagonal, body.products
    momentum = Vector(
        i_x * x + i_xy * y + i_zx * z, i_xy * x + i_y * y + i_yz * z, i_zx * x + i_yz * y + i_z * z + spin
    )
    about_centre = plus(torque, times(-1.0, plus(cross(body.centre, force), cross(rates, momentum))))
    turning = _solved(body, about_centre)
    swung = plus(cross(turning, body.centre), cross(rates, cross(rates, body.centre)))
    return plus(times(1.0 / body.mass, force), times(-1.0, swung)), turning


def _solved(body: Whole, torque: Vector) -> Vector:
    """I_C⁻¹ τ, by the cofactors of the symmetric matrix."""
    (i_x, i_y, i_z), (i_yz, i_zx, i_xy) = body.diagonal, body.products
    first = Vector(i_y * i_z - i_yz * i_yz, i_zx * i_yz - i_xy * i_z, i_xy * i_yz - i_y * i_zx)
    second = Vector(first.y, i_x * i_z - i_zx * i_zx, i_xy * i_zx - i_x * i_yz)
    third = Vector(first.z, second.z, i_x * i_y - i_xy * i_xy)
    determinant = i_x * first.x + i_xy * first.y + i_zx * first.z
    return times(1.0 / determinant, Vector(dot(first, torque), dot(second, torque), dot(third, torque)))
