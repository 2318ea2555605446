"""Output of a flown position law, reconstructed from the logged attitude and thrust commands.

Controllers convert the output u of their position law to attitude and thrust in different ways. Five forms are tried:

    acceleration    thrust T along the commanded thrust axis z_d:  u = (T / m) z_d - g Z
    heading         as in acceleration, with roll and pitch relative to the measured yaw instead of the commanded yaw
    decoupled       u_x and u_y depend only on the tilt, g z_d,x / z_d,z, so that climbing does not change the
                    tilt, as in PX4
    projected       as in acceleration, with T = F · z the component of the force along the measured thrust axis z,
                    as in geometric control:  u = (T / m) / (z_d · z) z_d - g Z
    tilt            the outputs of the law are roll and pitch, as in the Crazyflie's firmware: along the axes of the
                    heading, u_x is the pitch and u_y is minus the roll in rad, and along Z u = T / m - g. Errors
                    are also integrated along the axes of the heading

The attitude is the exact rotation by roll, pitch and yaw.
"""

from typing import Literal, get_args

import numpy as np

from drake_quad.errors import InputError, short_repr
from drake_quad.identification.model import thrust_of_fraction
from drake_quad.logs.attitudes import rotation_matrices
from drake_quad.logs.record import FlightRecord
from drake_quad.scenario.models import Scenario

# Relations between the output of a position law and the commands of attitude and thrust, see `law_output`.
Form = Literal["acceleration", "heading", "decoupled", "projected", "tilt"]
FORMS: tuple[Form, ...] = get_args(Form)

# A command is at a limit if many of its samples are near an extreme. For a smooth signal, the number of samples within
# a margin δ of the maximum is 1 / (√2 - 1) = 2.4 times the number between δ and 2 δ. The ratio is much larger at a
# limit.
_LIMIT_MARGIN = 0.005  # margin δ relative to the range of the command; the resolution of logs is finer
# A command is at a limit if the ratio of these two numbers exceeds this value.
_MIN_COUNT_RATIO = 5.0
_MIN_LIMITED_SAMPLES = 8  # an extreme that fewer samples reach is not a limit
# A command that is at its extreme in more than this fraction of the samples is constant rather than limited.
_MAX_LIMITED_FRACTION = 0.5
# Lower limit of the cosine by which the output of some forms is divided, which corresponds to 78°. The angle is that
# between the commanded thrust and the vertical, or between the commanded thrust and the measured thrust axis.
_MIN_ALIGNMENT_COSINE = 0.2


def specific_thrust(record: FlightRecord, scenario: Scenario, usable: np.ndarray) -> tuple[np.ndarray, str | None]:
    """Return the commanded thrust divided by the mass (n,), in m/s², and a remark on its calculation from the log.

    Args:
        record: record of the flight.
        scenario: scenario with the `nominal` vehicle that the controller assumes.
        usable: (n,) mask of the samples in the air.

    Raises:
        InputError: if the log has no thrust command, or the thrust command is zero in the air.
    """
    mass, gravity = float(scenario.nominal.mass), float(scenario.nominal.gravity)
    if record.thrust_command is not None:
        return record.thrust_command / mass, f"the thrust is divided by the nominal mass, {mass:g} kg"
    if record.thrust_fraction is None:
        raise InputError(
            f"the log {short_repr(record.name)} has no thrust command (thrust_command or thrust_fraction), so the"
            " commanded acceleration is unknown"
        )
    if record.hover_thrust_fraction is not None:
        return thrust_of_fraction(record, mass * gravity) / mass, None
    hover_command = float(np.median(record.thrust_fraction[usable]))
    if hover_command <= 0.0:
        raise InputError(f"thrust_fraction of the log {short_repr(record.name)} is zero in the air; check the mapping")
    remark = f"the median thrust command in the air, {hover_command:.3g} of full thrust, is assumed to carry the weight"
    return gravity * record.thrust_fraction / hover_command, remark


