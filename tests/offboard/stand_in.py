"""Stand-in for a vehicle with PX4 or ArduPilot, written from the public descriptions of MAVLink and of both stacks.

It follows setpoints with the axes forward, right and down, and north, east and down. A position setpoint moves a point
mass with a spring and a damper; an attitude setpoint turns the vehicle with a lag.
"""

import math
import threading
import time

import numpy as np
from pymavlink import mavutil

mavlink = mavutil.mavlink
GRAVITY = 9.80665
ARDUPILOT_MODES = {"STABILIZE": 0, "GUIDED": 4, "RTL": 6, "LAND": 9, "BRAKE": 17}
_LAG = 0.05  # s, of the attitude
_STEP = 0.004  # s
_OFFBOARD_TIMEOUT = 0.5  # s without setpoints after which the vehicle leaves the mode


class FastClock:
    """Clock that runs faster than the real time."""

    def __init__(self, speed=5.0):
        self.speed, self._start = speed, time.monotonic()

    def now(self):
        return self.speed * (time.monotonic() - self._start)

    def sleep(self, duration):
        time.sleep(max(0.0, duration / self.speed))


class StandInVehicle:
    """Vehicle that hovers at a position (north, east, down), and sends its messages to a UDP port.

    Attributes:
        received: all setpoint messages, with the time at which they arrived.
        commands: all messages COMMAND_LONG.
        state: position and velocity (north, east, down), roll, pitch, yaw and body rates; a test may set it.
    """

    def __init__(self, port, *, stack="px4", clock, position=(3.0, -2.0, -1.5), yaw=0.4, armed=True, on_ground=False):
        self.stack, self.clock, self.armed, self.on_ground = stack, clock, armed, on_ground
        self.mode = "POSCTL" if stack == "px4" else "STABILIZE"
        self.parameters = {"MPC_THR_HOVER": 0.45, "MOT_THST_HOVER": 0.35, "GUID_OPTIONS": 8.0}
        self.hover = 0.45 if stack == "px4" else 0.35
        self.state = np.array([*position, 0, 0, 0, 0, 0, yaw, 0, 0, 0], dtype=float)
        self.received, self.commands, self.heartbeats = [], [], []
        self.streams, self.accepts_modes, self.disturbance = True, True, np.zeros(3)
        self.setpoint, self.setpoint_time = None, -math.inf
        self.interval = {"LOCAL_POSITION_NED": 0.1, "ATTITUDE": 0.1}
        self.system = 7
        self._link = mavutil.mavlink_connection(f"udpout:127.0.0.1:{port}", source_system=7, source_component=1)
        self._next = {"heartbeat": 0.0, "LOCAL_POSITION_NED": 0.0, "ATTITUDE": 0.0, "EXTENDED_SYS_STATE": 0.0}
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self):
        self._stopped.set()
        self._thread.join()
        self._link.close()

    def _run(self):
        last = self.clock.now()
        while not self._stopped.is_set():
            self.clock.sleep(_STEP)
            now = self.clock.now()
            while (message := self._receive()) is not None:
                self._process(message, now)
            while last + _STEP < now:
                self._step(_STEP, last)
                last += _STEP
            self._send(now)

    def _receive(self):
        try:
            return self._link.recv_msg()
        except OSError:
            return None

    def _process(self, message, now):
        kind = message.get_type()
        if kind == "HEARTBEAT":
            self.heartbeats.append(message)
        elif kind in ("SET_POSITION_TARGET_LOCAL_NED", "SET_ATTITUDE_TARGET"):
            self.received.append((now, message))
            self.setpoint, self.setpoint_time = message, now
        elif kind == "PARAM_REQUEST_READ" and message.param_id in self.parameters:
            self._link.mav.param_value_send(message.param_id.encode(), self.parameters[message.param_id], 9, 1, 0)
        elif kind == "COMMAND_LONG":
            self.commands.append(message)
            self._command(message)

    def _command(self, message):
        result = mavlink.MAV_RESULT_ACCEPTED
        if message.command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
            name = mavlink.mavlink_map[int(message.param1)].msgname
            self.interval[name] = message.param2 / 1e6
        elif message.command == mavlink.MAV_CMD_DO_SET_MODE:
            if self.stack == "px4":
                numbers = (message.param1, message.param2, message.param3)
                modes = {
                    name: values for name, values in mavutil.px4_map.items() if tuple(map(float, values)) == numbers
                }
            else:
                modes = {name: number for name, number in ARDUPILOT_MODES.items() if number == message.param2}
            if modes and self.accepts_modes:
                (self.mode,) = modes
            else:
                result = mavlink.MAV_RESULT_DENIED
        self._link.mav.command_ack_send(message.command, result)

    @property
    def follows(self):
        return self.mode in ("OFFBOARD", "GUIDED")

    def _step(self, dt, now):
        position, velocity, attitude = self.state[:3], self.state[3:6], self.state[6:9]
        if self.follows and now - self.setpoint_time > _OFFBOARD_TIMEOUT:
            self.mode = "LOITER" if self.stack == "px4" else "BRAKE"
        message = self.setpoint if self.follows else None
        acceleration = -3.0 * velocity
        rates = np.zeros(3)
        if message is not None and message.get_type() == "SET_POSITION_TARGET_LOCAL_NED":
            target = np.array([message.x, message.y, message.z])
            speed = np.array([message.vx, message.vy, message.vz])
            acceleration = np.array([message.afx, message.afy, message.afz])
            acceleration = acceleration + 16.0 * (target - position) + 8.0 * (speed - velocity)
            rates[2] = np.clip(3.0 * math.remainder(message.yaw - attitude[2], 2.0 * math.pi), -1.5, 1.5)
        elif message is not None:
            if message.type_mask & 0b1000_0000:
                rates = np.array([message.body_roll_rate, message.body_pitch_rate, message.body_yaw_rate])
            else:
                target = euler(message.q)
                difference = [math.remainder(angle, 2.0 * math.pi) for angle in target - attitude]
                rates = np.array(difference) / _LAG
            up = rotation(*attitude)[:, 2]
            acceleration = np.array([0.0, 0.0, GRAVITY]) - GRAVITY * message.thrust / self.hover * up
        acceleration = acceleration + self.disturbance
        self.state[:3] += dt * velocity + 0.5 * dt**2 * acceleration
        self.state[3:6] += dt * acceleration
        self.state[6:9] += dt * rates
        self.state[9:12] = rates

    def _send(self, now):
        mav, milliseconds = self._link.mav, int(1e3 * now)
        if now >= self._next["heartbeat"]:
            self._next["heartbeat"] = now + 0.2
            base = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | (mavlink.MAV_MODE_FLAG_SAFETY_ARMED * self.armed)
            if self.stack == "px4":
                _, main, sub = mavutil.px4_map[self.mode]
                autopilot, custom = mavlink.MAV_AUTOPILOT_PX4, main << 16 | sub << 24
            else:
                autopilot, custom = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, ARDUPILOT_MODES[self.mode]
            mav.heartbeat_send(mavlink.MAV_TYPE_QUADROTOR, autopilot, base, custom, mavlink.MAV_STATE_ACTIVE)
        if now >= self._next["EXTENDED_SYS_STATE"]:
            self._next["EXTENDED_SYS_STATE"] = now + 0.2
            mav.extended_sys_state_send(0, 1 if self.on_ground else 2)
        for name, send, values in (
            ("LOCAL_POSITION_NED", mav.local_position_ned_send, self.state[:6]),
            ("ATTITUDE", mav.attitude_send, self.state[6:12]),
        ):
            if self.streams and now >= self._next[name]:
                self._next[name] = now + self.interval[name]
                send(milliseconds, *values)


def rotation(roll, pitch, yaw):
    """Return the matrix from forward, right and down to north, east and down."""
    s_r, c_r, s_p, c_p, s_y, c_y = (f(a) for a in (roll, pitch, yaw) for f in (math.sin, math.cos))
    return np.array(
        [
            [c_y * c_p, c_y * s_p * s_r - s_y * c_r, c_y * s_p * c_r + s_y * s_r],
            [s_y * c_p, s_y * s_p * s_r + c_y * c_r, s_y * s_p * c_r - c_y * s_r],
            [-s_p, c_p * s_r, c_p * c_r],
        ]
    )


def euler(quaternion):
    """Return roll, pitch and yaw of a quaternion (w, x, y, z)."""
    w, x, y, z = quaternion
    return np.array(
        [
            math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
            math.asin(2.0 * (w * y - z * x)),
            math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
        ]
    )
