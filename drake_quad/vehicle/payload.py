"""Payload: a mass that is fixed to the vehicle, and that is picked up or dropped at a given time.

State and equations always refer to the point P, the centre of mass of the vehicle without its payload. The velocity of
P and the body rates are continuous when the payload is picked up or dropped: a dropped payload keeps its velocity, and
a payload already moves with the vehicle before it is picked up. With the payload, the common centre of mass C is at the
position c relative to P:

    M = m + m_p,    c = m_p r / M
    I_C = I + I_p + (m m_p / M) (|r|² 1 - r rᵀ)                   parallel axis theorem, with products of inertia
    I_C α = τ_P - c x F - ω x (I_C ω + J_r ω_r z)
    a_P = F / M - α x c - ω x (ω x c)                             without gravity, along the axes of B

where F is the force on the vehicle, excluding its weight, and τ_P is the torque about P.
"""

import math
from typing import Annotated, NamedTuple

from drake_quad.framework.elementary import where
from drake_quad.geometry.axes import Vector, cross, dot, plus, times
from drake_quad.signals import Quantity, Row, Time
from drake_quad.vehicle.parameters import Inertia
from drake_quad.vehicle.rotors import Length


class PayloadPosition(NamedTuple):
    """Position of the payload's centre of mass relative to P, the centre of mass of the vehicle without payload."""

    x: Length
    y: Length
    z: Length


class Payload(NamedTuple):
    """Mass that the vehicle carries for some time.

    Attributes:
        mass: mass m_p.
        position: position r.
        inertia: moments of inertia I_p about the centre of mass of the payload, along the axes of B.
        picked_up: time at which the vehicle picks up the payload; 0 if the vehicle carries it from the start.
        dropped: time at which the vehicle drops the payload; infinite if the vehicle never drops it.
    """

    mass: Annotated[Row, Quantity("kg")]
    position: PayloadPosition
    inertia: Inertia
    picked_up: Time = 0.0
    dropped: Time = math.inf


class LoadedBody(NamedTuple):
    """Vehicle and payload as one body.

    Attributes:
        mass: total mass M, kg.
        centre: position c of the common centre of mass C, m.
        diagonal: elements xx, yy and zz of the inertia matrix about C, kg m².
        products: elements yz, zx and xy of the same matrix, kg m².
    """

    mass: Row
    centre: Vector
    diagonal: Vector
    products: Vector


def loaded_body(mass: Row, inertia: Inertia, payload: Payload, time: Row) -> LoadedBody:
    """Return the body of the vehicle, including its payload if the payload is attached at this time.

    Args:
        mass: mass m of the vehicle, kg.
        inertia: moments of inertia I of the vehicle.
        payload: payload of the vehicle.
        time: time, s.
    """
    load = where(time >= payload.dropped, 0.0, where(time >= payload.picked_up, payload.mass, 0.0))
    fraction = load / payload.mass
    total = mass + load
    r = Vector(*payload.position)
    reduced = mass * load / total
    xx, yy, zz = reduced * r.x * r.x, reduced * r.y * r.y, reduced * r.z * r.z
    i_x, i_y, i_z = (moment + fraction * other for moment, other in zip(inertia, payload.inertia, strict=True))
    return LoadedBody(
        total,
        times(load / total, r),
        Vector(i_x + (yy + zz), i_y + (zz + xx), i_z + (xx + yy)),
        times(-reduced, Vector(r.y * r.z, r.z * r.x, r.x * r.y)),
    )


def loaded_body_accelerations(
    force: Vector, torque: Vector, rates: Vector, spin: Row, body: LoadedBody
) -> tuple[Vector, Vector]:
    """Return the acceleration of P without gravity (m/s²) and the angular acceleration (rad/s²), along the axes of B.

    Args:
        force: force F in B, N.
        torque: torque τ_P in B, N m.
        rates: body rates ω, rad/s.
        spin: angular momentum J_r ω_r of the rotors, N m s.
        body: vehicle and payload.
    """
    x, y, z = rates
    (i_x, i_y, i_z), (i_yz, i_zx, i_xy) = body.diagonal, body.products
    momentum = Vector(
        i_x * x + i_xy * y + i_zx * z, i_xy * x + i_y * y + i_yz * z, i_zx * x + i_yz * y + i_z * z + spin
    )
    about_centre = plus(torque, times(-1.0, plus(cross(body.centre, force), cross(rates, momentum))))
    angular = _angular_acceleration(body, about_centre)
    centre_relative_to_p = plus(cross(angular, body.centre), cross(rates, cross(rates, body.centre)))
    return plus(times(1.0 / body.mass, force), times(-1.0, centre_relative_to_p)), angular


def _angular_acceleration(body: LoadedBody, torque: Vector) -> Vector:
    """Return I_C⁻¹ τ for a torque τ about C, by the cofactors of the symmetric matrix."""
    (i_x, i_y, i_z), (i_yz, i_zx, i_xy) = body.diagonal, body.products
    first = Vector(i_y * i_z - i_yz * i_yz, i_zx * i_yz - i_xy * i_z, i_xy * i_yz - i_y * i_zx)
    second = Vector(first.y, i_x * i_z - i_zx * i_zx, i_xy * i_zx - i_x * i_yz)
    third = Vector(first.z, second.z, i_x * i_y - i_xy * i_xy)
    determinant = i_x * first.x + i_xy * first.y + i_zx * first.z
    return times(1.0 / determinant, Vector(dot(first, torque), dot(second, torque), dot(third, torque)))
