"""Stand-in for a vehicle with PX4 or ArduPilot, written from the public descriptions of MAVLink and of both stacks.

It follows setpoints with the axes forward, right and down, and north, east and down. A position setpoint moves a point
mass with a spring and a damper; an attitude setpoint turns the vehicle with a lag.
"""

import math

import numpy as np
from pymavlink import mavutil

mavlink = mavutil.mavlink
GRAVITY = 9.80665
ARDUPILOT_MODES = {"STABILIZE": 0, "GUIDED": 4, "RTL": 6, "LAND": 9, "BRAKE": 17}
_LAG = 0.05  # s, of the attitude
_STEP = 0.004  # s
_OFFBOARD_TIMEOUT = 0.5  # s without setpoints after which PX4 leaves the mode
# Route of a short flight.
HOP = {
    "kind": "waypoints",
    "waypoints": [{"point": [0, 0, 1]}, {"point": [1, 0.5, 1.5]}],
    "times": [0.0, 3.0],
    "top_speed": None,
    "top_acceleration": None,
}


class SimulatedClock:
    """Clock that advances only while somebody waits, together with the vehicles. Flights are therefore repeatable."""

    def __init__(self):
        self.time, self.vehicles, self._events = 0.0, [], []

    def now(self):
        return self.time

    def sleep(self, duration):
        """Advance by a duration, s. Due events run at the end of each step."""
        end = self.time + max(0.0, duration)
        while self.time < end:
            self.time = min(end, self.time + _STEP)
            for vehicle in self.vehicles:
                vehicle.update(self.time)
            due = [event for event in self._events if event[0] <= self.time]
            self._events = [event for event in self._events if event[0] > self.time]
            for _, action in due:
                action()

    def call_later(self, delay, action):
        """Call a function without arguments after a delay, s."""
        self._events.append((self.time + delay, action))


class StandInVehicle:
    """Vehicle that hovers at a position (north, east, down), and sends its messages to a UDP port.

    Attributes:
        received: all setpoint messages, with the time at which they arrived.
        commands: all messages COMMAND_LONG.
        state: position and velocity (north, east, down), roll, pitch, yaw and body rates; a test may set it.
    """

    def __init__(
        self,
        port,
        *,
        stack="px4",
        clock,
        position=(3.0, -2.0, -1.5),
        yaw=0.4,
        armed=True,
        on_ground=False,
        system=7,
        address=None,
    ):
        self.stack, self.clock, self.armed, self.on_ground = stack, clock, armed, on_ground
        self.mode = "POSCTL" if stack == "px4" else "STABILIZE"
        self.parameters = {"MPC_THR_HOVER": 0.45, "MOT_THST_HOVER": 0.35, "GUID_OPTIONS": 8.0, "ATC_ANGLE_BOOST": 0.0}
        self.hover = 0.45 if stack == "px4" else 0.35
        self.state = np.array([*position, 0, 0, 0, 0, 0, yaw, 0, 0, 0], dtype=float)
        self.received, self.commands, self.heartbeats = [], [], []
        self.streams, self.accepts_modes, self.disturbance = True, True, np.zeros(3)
        self.setpoint, self.setpoint_time = None, -math.inf
        self.interval = {"LOCAL_POSITION_NED": 0.1, "ATTITUDE": 0.1, "HEARTBEAT": 1.0, "EXTENDED_SYS_STATE": math.inf}
        self.interval["VFR_HUD"] = math.inf
        self.has_thrust = True
        self.modes_accepted, self.has_landed_state, self.fast_heartbeats = None, True, True
        self._link = mavutil.mavlink_connection(
            address or f"udpout:127.0.0.1:{port}", source_system=system, source_component=1
        )
        self._next = dict.fromkeys(self.interval, 0.0)
        self._last = clock.now()
        clock.vehicles.append(self)

    def close(self):
        self.clock.vehicles.remove(self)
        self._link.close()

    def update(self, now):
        """Receive messages, move, and send messages until a time, s."""
        while (message := self._receive()) is not None:
            self._process(message, now)
        self._step(now - self._last, now)
        self._last = now
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
            if name != "HEARTBEAT" or self.fast_heartbeats:
                self.interval[name] = message.param2 / 1e6 or 1.0
                self._next[name] = 0.0
        elif message.command == mavlink.MAV_CMD_REQUEST_MESSAGE and self.fast_heartbeats:
            self._next["HEARTBEAT"] = 0.0
        elif message.command == mavlink.MAV_CMD_DO_SET_MODE:
            if self.stack == "px4":
                numbers = (message.param2, message.param3)
                modes = [name for name, values in mavutil.px4_map.items() if values[1:] == numbers]
            else:
                modes = [name for name, number in ARDUPILOT_MODES.items() if number == message.param2]
            # PX4 requires more than one second of setpoints before it changes to offboard mode.
            is_early = modes == ["OFFBOARD"] and not (self.received and self._last - self.received[0][0] > 1.0)
            if (
                modes
                and self.accepts_modes
                and not is_early
                and (self.modes_accepted is None or modes[0] in self.modes_accepted)
            ):
                (self.mode,) = modes
            else:
                result = mavlink.MAV_RESULT_DENIED
        self._link.mav.command_ack_send(message.command, result)

    @property
    def follows(self):
        return self.mode in ("OFFBOARD", "GUIDED")

    def _step(self, dt, now):
        position, velocity, attitude = self.state[:3], self.state[3:6], self.state[6:9]
        if self.mode == "OFFBOARD" and now - self.setpoint_time > _OFFBOARD_TIMEOUT:
            self.mode = "LOITER"
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
            thrust = message.thrust / self.hover
            if self.stack == "ardupilot" and self.parameters.get("ATC_ANGLE_BOOST"):
                thrust /= up[2]
            acceleration = np.array([0.0, 0.0, GRAVITY]) - GRAVITY * thrust * up
        acceleration = acceleration + self.disturbance
        self.state[:3] += dt * velocity + 0.5 * dt**2 * acceleration
        self.state[3:6] += dt * acceleration
        self.state[6:9] += dt * rates
        self.state[9:12] = rates

    def _send(self, now):
        mav, milliseconds = self._link.mav, int(1e3 * now)
        if now >= self._next["HEARTBEAT"] and self.streams:
            self._next["HEARTBEAT"] = now + self.interval["HEARTBEAT"]
            base = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | (mavlink.MAV_MODE_FLAG_SAFETY_ARMED * self.armed)
            if self.stack == "px4":
                _, main, sub = mavutil.px4_map[self.mode]
                autopilot, custom = mavlink.MAV_AUTOPILOT_PX4, main << 16 | sub << 24
                base |= mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED  # PX4 sets no flag for Offboard
            else:
                autopilot, custom = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, ARDUPILOT_MODES[self.mode]
            mav.heartbeat_send(mavlink.MAV_TYPE_QUADROTOR, autopilot, base, custom, mavlink.MAV_STATE_ACTIVE)
        if self.has_landed_state and now >= self._next["EXTENDED_SYS_STATE"]:
            self._next["EXTENDED_SYS_STATE"] = now + self.interval["EXTENDED_SYS_STATE"]
            mav.extended_sys_state_send(0, 1 if self.on_ground else 2)
        if self.has_thrust and now >= self._next["VFR_HUD"]:
            self._next["VFR_HUD"] = now + self.interval["VFR_HUD"]
            mav.vfr_hud_send(0.0, 0.0, 0, round(100.0 * self.hover), 0.0, 0.0)
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
