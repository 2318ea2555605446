"""Units of PX4's normalised torques.

PX4 commands thrust between 0 and 1, and torques between -1 and 1. It assumes that the thrust of a rotor is proportional
to its command, and that the command MPC_THR_HOVER balances the weight. It normalises torques by its mixer
(`ControlAllocationPseudoInverse`).
"""

import numpy as np

from drake_quad.vehicle.parameters import QuadrotorParameters


def torque_units(nominal: QuadrotorParameters, hover_thrust: float) -> tuple[float, float, float]:
    """Return the torques about x, y, z that correspond to a normalised torque of 1, N m.

    The mixer is the pseudo-inverse of the rotors' effectiveness matrix, with scaled columns. The roll and pitch columns
    have a common scale: √2 times the larger of their root mean squares. The scale of the yaw column is its largest
    entry.

    Args:
        nominal: parameters of the nominal vehicle.
        hover_thrust: normalised thrust in hover, MPC_THR_HOVER.
    """
    effectiveness = np.array(
        [
            [rotor.y, -rotor.x, -rotor.direction * rotor.drag_factor / rotor.thrust_factor, 1.0]
            for rotor in nominal.rotors
        ]
    ).T
    roll, pitch, yaw, _ = np.linalg.pinv(effectiveness).T  # columns of the mixer
    tilt_scale = float(max(np.sqrt(2.0 * np.mean(np.square(column))) for column in (roll, pitch)))
    yaw_scale = float(np.max(yaw))
    rotor_thrust = nominal.mass * nominal.gravity / (4.0 * hover_thrust)
    return rotor_thrust / tilt_scale, rotor_thrust / tilt_scale, rotor_thrust / yaw_scale
