"""Stand-in for the Python bindings of the Crazyflie's firmware, with the parts that drake_quad uses.

It follows the conventions of the firmware: degrees, a pitch whose sign is opposite to that of the rate about y, and a
thrust of 65535 for all motors at their largest thrust.
"""

# ruff: noqa: N816 - names of the firmware

from types import SimpleNamespace

modeDisable, modeAbs, modeVelocity = 0, 1, 2
_ANGLE_GAIN, _RATE_GAIN = 6.0, 80.0  # 1/s, and thrust units per degree per second
_desired = {"yaw": None}


def _axes(*names):
    return SimpleNamespace(**dict.fromkeys(names, 0.0))


def control_t():
    return _axes("roll", "pitch", "yaw", "thrust")


def setpoint_t():
    return SimpleNamespace(
        mode=_axes("x", "y", "z", "roll", "pitch", "yaw", "quat"),
        attitude=_axes("roll", "pitch", "yaw"),
        attitudeRate=_axes("roll", "pitch", "yaw"),
        thrust=0.0,
    )


def state_t():
    return SimpleNamespace(attitude=_axes("roll", "pitch", "yaw"))


def sensorData_t():
    return SimpleNamespace(gyro=_axes("x", "y", "z"), acc=_axes("x", "y", "z"))


def motors_thrust_uncapped_t():
    return SimpleNamespace(motors=_axes("m1", "m2", "m3", "m4"))


motors_thrust_pwm_t = motors_thrust_uncapped_t


def controllerPidInit():
    _desired["yaw"] = None


def controllerPid(control, setpoint, sensors, state, tick):
    assert (setpoint.mode.x, setpoint.mode.y, setpoint.mode.z) == (modeDisable,) * 3
    assert setpoint.mode.yaw == modeVelocity
    if tick % 2:
        return
    if _desired["yaw"] is None:
        _desired["yaw"] = state.attitude.yaw
    _desired["yaw"] += 0.002 * setpoint.attitudeRate.yaw
    rates = {"roll": sensors.gyro.x, "pitch": -sensors.gyro.y, "yaw": sensors.gyro.z}
    for axis in ("roll", "pitch"):
        if getattr(setpoint.mode, axis) == modeVelocity:
            wanted = getattr(setpoint.attitudeRate, axis)
        else:
            wanted = _ANGLE_GAIN * (getattr(setpoint.attitude, axis) - getattr(state.attitude, axis))
        setattr(control, axis, _RATE_GAIN * (wanted - rates[axis]))
    control.yaw = -_RATE_GAIN * (_ANGLE_GAIN * (_desired["yaw"] - state.attitude.yaw) - rates["yaw"])
    control.thrust = setpoint.thrust


def powerDistribution(control, uncapped):
    roll, pitch, yaw = 0.5 * control.roll, 0.5 * control.pitch, control.yaw
    uncapped.motors.m1 = control.thrust - roll + pitch + yaw
    uncapped.motors.m2 = control.thrust - roll - pitch - yaw
    uncapped.motors.m3 = control.thrust + roll - pitch + yaw
    uncapped.motors.m4 = control.thrust + roll + pitch - yaw


def powerDistributionCap(uncapped, capped):
    for name, value in vars(uncapped.motors).items():
        setattr(capped.motors, name, min(max(value, 0.0), 65535.0))
