"""Stand-in for the Python bindings of the Crazyflie's firmware, with the parts that drake_quad uses.

It follows the conventions of the firmware: degrees, a pitch whose sign is opposite to that of the rate about y, and a
thrust of 65535 for all motors at their largest thrust.
"""

# ruff: noqa: N801, N816 - names of the firmware

import math
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
    return SimpleNamespace(attitude=_axes("roll", "pitch", "yaw"), attitudeQuaternion=_axes("w", "x", "y", "z"))


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


class controllerMellinger_t:
    initialised = False


controllerLee_t = controllerMellinger_t


def controllerMellingerInit(self):
    self.initialised = True
    controllerPidInit()


def controllerMellinger(self, control, setpoint, sensors, state, tick):
    assert self.initialised
    quaternion = state.attitudeQuaternion
    assert abs(sum(value * value for value in vars(quaternion).values()) - 1.0) < 1e-6
    controllerPid(control, setpoint, sensors, state, tick)
    if tick % 2 == 0:
        control.yaw *= 0.9


controllerLeeInit, controllerLee = controllerMellingerInit, controllerMellinger


def kalmanCoreData_t():
    return SimpleNamespace(pose=None, rates=None, prediction=None)


def kalmanCoreParams_t():
    return _axes("initialX", "initialY", "initialZ", "initialYaw")


def poseMeasurement_t():
    return SimpleNamespace(quat=_axes("w", "x", "y", "z"), **vars(_axes("x", "y", "z", "stdDevPos", "stdDevQuat")))


def Axis3fSubSampler_t():
    return SimpleNamespace(sum=_axes("x", "y", "z"), count=0, subSample=_axes("x", "y", "z"))


def axis3fSubSamplerInit(sampler, factor):
    sampler.factor = factor


def axis3fSubSamplerAccumulate(sampler, reading):
    sampler.count += 1
    for axis in "xyz":
        setattr(sampler.sum, axis, getattr(sampler.sum, axis) + getattr(reading, axis))


def axis3fSubSamplerFinalize(sampler):
    for axis in "xyz":
        setattr(sampler.subSample, axis, getattr(sampler.sum, axis) * sampler.factor / sampler.count)
    sampler.sum, sampler.count = _axes("x", "y", "z"), 0


def kalmanCoreDefaultParams(parameters):
    parameters.hasDefaults = True


def kalmanCoreInit(data, parameters, tick):
    assert parameters.hasDefaults
    data.position = parameters.initialX, parameters.initialY, parameters.initialZ
    data.quaternion = math.cos(0.5 * parameters.initialYaw), 0.0, 0.0, math.sin(0.5 * parameters.initialYaw)
    data.tick = tick


def kalmanCorePredict(data, parameters, acceleration, rates, tick, is_flying):
    assert is_flying
    time, (w, x, y, z) = 1e-3 * (tick - data.tick), data.quaternion
    a, b, c = (0.5 * time * rate for rate in (rates.x, rates.y, rates.z))
    data.quaternion = (
        w - a * x - b * y - c * z,
        x + a * w + c * y - b * z,
        y + b * w - c * x + a * z,
        z + c * w + b * x - a * y,
    )
    data.tick, data.acceleration = tick, acceleration


def kalmanCoreAddProcessNoise(data, parameters, tick):
    assert tick - data.tick < 10


def kalmanCoreUpdateWithPose(data, pose):
    assert (pose.stdDevPos, pose.stdDevQuat) == (0.01, 4.5e-3)
    data.position = pose.x, pose.y, pose.z
    data.quaternion = tuple(vars(pose.quat).values())


def kalmanCoreFinalize(data):
    norm = math.sqrt(sum(value * value for value in data.quaternion))
    data.quaternion = tuple(value / norm for value in data.quaternion)


def kalmanCoreExternalizeState(data, state, acceleration):
    w, x, y, z = data.quaternion
    vars(state.attitudeQuaternion).update(w=w, x=x, y=y, z=z)
    state.attitude.roll = math.degrees(math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)))
    state.attitude.pitch = -math.degrees(math.asin(2.0 * (w * y - z * x)))
    state.attitude.yaw = math.degrees(math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))


def powerDistribution(control, uncapped):
    roll, pitch, yaw = 0.5 * control.roll, 0.5 * control.pitch, control.yaw
    uncapped.motors.m1 = control.thrust - roll + pitch + yaw
    uncapped.motors.m2 = control.thrust - roll - pitch - yaw
    uncapped.motors.m3 = control.thrust + roll - pitch + yaw
    uncapped.motors.m4 = control.thrust + roll + pitch - yaw


def powerDistributionCap(uncapped, capped):
    for name, value in vars(uncapped.motors).items():
        setattr(capped.motors, name, min(max(value, 0.0), 65535.0))
