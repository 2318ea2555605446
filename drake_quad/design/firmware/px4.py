"""PX4's multicopter controllers in the scenario language.

PX4 commands thrust and torques in normalised units, whereas the gains of a scenario have SI units. PX4 assumes that the
thrust is proportional to its command, and that the command MPC_THR_HOVER supports the weight. The unit of the torques
follows from its mixer (`ControlAllocationPseudoInverse`). The conversion therefore needs the nominal vehicle's rotor
positions, the rotors' ratio of drag to thrust, the mass and the moments of inertia.
"""

import math
from collections.abc import Mapping
from typing import Any

from drake_quad.vehicle.parameters import QuadrotorParameters
from drake_quad.vehicle.px4_units import torque_units

# Limit on the velocity loop's horizontal integrals, m/s². It is never reached, since PX4 limits these integrals only by
# anti-windup.
_UNREACHED_INTEGRAL_LIMIT = 1000.0
# Body rate error above which the rate loop stops integrating (rate_control.cpp), rad/s.
_INTEGRAL_FADE_ERROR = math.radians(400.0)
_AXES = ("ROLL", "PITCH", "YAW")
_INTEGRAL_LIMITS = ("MC_RR_INT_LIM", "MC_PR_INT_LIM", "MC_YR_INT_LIM")
# Longest period of the fastest loop on board, s. All loop periods are 20 ms divided by a power of two.
_MAX_LOOP_PERIOD = 0.02
# Standard gravity in PX4 (CONSTANTS_ONE_G), m/s².
_GRAVITY = 9.80665


def px4_layer(values: Mapping[str, float], nominal: QuadrotorParameters) -> dict[str, Any]:
    """Return a scenario layer with PX4's controllers.

    Args:
        values: parameters of PX4, by name.
        nominal: parameters of the nominal vehicle.
    """

    def level_and_up(level: str, up: str) -> list[float]:
        return [values[level], values[level], values[up]]

    velocity: dict[str, Any] = {"k_p": level_and_up("MPC_XY_VEL_P_ACC", "MPC_Z_VEL_P_ACC")}
    integral = level_and_up("MPC_XY_VEL_I_ACC", "MPC_Z_VEL_I_ACC")
    if any(integral):
        velocity |= {
            "k_i": integral,
            "integral_limit": [_UNREACHED_INTEGRAL_LIMIT, _UNREACHED_INTEGRAL_LIMIT, _GRAVITY],
        }
    derivative = level_and_up("MPC_XY_VEL_D_ACC", "MPC_Z_VEL_D_ACC")
    if any(derivative):
        velocity["k_d"] = derivative
        if values["MPC_VELD_LP"] > 0.0:
            velocity |= {"derivative_bandwidth": [math.tau * values["MPC_VELD_LP"]] * 3, "derivative_order": 1}
    hover = values["MPC_THR_HOVER"]
    return {
        "control": {
            "kind": "pid_cascade",
            "position": {"k_p": level_and_up("MPC_XY_P", "MPC_Z_P")},
            "velocity": velocity,
            "velocity_feed_forward": 1.0,
            "command": {
                "kind": "acceleration",
                "feed_forward": 1.0,
                "max_speed": values["MPC_XY_VEL_MAX"],
                "max_ascent": values["MPC_Z_VEL_MAX_UP"],
                "max_descent": values["MPC_Z_VEL_MAX_DN"],
                "max_tilt": math.radians(values["MPC_TILTMAX_AIR"]),
                "min_thrust": values["MPC_THR_MIN"] / hover,
                "max_thrust": values["MPC_THR_MAX"] / hover,
                "horizontal_margin": values["MPC_THR_XY_MARG"] / hover,
                "decouples_vertical": bool(values["MPC_ACC_DECOUPLE"]),
            },
        },
        "laboratory": {"autopilot": _autopilot(values, nominal)},
        "vehicle": {"time_step": gyroscope_period(values)},
    }


def gyroscope_period(values: Mapping[str, float]) -> float:
    """Return the period of PX4's control loops, s.

    The period is 1 / IMU_GYRO_RATEMAX, rounded to the nearest period that is 20 ms divided by a power of two.
    """
    halvings = (
        round(math.log2(_MAX_LOOP_PERIOD * values["IMU_GYRO_RATEMAX"])) if values["IMU_GYRO_RATEMAX"] > 0.0 else 3
    )
    return _MAX_LOOP_PERIOD / 2.0 ** max(0, halvings)


def _autopilot(values: Mapping[str, float], nominal: QuadrotorParameters) -> dict[str, Any]:
    units = torque_units(nominal, values["MPC_THR_HOVER"])
    scales = [unit / moment for unit, moment in zip(units, nominal.inertia, strict=True)]

    def rates(term: str) -> list[float]:
        gains = (values[f"MC_{axis}RATE_K"] * values[f"MC_{axis}RATE_{term}"] for axis in _AXES)
        return [gain * scale for gain, scale in zip(gains, scales, strict=True)]

    terms: dict[str, Any] = {}
    if any(rates("I")):
        limits = [values[name] * scale for name, scale in zip(_INTEGRAL_LIMITS, scales, strict=True)]
        terms |= {"k_i": rates("I"), "integral_limit": limits, "integral_fade": _INTEGRAL_FADE_ERROR}
    if any(rates("D")):
        terms["k_d"] = rates("D")
        if values["IMU_DGYRO_CUTOFF"] > 0.0:
            terms |= {"derivative_bandwidth": [math.tau * values["IMU_DGYRO_CUTOFF"]] * 3, "derivative_order": 1}
    # The parameters *_K scale the P, I and D terms, but not the feed-forward.
    feed_forward = [values[f"MC_{axis}RATE_FF"] * scale for axis, scale in zip(_AXES, scales, strict=True)]
    if any(feed_forward):
        terms["k_ff"] = feed_forward
    autopilot = {
        "kind": "attitude",
        "period": gyroscope_period(values),
        "k_attitude": [values[f"MC_{axis}_P"] for axis in _AXES],
        "yaw_weight": values["MC_YAW_WEIGHT"],
        "max_rates": [math.radians(values[f"MC_{axis}RATE_MAX"]) for axis in _AXES],
        "k_rate": rates("P"),
        "rate_terms": terms,
        "gyroscopic_torque": False,
    }
    if values["IMU_GYRO_CUTOFF"] > 0.0:
        autopilot["gyroscope_bandwidth"] = math.tau * values["IMU_GYRO_CUTOFF"]
    return autopilot
