"""Reconstruction of rotor commands for logs that contain thrust and torque commands instead."""

import numpy as np

from drake_quad.errors import InputError
from drake_quad.planning.nominal import nominal_parameters
from drake_quad.scenario.models import Scenario
from drake_quad.signals import Wrench
from drake_quad.vehicle.allocation import RotorModel, allocate
from drake_quad.vehicle.motors import ThrottleModel, allocate_throttle


def allocated_commands(thrust: np.ndarray, torque: np.ndarray, nominal: Scenario, *, throttles: bool) -> np.ndarray:
    """Return the rotor commands that the firmware's allocation computes from a logged wrench.

    Args:
        thrust: (n,) commanded thrust, N.
        torque: (n, 3) commanded torque, N m.
        nominal: scenario with the `nominal` vehicle and the priority of the firmware's allocation.
        throttles: True if the motors are commanded by throttle, False if they are commanded by rotor speed.

    Returns:
        (n, 4) throttle commands, or rotor speed commands in rad/s.

    Raises:
        InputError: if throttle commands are requested, but `nominal` has no thrust curve.
    """
    wrench = Wrench(thrust, *torque.T)  # type: ignore[arg-type]
    parameters, priority = nominal_parameters(nominal), nominal.laboratory.allocation.priority
    rows: tuple[np.ndarray, ...]
    if not throttles:
        rows = allocate(wrench, RotorModel.of(parameters), priority).rotor_speed_command  # type: ignore[assignment]
    else:
        curve = nominal.nominal.motors.thrust_curve()
        if curve is None:
            raise InputError(
                f"{nominal.name} has no nominal.motors; add nominal.motors with a thrust curve to compute the throttles"
            )
        model = ThrottleModel.of(parameters, curve)
        rows = allocate_throttle(wrench, model, priority).throttle_command  # type: ignore[assignment]
    return np.stack([np.broadcast_to(row, thrust.shape) for row in rows], axis=1)
