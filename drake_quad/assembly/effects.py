"""The effects on a scenario's vehicle, from the language to the numbers of their formulas."""

import math
from typing import Any

import numpy as np

from drake_quad.planning.believed import thrust_curve
from drake_quad.signals import RotorSpeed, Row
from drake_quad.vehicle.aerodynamics import (
    BodyDrag,
    CentreOfPressure,
    GroundEffect,
    LinearDrag,
    QuadraticDrag,
    RotorAerodynamics,
)
from drake_quad.vehicle.battery import Battery
from drake_quad.vehicle.effects import Effects, ReactionTorque
from drake_quad.vehicle.motors import SpinDown
from drake_quad.vehicle.parameters import Inertia
from drake_quad.vehicle.payload import Payload, PayloadPosition
from drake_quad.vehicle.slung_load import SlungLoad


def vehicle_effects(vehicle: Any) -> Effects:
    """The effects on the vehicle of a scenario, or of a `Batch.fleet_scenario`."""
    return Effects(
        body_drag=None if vehicle.body_drag is None else _body_drag(vehicle.body_drag),
        rotor_aerodynamics=_same(RotorAerodynamics, vehicle.rotor_aerodynamics),
        ground_effect=_same(GroundEffect, vehicle.ground_effect),
        reaction_torque=ReactionTorque(vehicle.rotor_inertia) if vehicle.reaction_torque else None,
        spin_down=None if vehicle.rotor_time_constant_down is None else SpinDown(vehicle.rotor_time_constant_down),
        thrust_curve=thrust_curve(vehicle.motors),
        payload=None if vehicle.payload is None else _payload(vehicle.payload),
        battery=_same(Battery, vehicle.battery),
        slung_load=_same(SlungLoad, vehicle.slung_load),
    )


def steepest_load(vehicle: Any, airspeed: Row) -> Row:
    """How fast the force on the vehicle can grow with its speed, but for isotropic drag, N s/m.

    Args:
        vehicle: of a `Batch.fleet_scenario`.
        airspeed: as far as it is known, m/s.
    """
    effects = vehicle_effects(vehicle)
    steepest: Row = 0.0
    if effects.body_drag is not None:
        body = effects.body_drag
        pairs = zip(body.linear, body.quadratic, strict=True)
        steepest = _largest([linear + 2.0 * quadratic * airspeed for linear, quadratic in pairs])
    if effects.rotor_aerodynamics is not None:
        rotors = effects.rotor_aerodynamics
        turning = len(RotorSpeed._fields) * vehicle.max_rotor_speed
        along = abs(rotors.climb) + rotors.inflow * turning + 2.0 * rotors.lift * airspeed
        steepest = steepest + _largest([rotors.drag * turning, along])
    return steepest


def swing_frequency(vehicle: Any) -> Row:
    """Of small swings of a slung load below a vehicle that hovers, rad/s; 0 without one."""
    load = vehicle.slung_load
    if load is None:
        return 0.0
    return np.sqrt(vehicle.gravity * (1.0 + load.mass / vehicle.mass) / load.length)


def _largest(rows: list[Row]) -> Row:
    largest, *others = rows
    for row in others:
        largest = np.maximum(largest, row)
    return largest


def _same(kind: Any, model: Any) -> Any:
    """The record of numbers that have the same names in the language; None for what is not written."""
    return None if model is None else kind(**{name: getattr(model, name) for name in kind._fields})


def _body_drag(model: Any) -> BodyDrag:
    return BodyDrag(
        LinearDrag(*model.linear), QuadraticDrag(*model.quadratic), CentreOfPressure(*model.centre_of_pressure)
    )


def _payload(model: Any) -> Payload:
    picked_up = model.event == "picked_up"
    return Payload(
        model.mass,
        PayloadPosition(*model.position),
        Inertia(*model.inertia),
        picked_up=model.time if picked_up else 0.0,
        dropped=math.inf if picked_up else model.time,
    )
