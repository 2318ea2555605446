"""Program that runs the Crazyflie's controller for one vehicle: it answers each `REQUEST` with a `REPLY`.

It imports only `cffirmware` and the standard library. The arguments of the program are the names of the controller and
of the estimator. The firmware's axes point forward, to the left and up, but its pitch has the opposite sign. Its angles
are in degrees.
"""

import math
import os
import socket
import struct
import sys
from typing import Any

REQUEST = struct.Struct("<I?17d")
"""Number of ticks of 1 ms, True if rates are commanded instead of angles, and 17 numbers.

The numbers are body rates (rad/s), specific force (m/s²), quaternion of the attitude (w, x, y, z), position (m),
commanded roll and pitch (rad or rad/s), commanded yaw rate (rad/s), and commanded thrust (1 for all motors at their
largest thrust).
"""
REPLY = struct.Struct("<4d")
"""Thrust of motors 1 to 4, relative to the largest thrust."""
_FULL_SCALE = 65_535
_GRAVITY = 9.81  # m/s², the firmware's unit of the specific force
# Ticks from a prediction of the Kalman filter to the next, as in the firmware (PREDICT_RATE), and from a pose of the
# motion capture to the next.
_PREDICTION_TICKS = _POSE_TICKS = 10
# Standard deviations of external poses, m and rad: defaults of the firmware's parameters locSrv.extPosStdDev and
# locSrv.extQuatStdDev.
_POSITION_DEVIATION, _ATTITUDE_DEVIATION = 0.01, 4.5e-3


class TrueAttitude:
    """Estimator `none`: the given attitude.

    Args:
        firmware: module with the bindings of the firmware.
    """

    def __init__(self, firmware: Any) -> None:
        self.state = firmware.state_t()

    def update(self, tick: int, sensors: Any, quaternion: tuple[float, ...], position: tuple[float, ...]) -> None:
        """Advance `state` to a tick, given the readings of the inertial sensors and the pose."""
        attitude, stored = self.state.attitude, self.state.attitudeQuaternion
        stored.w, stored.x, stored.y, stored.z = quaternion
        roll, pitch, yaw = map(math.degrees, _angles(*quaternion))
        attitude.roll, attitude.pitch, attitude.yaw = roll, -pitch, yaw


class KalmanFilter:
    """Estimator `kalman`: the firmware's Kalman filter, with poses of motion capture every 10 ms.

    Args:
        firmware: module with the bindings of the firmware.
    """

    def __init__(self, firmware: Any) -> None:
        self.state = firmware.state_t()
        self._firmware = firmware
        self._filter, self._parameters = firmware.kalmanCoreData_t(), firmware.kalmanCoreParams_t()
        self._pose = firmware.poseMeasurement_t()
        self._pose.stdDevPos, self._pose.stdDevQuat = _POSITION_DEVIATION, _ATTITUDE_DEVIATION
        self._gyroscope, self._accelerometer = firmware.Axis3fSubSampler_t(), firmware.Axis3fSubSampler_t()
        firmware.axis3fSubSamplerInit(self._gyroscope, math.pi / 180.0)
        firmware.axis3fSubSamplerInit(self._accelerometer, _GRAVITY)
        self._starts = True

    def update(self, tick: int, sensors: Any, quaternion: tuple[float, ...], position: tuple[float, ...]) -> None:
        """Advance `state` to a tick, given the readings of the inertial sensors and the pose."""
        firmware = self._firmware
        if self._starts:
            self._start(tick - 1, quaternion, position)
        firmware.axis3fSubSamplerAccumulate(self._gyroscope, sensors.gyro)
        firmware.axis3fSubSamplerAccumulate(self._accelerometer, sensors.acc)
        if tick % _PREDICTION_TICKS == 0:
            firmware.axis3fSubSamplerFinalize(self._gyroscope)
            firmware.axis3fSubSamplerFinalize(self._accelerometer)
            readings = self._accelerometer.subSample, self._gyroscope.subSample
            firmware.kalmanCorePredict(self._filter, self._parameters, *readings, tick, True)
        firmware.kalmanCoreAddProcessNoise(self._filter, self._parameters, tick)
        if tick % _POSE_TICKS == 0:
            pose = self._pose
            pose.x, pose.y, pose.z = position
            pose.quat.w, pose.quat.x, pose.quat.y, pose.quat.z = quaternion
            firmware.kalmanCoreUpdateWithPose(self._filter, pose)
        firmware.kalmanCoreFinalize(self._filter)
        firmware.kalmanCoreExternalizeState(self._filter, self.state, sensors.acc)

    def _start(self, tick: int, quaternion: tuple[float, ...], position: tuple[float, ...]) -> None:
        """Initialise the filter at the position and the yaw of the vehicle."""
        parameters = self._parameters
        self._firmware.kalmanCoreDefaultParams(parameters)
        parameters.initialX, parameters.initialY, parameters.initialZ = position
        _, _, parameters.initialYaw = _angles(*quaternion)
        self._firmware.kalmanCoreInit(self._filter, parameters, tick)
        self._starts = False


