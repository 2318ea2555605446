"""Stand-in for ArduPilot, which speaks its JSON interface and stabilises a quadrotor with simple loops.

It is written from the public description of the interface, and shares no code with drake_quad.
"""

import json
import math
import socket
import struct
import threading

MAX_ANGLE, MAX_RATE, MAX_YAW_RATE = math.radians(45.0), math.radians(360.0), math.radians(202.5)
ANGLE_GAIN, RATE_GAIN, YAW_RATE_GAIN = 6.0, 0.04, 0.15  # 1/s, and motor commands per rad/s
IDLE = 0.05
# Place of motors 1 to 4 in front (+1) or at the back, and on the left (+1) or right; 1 for anticlockwise rotation.
FRONT, LEFT, ANTICLOCKWISE = (1, -1, 1, -1), (-1, 1, 1, -1), (1, 1, -1, -1)


class Peer(threading.Thread):
    """Stand-in for ArduPilot.

    Args:
        port: port at which the simulation listens.
        first_frame: number of the first datagram.
        num_servos: number of servo outputs in a datagram, 16 or 32.
        arms: False if the vehicle never arms.
        repeats: True to send every datagram twice, and a foreign datagram before it.
        max_steps: number of messages after which the peer stops.
    """

    def __init__(self, port, *, first_frame=0, num_servos=16, arms=True, repeats=False, max_steps=None):
        super().__init__(daemon=True)
        self.port, self.frame, self.num_servos, self.arms = port, first_frame, num_servos, arms
        self.repeats, self.max_steps = repeats, max_steps
        self.messages = []
        self.stopped = threading.Event()
        self.armed = False

    def run(self):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as connection:
            connection.settimeout(0.2)
            pulses = [1000] * 4
            while not self.stopped.is_set():
                self.send(connection, pulses)
                try:
                    message = json.loads(connection.recv(65536).strip(b"\n"))
                except (TimeoutError, ConnectionRefusedError):
                    continue
                self.messages.append(message)
                pulses = [round(1000 + 1000 * each) for each in self.motors(message)]
                self.frame += 1
                if len(self.messages) == self.max_steps:
                    return

    def send(self, connection, pulses):
        magic = {16: 18458, 32: 29569}[self.num_servos]
        outputs = [*pulses, *[1500] * (self.num_servos - 4)]
        datagram = struct.pack(f"<HHI{self.num_servos}H", magic, 800, self.frame, *outputs)
        if self.repeats:
            connection.sendto(b"hello", ("127.0.0.1", self.port))
            connection.sendto(datagram, ("127.0.0.1", self.port))
        connection.sendto(datagram, ("127.0.0.1", self.port))

    def motors(self, message):
        channels = [message["rc"][f"rc_{number}"] for number in range(1, 9)]
        roll_stick, pitch_stick, yaw_stick = ((channels[i] - 1500) / 500 for i in (0, 1, 3))
        throttle = (channels[2] - 1000) / 1000
        switch = channels[6] > 1800
        self.armed = switch and self.arms and (self.armed or throttle == 0.0)
        if not self.armed:
            return [0.0] * 4
        if throttle == 0.0:
            return [IDLE] * 4
        w, x, y, z = message["quaternion"]
        roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
        pitch = math.asin(2 * (w * y - z * x))
        p, q, r = message["imu"]["gyro"]
        if channels[4] < 1230:
            wanted = ANGLE_GAIN * (roll_stick * MAX_ANGLE - roll), ANGLE_GAIN * (pitch_stick * MAX_ANGLE - pitch)
        else:
            wanted = roll_stick * MAX_RATE, pitch_stick * MAX_RATE
        right, up = RATE_GAIN * (wanted[0] - p), RATE_GAIN * (wanted[1] - q)
        turn = YAW_RATE_GAIN * (yaw_stick * MAX_YAW_RATE - r)
        return [
            min(max(throttle + right * left + up * front + turn * anticlockwise, IDLE), 1.0)
            for front, left, anticlockwise in zip(FRONT, LEFT, ANTICLOCKWISE, strict=True)
        ]
