"""Stand-in for PX4, which speaks MAVLink for simulators and stabilises a quadrotor with simple loops.

It is written from the public description of the messages, and shares no code with drake_quad. It estimates roll and
pitch from the readings of the gyroscope and the accelerometer.
"""

import math
import socket
import threading
import time

import numpy as np
from pymavlink.dialects.v20 import common

MAX_TILT, MAX_RATE, MAX_YAW_RATE = math.radians(45.0), math.radians(360.0), math.radians(200.0)
ANGLE_GAIN, RATE_GAIN, YAW_RATE_GAIN = 6.0, 0.04, 0.15  # 1/s, and motor commands per rad/s
CORRECTION_GAIN = 0.2  # 1/s; gain of the accelerometer in the estimate of the attitude
IDLE = 0.05
# Place of motors 1 to 4 in front (+1) or at the back, and on the right (+1) or left; 1 for anticlockwise rotation.
FRONT, RIGHT, ANTICLOCKWISE = (1, -1, 1, -1), (1, -1, -1, 1), (1, 1, -1, -1)


class Peer(threading.Thread):
    """Stand-in for PX4.

    Args:
        port: TCP port of the simulation.
        silent_steps: number of messages that are not answered at the start.
        arms: False if the vehicle never arms.
        talks: True to send other messages and old answers as well, in pieces of a few bytes.
        max_steps: number of messages after which the peer closes the connection.
        hangs_after: number of messages after which the peer does not answer any more.
    """

    def __init__(self, port, *, silent_steps=0, arms=True, talks=False, max_steps=None, hangs_after=None):
        super().__init__(daemon=True)
        self.port, self.silent_steps, self.arms, self.talks = port, silent_steps, arms, talks
        self.max_steps, self.hangs_after = max_steps, hangs_after
        self.sensors, self.satellites, self.channels = [], [], None
        self.stopped = threading.Event()
        self.armed = False
        self.down = np.array([0.0, 0.0, 1.0])  # estimate of the direction of gravity in the axes of the body
        self.encoder = common.MAVLink(None, srcSystem=1, srcComponent=1)

    def run(self):
        connection = self.connect()
        if connection is None:
            return
        decoder = common.MAVLink(None)
        with connection:
            connection.settimeout(0.2)
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            while not self.stopped.is_set():
                try:
                    data = connection.recv(65536)
                except TimeoutError:
                    continue
                except ConnectionError:
                    return
                if not data:
                    return
                for message in decoder.parse_buffer(data) or []:
                    self.handle(connection, message)
                    if len(self.sensors) == self.max_steps:
                        return

    def connect(self):
        while not self.stopped.is_set():
            try:
                return socket.create_connection(("127.0.0.1", self.port))
            except ConnectionRefusedError:
                time.sleep(0.01)
        return None

    def handle(self, connection, message):
        kind = message.get_type()
        if kind == "RC_CHANNELS":
            self.channels = message
        elif kind == "HIL_GPS":
            self.satellites.append(message)
        elif kind == "HIL_SENSOR":
            self.sensors.append(message)
            motors = self.motors(message)
            if len(self.sensors) > self.silent_steps and (self.hangs_after or math.inf) >= len(self.sensors):
                self.answer(connection, message.time_usec, motors)

    def answer(self, connection, microseconds, motors):
        controls = [*motors, *[0.0] * 12]
        answer = common.MAVLink_hil_actuator_controls_message(microseconds, controls, 129, 1).pack(self.encoder)
        if self.talks:
            heartbeat = common.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3).pack(self.encoder)
            old = common.MAVLink_hil_actuator_controls_message(microseconds - 2500, [1.0] * 16, 129, 1)
            answer = heartbeat + b"noise" + old.pack(self.encoder) + answer
        for first in range(0, len(answer), 40):
            connection.sendall(answer[first : first + 40])

    def motors(self, message):
        rates = np.array([message.xgyro, message.ygyro, message.zgyro])
        force = np.array([message.xacc, message.yacc, message.zacc])
        step = 0.0025
        self.down += step * (np.cross(self.down, rates) - CORRECTION_GAIN * (self.down + force / np.linalg.norm(force)))
        self.down /= np.linalg.norm(self.down)
        channels = [getattr(self.channels, f"chan{number}_raw") for number in range(1, 9)]
        roll_stick, pitch_stick, yaw_stick = ((channels[i] - 1500) / 500 for i in (0, 1, 3))
        throttle = (channels[2] - 1000) / 1000
        switch = channels[6] > 1800
        self.armed = switch and self.arms and (self.armed or throttle == 0.0)
        if not self.armed:
            return [0.0] * 4
        if throttle == 0.0:
            return [IDLE] * 4
        # The pitch stick forward lowers the nose. In these axes, a positive pitch raises it.
        roll, pitch = math.atan2(self.down[1], self.down[2]), -math.asin(self.down[0])
        if channels[4] < 1230:
            wanted = ANGLE_GAIN * (roll_stick * MAX_TILT - roll), ANGLE_GAIN * (-pitch_stick * MAX_TILT - pitch)
        else:
            wanted = roll_stick * MAX_RATE, -pitch_stick * MAX_RATE
        to_the_right, nose_up = RATE_GAIN * (wanted[0] - rates[0]), RATE_GAIN * (wanted[1] - rates[1])
        turn = YAW_RATE_GAIN * (yaw_stick * MAX_YAW_RATE - rates[2])
        return [
            min(max(throttle - to_the_right * right + nose_up * front + turn * anticlockwise, IDLE), 1.0)
            for front, right, anticlockwise in zip(FRONT, RIGHT, ANTICLOCKWISE, strict=True)
        ]