def law_output(record: FlightRecord, thrust: np.ndarray, form: Form, gravity: float) -> np.ndarray:
    """Return the output (n, 3) of the position law.

    Args:
        record: record with attitude_command, or with attitude in its place.
        thrust: (n,) commanded thrust divided by the mass, m/s².
        form: relation between the output and the commands.
        gravity: gravitational acceleration, m/s².

    Returns:
        (n, 3) output in W, m/s². In the form `tilt`, the output is along the axes of the heading, and X and Y are in
        rad.
    """
    attitude = record.attitude if record.attitude_command is None else record.attitude_command
    assert attitude is not None
    if form == "tilt":
        return np.column_stack([attitude[:, 1], -attitude[:, 0], thrust - gravity])
    if form == "heading":
        attitude = np.column_stack([attitude[:, :2], _yaw(record)])
    axis = rotation_matrices(attitude).apply([0.0, 0.0, 1.0])
    if form == "decoupled":
        horizontal = gravity * axis[:, :2] / np.maximum(axis[:, 2:], _MIN_ALIGNMENT_COSINE)
        return np.column_stack([horizontal, thrust * axis[:, 2] - gravity])
    magnitude = thrust
    if form == "projected" and record.attitude is not None:
        measured = rotation_matrices(record.attitude).apply([0.0, 0.0, 1.0])
        magnitude = thrust / np.maximum(np.sum(axis * measured, axis=1), _MIN_ALIGNMENT_COSINE)
    return np.asarray(magnitude[:, None] * axis - [0.0, 0.0, gravity])


def _yaw(record: FlightRecord) -> np.ndarray:
    """Return the measured yaw (n,), or the commanded yaw if no attitude is logged."""
    attitude = record.attitude_command if record.attitude is None else record.attitude
    assert attitude is not None
    return attitude[:, 2]


def in_heading(record: FlightRecord, values: np.ndarray) -> np.ndarray:
    """Return the components (n, 3) of vectors in W along the axes of the heading: forward, left and up."""
    cosine, sine = np.cos(_yaw(record)), np.sin(_yaw(record))
    x, y, z = values.T
    return np.column_stack([cosine * x + sine * y, cosine * y - sine * x, z])


def unproduced_output(output: np.ndarray, form: Form, gravity: float) -> np.ndarray:
    """Return the part (n, 3) of a law's horizontal output that the thrust does not produce.

    If the vertical acceleration u_z is negative, the tilt of the form `decoupled` produces the fraction (1 + u_z / g)
    of the horizontal output. PX4 treats this as saturation, and subtracts 2 / k_v times the remainder from the velocity
    error that it integrates (`PositionControl.cpp` of PX4 1.15). All other forms produce the whole output.
    """
    horizontal = np.array([1.0, 1.0, 0.0])
    fraction = np.clip(-output[:, 2:] / gravity, 0.0, 1.0) if form == "decoupled" else 0.0
    return np.asarray(fraction * horizontal * output)


def at_limit(record: FlightRecord, thrust: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """Return a mask (n,) of the samples in which thrust, roll, pitch or tilt is at a limit.

    Args:
        record: record of the flight.
        thrust: (n,) commanded thrust in any unit.
        usable: (n,) mask of the samples in the air.
    """
    signals = [thrust, -thrust]
    if record.attitude_command is not None:
        roll, pitch, _ = record.attitude_command.T
        signals += [roll, -roll, pitch, -pitch, np.arccos(np.cos(roll) * np.cos(pitch))]
    is_limited = np.zeros(len(thrust), dtype=bool)
    max_samples = _MAX_LIMITED_FRACTION * usable.sum()
    for signal in signals:
        largest = float(signal[usable].max())
        margin = _LIMIT_MARGIN * (largest - float(signal[usable].min()))
        distance = np.where(usable, largest - signal, np.inf)
        is_near = distance <= margin
        num_beside = np.sum((distance > margin) & (distance <= 2.0 * margin))
        if (
            margin > 0.0
            and max(_MIN_LIMITED_SAMPLES, _MIN_COUNT_RATIO * (num_beside + 1)) <= is_near.sum() <= max_samples
        ):
            is_limited |= is_near
    return is_limited
