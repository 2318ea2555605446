"""The PID controller of the Crazyflie's firmware in the scenario language.

The firmware commands angles in degrees, and rotor thrusts in units of 1/65535 of the largest thrust. Battery
compensation keeps the largest thrust constant. One unit of its roll and pitch output changes each rotor by half a unit,
and one unit of its yaw output by one unit (`powerDistributionLegacy`). The gains of a scenario have SI units. The
conversion therefore needs the nominal vehicle's rotor positions, the rotors' ratio of drag to thrust, the mass and the
moments of inertia.
"""

import math
from collections.abc import Mapping
from typing import Any

from drake_quad.vehicle.parameters import QuadrotorParameters

# Largest rotor thrust with standard propellers, N (platform_defaults_cf2.h, THRUST_MAX).
MAX_THRUST = 0.12
# Periods of the control loops (stabilizer_types.h).
POSITION_PERIOD = 0.01  # s, period of the position and velocity loops
ATTITUDE_PERIOD = 0.002  # s, period of the attitude and body rate loops
_MAX_ROTOR_COMMAND = 65535.0  # command units
# Thrust, in command units, that the velocity loop along Z commands per unit of its output.
_THRUST_SCALE = 1000.0
# Largest output of the position loop, relative to the parameter for the largest velocity.
_VELOCITY_LIMIT_FACTOR = 1.1
# The limit on the velocity along Z is at least this value, m/s, even if the parameter `posCtlPid.zVelMax` is smaller.
_MIN_CLIMB_LIMIT = 0.5
# Limits on the error integrals (pid.h, platform_defaults_cf2.h).
_INTEGRAL_LIMIT = 5000.0  # m s in the position loop, and m in the velocity loop, on each axis
_ATTITUDE_INTEGRAL_LIMITS = (20.0, 20.0, 360.0)  # ° s for roll, pitch and yaw
_RATE_INTEGRAL_LIMITS = (33.3, 33.3, 166.7)  # ° for the roll, pitch and yaw rates
# Largest output of the body rate loop, in command units.
_MAX_RATE_LOOP_OUTPUT = 32767.0
# Largest output of the velocity loop along Z, in thousands of command units.
_MAX_THRUST_CHANGE = 32.767
# Cutoff frequency of the derivative filters in the position and velocity loops, Hz.
_DERIVATIVE_CUTOFF = 20.0
_DEGREE = math.pi / 180.0  # rad
_POSITION_AXES = ("x", "y", "z")
_ANGLES = ("roll", "pitch", "yaw")


def crazyflie_layer(
    values: Mapping[str, float], nominal: QuadrotorParameters, max_thrust: float = MAX_THRUST
) -> dict[str, Any]:
    """Return a scenario layer with the firmware's controller.

    Args:
        values: parameters of the firmware, by name.
        nominal: parameters of the nominal vehicle.
        max_thrust: largest rotor thrust, which corresponds to 65535 units, N.
    """
    unit = max_thrust / _MAX_ROTOR_COMMAND
    per_velocity = _THRUST_SCALE * 4.0 * unit / nominal.mass
    weight = nominal.mass * nominal.gravity
    scales = [_DEGREE, _DEGREE, per_velocity]
    position = _loop(
        _gains(values, "posCtlPid.{axis}K{term}", _POSITION_AXES),
        (1.0, 1.0, 1.0),
        (_INTEGRAL_LIMIT,) * 3,
        (_DERIVATIVE_CUTOFF,) * 3,
    )
    fastest = [values[f"posCtlPid.{axis}VelMax"] for axis in "xyz"]
    position["limit"] = [
        _VELOCITY_LIMIT_FACTOR * each for each in (fastest[0], fastest[1], max(fastest[2], _MIN_CLIMB_LIMIT))
    ]
    velocity_gains = _gains(values, "velCtlPid.v{axis}K{term}", _POSITION_AXES)
    velocity = _loop(velocity_gains, scales, (_INTEGRAL_LIMIT,) * 3, (_DERIVATIVE_CUTOFF,) * 3)
    tilts = [values["posCtlPid.pLimit"] * _DEGREE, values["posCtlPid.rLimit"] * _DEGREE]
    velocity["limit"] = [*tilts, _MAX_THRUST_CHANGE * per_velocity]
    return {
        "control": {
            "kind": "pid_cascade",
            "period": POSITION_PERIOD,
            "position": position,
            "velocity": velocity,
            "velocity_feed_forward": 0.0,
            "command": {
                "kind": "tilt",
                "hover_thrust": values["posCtlPid.thrustBase"] * 4.0 * unit / weight,
                "min_thrust": values["posCtlPid.thrustMin"] * 4.0 * unit / weight,
                "max_thrust": _MAX_ROTOR_COMMAND * 4.0 * unit / weight,
            },
        },
        "laboratory": {
            "command_link": {"period": ATTITUDE_PERIOD},
            "motion_capture": {"period": ATTITUDE_PERIOD},
            "autopilot": _autopilot(values, nominal, unit),
        },
        "vehicle": {"time_step": ATTITUDE_PERIOD},
    }


