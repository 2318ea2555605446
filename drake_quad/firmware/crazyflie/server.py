"""Program that runs the Crazyflie's controller for one vehicle: it answers each `REQUEST` with a `REPLY`.

It imports only `cffirmware` and the standard library. The firmware's axes point forward, to the left and up, but its
pitch has the opposite sign. Its angles are in degrees.
"""

import math
import os
import socket
import struct

REQUEST = struct.Struct("<I?13d")
"""Number of ticks of 1 ms, True if rates are commanded instead of angles, and 13 numbers.

The numbers are body rates (rad/s), specific force (m/s²), roll, pitch and yaw (rad), commanded roll and pitch (rad or
rad/s), commanded yaw rate (rad/s), and commanded thrust (1 for all motors at their largest thrust).
"""
REPLY = struct.Struct("<4d")
"""Thrust of motors 1 to 4, relative to the largest thrust."""
_FULL_SCALE = 65_535
_GRAVITY = 9.81  # m/s², the firmware's unit of the specific force


def main() -> None:
    """Answer requests until the connection is closed."""
    import cffirmware

    control, setpoint = cffirmware.control_t(), cffirmware.setpoint_t()
    state, sensors = cffirmware.state_t(), cffirmware.sensorData_t()
    uncapped, capped = cffirmware.motors_thrust_uncapped_t(), cffirmware.motors_thrust_pwm_t()
    cffirmware.controllerPidInit()
    for axis in "xyz":
        setattr(setpoint.mode, axis, cffirmware.modeDisable)
    setpoint.mode.quat, setpoint.mode.yaw = cffirmware.modeDisable, cffirmware.modeVelocity
    tick = 0
    with socket.socket(fileno=int(os.environ["LOCKSTEP_SOCKET"])) as connection:
        connection.send(REPLY.pack(0.0, 0.0, 0.0, 0.0))
        while request := connection.recv(REQUEST.size):
            ticks, commands_rates, p, q, r, f_x, f_y, f_z, *angles, right, down, turn, thrust = REQUEST.unpack(request)
            roll, pitch, yaw = map(math.degrees, angles)
            right, down, turn = map(math.degrees, (right, down, turn))
            sensors.gyro.x, sensors.gyro.y, sensors.gyro.z = map(math.degrees, (p, q, r))
            sensors.acc.x, sensors.acc.y, sensors.acc.z = f_x / _GRAVITY, f_y / _GRAVITY, f_z / _GRAVITY
            state.attitude.roll, state.attitude.pitch, state.attitude.yaw = roll, -pitch, yaw
            mode = cffirmware.modeVelocity if commands_rates else cffirmware.modeAbs
            setpoint.mode.roll = setpoint.mode.pitch = mode
            wanted = setpoint.attitudeRate if commands_rates else setpoint.attitude
            wanted.roll, wanted.pitch = right, -down
            setpoint.attitudeRate.yaw = turn
            setpoint.thrust = min(max(thrust, 0.0), 1.0) * _FULL_SCALE
            for _ in range(ticks):
                tick += 1
                cffirmware.controllerPid(control, setpoint, sensors, state, tick)
                cffirmware.powerDistribution(control, uncapped)
                cffirmware.powerDistributionCap(uncapped, capped)
            motors = capped.motors
            connection.send(REPLY.pack(*(each / _FULL_SCALE for each in (motors.m1, motors.m2, motors.m3, motors.m4))))


if __name__ == "__main__":
    main()