def _angles(w: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return roll, pitch and yaw of a unit quaternion, rad."""
    return (
        math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
        math.asin(min(max(2.0 * (w * y - z * x), -1.0), 1.0)),
        math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
    )


class Controller:
    """Controller of the firmware, with which it computes the motor commands from an attitude setpoint.

    Args:
        firmware: module with the bindings of the firmware.
        name: `pid`, `mellinger` or `lee`.
    """

    def __init__(self, firmware: Any, name: str) -> None:
        self._control = firmware.control_t()
        function = f"controller{name.capitalize()}"
        self._function = getattr(firmware, function)
        # The PID controller keeps its state in global variables.
        self._memory = () if name == "pid" else (getattr(firmware, f"{function}_t")(),)
        getattr(firmware, f"{function}Init")(*self._memory)

    def command(self, setpoint: Any, sensors: Any, state: Any, tick: int) -> Any:
        """Return the firmware's `control_t` at a tick."""
        self._function(*self._memory, self._control, setpoint, sensors, state, tick)
        return self._control


def main() -> None:
    """Answer requests until the connection is closed."""
    import cffirmware

    controller = Controller(cffirmware, sys.argv[1])
    estimator = (KalmanFilter if sys.argv[2] == "kalman" else TrueAttitude)(cffirmware)
    setpoint, sensors = cffirmware.setpoint_t(), cffirmware.sensorData_t()
    uncapped, capped = cffirmware.motors_thrust_uncapped_t(), cffirmware.motors_thrust_pwm_t()
    for axis in "xyz":
        setattr(setpoint.mode, axis, cffirmware.modeDisable)
    setpoint.mode.quat, setpoint.mode.yaw = cffirmware.modeDisable, cffirmware.modeVelocity
    tick = 0
    with socket.socket(fileno=int(os.environ["LOCKSTEP_SOCKET"])) as connection:
        connection.send(REPLY.pack(0.0, 0.0, 0.0, 0.0))
        while request := connection.recv(REQUEST.size):
            ticks, commands_rates, *numbers = REQUEST.unpack(request)
            p, q, r, f_x, f_y, f_z = numbers[:6]
            quaternion, position = tuple(numbers[6:10]), tuple(numbers[10:13])
            # Angles in degrees or, in acro mode, rates in degrees per second; the yaw is a rate in both modes.
            roll, pitch, yaw_rate = map(math.degrees, numbers[13:16])
            sensors.gyro.x, sensors.gyro.y, sensors.gyro.z = map(math.degrees, (p, q, r))
            sensors.acc.x, sensors.acc.y, sensors.acc.z = f_x / _GRAVITY, f_y / _GRAVITY, f_z / _GRAVITY
            mode = cffirmware.modeVelocity if commands_rates else cffirmware.modeAbs
            setpoint.mode.roll = setpoint.mode.pitch = mode
            wanted = setpoint.attitudeRate if commands_rates else setpoint.attitude
            wanted.roll, wanted.pitch = roll, -pitch
            setpoint.attitudeRate.yaw = yaw_rate
            setpoint.thrust = min(max(numbers[16], 0.0), 1.0) * _FULL_SCALE
            for _ in range(ticks):
                tick += 1
                estimator.update(tick, sensors, quaternion, position)
                control = controller.command(setpoint, sensors, estimator.state, tick)
                cffirmware.powerDistribution(control, uncapped)
                cffirmware.powerDistributionCap(uncapped, capped)
            motors = capped.motors
            connection.send(REPLY.pack(*(each / _FULL_SCALE for each in (motors.m1, motors.m2, motors.m3, motors.m4))))


if __name__ == "__main__":
    main()