def output_scales(nominal: QuadrotorParameters, unit: float) -> tuple[float, float, float]:
    """Return the angular accelerations about x, y, z that one unit of the roll, pitch and yaw outputs causes, rad/s².

    Args:
        nominal: parameters of the nominal vehicle.
        unit: rotor thrust per command unit, N.
    """
    rotors, inertia = nominal.rotors, nominal.inertia
    roll = sum(0.5 * abs(rotor.y) * unit for rotor in rotors)
    pitch = sum(0.5 * abs(rotor.x) * unit for rotor in rotors)
    yaw = sum(rotor.drag_factor / rotor.thrust_factor * unit for rotor in rotors)
    return roll / inertia.i_xx, pitch / inertia.i_yy, yaw / inertia.i_zz


def _autopilot(values: Mapping[str, float], nominal: QuadrotorParameters, unit: float) -> dict[str, Any]:
    filters = [[values[f"pid_rate.om{axis}FiltCut"] for axis in "xyz"], [values["pid_attitude.attFiltCut"]] * 3]
    rate_cutoffs = filters[0] if values["pid_rate.rateFiltEn"] else None
    attitude_cutoffs = filters[1] if values["pid_attitude.attFiltEn"] else None
    attitude = _loop(
        _gains(values, "pid_attitude.{axis}_k{term}", _ANGLES),
        (1.0, 1.0, 1.0),
        [limit * _DEGREE for limit in _ATTITUDE_INTEGRAL_LIMITS],
        attitude_cutoffs,
    )
    per_output = output_scales(nominal, unit)
    rate_gains = _gains(values, "pid_rate.{axis}_k{term}", _ANGLES)
    scales = [each / _DEGREE for each in per_output]
    rate = _loop(rate_gains, scales, [limit * _DEGREE for limit in _RATE_INTEGRAL_LIMITS], rate_cutoffs)
    rate["limit"] = [_MAX_RATE_LOOP_OUTPUT * each for each in per_output]
    return {
        "kind": "attitude",
        "period": ATTITUDE_PERIOD,
        "k_attitude": attitude.pop("k_p"),
        "attitude_terms": attitude,
        "k_rate": rate.pop("k_p"),
        "rate_terms": rate,
        "gyroscopic_torque": False,
    }


def _gains(values: Mapping[str, float], pattern: str, axes: tuple[str, ...]) -> dict[str, list[float]]:
    """Return the gains on three axes, by term, from the parameters whose names match a pattern; case is ignored."""
    known = {name.lower(): value for name, value in values.items()}
    terms = ("p", "i", "d", "ff")
    return {term: [known[pattern.format(axis=axis, term=term).lower()] for axis in axes] for term in terms}


def _loop(
    gains: dict[str, list[float]],
    scales: Any,
    integral_limits: Any,
    cutoffs: Any,
) -> dict[str, Any]:
    """Return the fields of a PID: k_p, and the fields of each other term that has a nonzero gain.

    Args:
        gains: firmware gains on the three axes, by term.
        scales: scenario units per unit of the firmware's output, for each axis.
        integral_limits: largest integral of the error on each axis, in the unit of the error times s.
        cutoffs: cutoff frequencies of the derivative filters, Hz; None without filters.
    """
    scaled = {term: [gain * scale for gain, scale in zip(each, scales, strict=True)] for term, each in gains.items()}
    loop: dict[str, Any] = {"k_p": scaled["p"]}
    if any(scaled["i"]):
        loop["k_i"] = scaled["i"]
        # The scenario language requires a positive limit on every axis, even if the gain of the axis is zero.
        limits = zip(scaled["i"], integral_limits, strict=True)
        loop["integral_limit"] = [gain * limit or limit for gain, limit in limits]
        loop["integration"] = "backward_euler"
    if any(scaled["d"]):
        loop["k_d"] = scaled["d"]
        if cutoffs is not None:
            loop["derivative_bandwidth"] = [math.tau * cutoff for cutoff in cutoffs]
    if any(scaled["ff"]):
        loop["k_ff"] = scaled["ff"]
    return loop
