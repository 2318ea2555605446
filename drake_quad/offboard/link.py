"""MAVLink connection to the autopilot of a vehicle."""

import math
import os
import time
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol

from drake_quad.errors import InputError
from drake_quad.extras import import_extra
from drake_quad.offboard.setpoints import attitude_fields, measured_state, position_fields, rate_fields
from drake_quad.signals import AttitudeTarget, BodyRates, Reference, State

_HEARTBEAT_PERIOD = 1.0  # s
_CONNECTION_TIMEOUT = 10.0  # s until the first heartbeat
_PARAMETER_TIMEOUT = 5.0  # s until the value of a parameter
_REPEAT_PERIOD = 1.0  # s after which a request without an answer is repeated
_WAITING_STEP = 0.01  # s
_IGNORE_RATES, _IGNORE_ATTITUDE = 0b0000_0111, 0b1000_0000  # in the type mask of SET_ATTITUDE_TARGET
# Bit of ArduPilot's parameter GUID_OPTIONS with which the thrust in SET_ATTITUDE_TARGET is a thrust, and not a climb
# rate.
_THRUST_AS_THRUST = 0b1000


class OffboardError(RuntimeError):
    """Error of a vehicle that cannot be reached, or does not do what it must. The message is one sentence."""


class Clock(Protocol):
    """Clock of a flight."""

    def now(self) -> float:
        """Return the time, s."""

    def sleep(self, duration: float) -> None:
        """Wait for a duration, s."""


class RealTime:
    """Clock that shows the real time."""

    def now(self) -> float:
        """Return the time since an arbitrary moment, s."""
        return time.monotonic()

    def sleep(self, duration: float) -> None:
        """Wait for a duration, s."""
        time.sleep(max(0.0, duration))


class FlightStack(NamedTuple):
    """Names of modes and parameters of a flight stack.

    Attributes:
        name: name of the flight stack.
        offboard_mode: mode in which the vehicle follows setpoints.
        end_modes: mode that holds the position, lands, or returns to the place of take-off.
        hover_parameter: parameter with the thrust in hover, from 0 to 1.
    """

    name: str
    offboard_mode: str
    end_modes: Mapping[str, str]
    hover_parameter: str


PX4 = FlightStack(
    "PX4",
    "OFFBOARD",
    MappingProxyType({"hold": "LOITER", "land": "LAND", "return": "RTL"}),
    "MPC_THR_HOVER",
)
"""Modes of PX4, with the names that pymavlink gives them."""
ARDUPILOT = FlightStack(
    "ArduPilot",
    "GUIDED",
    MappingProxyType({"hold": "BRAKE", "land": "LAND", "return": "RTL"}),
    "MOT_THST_HOVER",
)
"""Modes of ArduPilot's copters."""
END_MODES = ("hold", "land", "return")
"""Keys of `FlightStack.end_modes`."""


class Telemetry(NamedTuple):
    """Last messages of the vehicle.

    Attributes:
        state: state of the vehicle; the origin is that of the autopilot's local frame.
        time: time of the older of the messages with position and attitude, s.
        mode: name of the flight mode; empty before the first heartbeat.
        is_armed: True if the motors are armed.
        is_on_ground: True if the autopilot reports that the vehicle stands on the ground.
    """

    state: State
    time: float
    mode: str
    is_armed: bool
    is_on_ground: bool


class VehicleLink:
    """MAVLink connection to the autopilot of a vehicle.

    Messages of other systems are ignored.

    Args:
        address: address in the notation of pymavlink, such as "udpin:127.0.0.1:14540", "tcp:127.0.0.1:5760" or
            "/dev/ttyUSB0".
        baud: baud rate of a serial port.
        clock: clock of the flight.

    Attributes:
        stack: flight stack of the autopilot.

    Raises:
        ImportError: if the library pymavlink is not installed.
        InputError: if the address cannot be opened.
        OffboardError: if no heartbeat of an autopilot arrives within 10 s, or the autopilot is not supported.
    """

    def __init__(self, address: str, *, baud: int = 57_600, clock: Clock | None = None) -> None:
        os.environ.setdefault("MAVLINK20", "1")  # pymavlink reads the protocol version when it is imported
        self._utilities = import_extra("pymavlink.mavutil", "px4")
        self._mavlink = self._utilities.mavlink
        self.clock, self._address = clock or RealTime(), address
        try:
            self._connection = self._utilities.mavlink_connection(
                address,
                baud=baud,
                source_component=self._mavlink.MAV_COMP_ID_ONBOARD_COMPUTER,
                autoreconnect=False,
                retries=1,
            )
        except (OSError, ValueError, IndexError, ImportError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            raise InputError(f"the address {address!r} cannot be opened: {reason.lower()}") from None
        self._vehicle: tuple[int, int] | None = None  # identifiers of the system and of its autopilot
        self._position: Any = None
        self._attitude: Any = None
        self._position_time = self._attitude_time = -math.inf
        self._heartbeat: Any = None
        self._is_on_ground = False
        self._parameters: dict[str, float] = {}
        self._refusals: dict[int, int] = {}  # result of each command that the vehicle refused, by its number
        self.warnings: list[str] = []
        self._start = self.clock.now()
        self._next_heartbeat = self._start
        try:
            self.stack = self._connect()
        except BaseException:
            self.close()
            raise

    def _connect(self) -> FlightStack:
        """Wait for a heartbeat of an autopilot, and return its flight stack."""
        if not self._wait(lambda: self._heartbeat is not None, _CONNECTION_TIMEOUT):
            raise OffboardError(
                f"no autopilot sent a heartbeat to {self._address} within {_CONNECTION_TIMEOUT:g} s; check the address"
                " and that no other program uses it"
            )
        stacks = {self._mavlink.MAV_AUTOPILOT_PX4: PX4, self._mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: ARDUPILOT}
        stack = stacks.get(self._heartbeat.autopilot)
        if stack is None or self._heartbeat.type != self._mavlink.MAV_TYPE_QUADROTOR:
            raise OffboardError(
                f"the vehicle at {self._address} has type {self._heartbeat.type} and autopilot"
                f" {self._heartbeat.autopilot} in MAVLink; only quadrotors with PX4 or ArduPilot are supported"
            )
        # A companion computer is a component of the vehicle. With another identifier, its heartbeats could replace
        # those of a ground station, whose loss must be noticed.
        self._connection.mav.srcSystem = self._vehicle[0] if self._vehicle else 1
        return stack

    def request_telemetry(self, period: float) -> None:
        """Request position and attitude with a period, s."""
        for message in ("LOCAL_POSITION_NED", "ATTITUDE"):
            number = getattr(self._mavlink, f"MAVLINK_MSG_ID_{message}")
            self._command(self._mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, number, 1e6 * period)
        number = self._mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE
        self._command(self._mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, number, 2e5)

    def telemetry(self) -> Telemetry | None:
        """Process all messages that have arrived, and return the last ones; None before the first position."""
        self.receive()
        if self._position is None or self._attitude is None:
            return None
        return Telemetry(
            measured_state(self._position, self._attitude),
            min(self._position_time, self._attitude_time),
            self._utilities.mode_string_v10(self._heartbeat),
            bool(self._heartbeat.base_mode & self._mavlink.MAV_MODE_FLAG_SAFETY_ARMED),
            self._is_on_ground,
        )

    def receive(self) -> None:
        """Process all messages that have arrived, and send a heartbeat if one is due.

        Raises:
            OffboardError: if the connection was closed.
        """
        now = self.clock.now()
        try:
            while (message := self._connection.recv_msg()) is not None:
                self._process(message, now)
        except (OSError, EOFError) as error:
            raise OffboardError(f"the connection to {self._address} was closed: {error}") from None
        if now >= self._next_heartbeat:
            self._next_heartbeat = now + _HEARTBEAT_PERIOD
            self._send(
                "heartbeat", self._mavlink.MAV_TYPE_ONBOARD_CONTROLLER, self._mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 0
            )

    def _process(self, message: Any, now: float) -> None:
        kind, source = message.get_type(), (message.get_srcSystem(), message.get_srcComponent())
        if kind == "HEARTBEAT" and message.autopilot != self._mavlink.MAV_AUTOPILOT_INVALID:
            self._vehicle = self._vehicle or source
        if source != self._vehicle:
            return
        if kind == "HEARTBEAT":
            self._heartbeat = message
        elif kind == "LOCAL_POSITION_NED":
            self._position, self._position_time = message, now
        elif kind == "ATTITUDE":
            self._attitude, self._attitude_time = message, now
        elif kind == "EXTENDED_SYS_STATE":
            self._is_on_ground = message.landed_state == self._mavlink.MAV_LANDED_STATE_ON_GROUND
        elif kind == "PARAM_VALUE":
            self._parameters[message.param_id] = message.param_value
        elif kind == "COMMAND_ACK":
            refused = message.result not in (
                self._mavlink.MAV_RESULT_ACCEPTED,
                self._mavlink.MAV_RESULT_IN_PROGRESS,
            )
            if refused:
                self._refusals[message.command] = message.result
        elif kind == "STATUSTEXT" and message.severity <= self._mavlink.MAV_SEVERITY_WARNING:
            self.warnings.append(message.text)

    def hover_thrust(self) -> float:
        """Return the thrust of the vehicle in hover, relative to the largest thrust.

        Raises:
            OffboardError: if the autopilot does not send the parameter, or would take the thrust for a climb rate.
        """
        if self.stack is ARDUPILOT and not int(self._parameter("GUID_OPTIONS")) & _THRUST_AS_THRUST:
            raise OffboardError(
                "ArduPilot would take the commanded thrust for a climb rate; add 8 to its parameter GUID_OPTIONS"
            )
        value = self._parameter(self.stack.hover_parameter)
        if not 0.05 < value < 0.95:
            raise OffboardError(f"{self.stack.hover_parameter} is {value:g}, but must be between 0.05 and 0.95")
        return value

    def _parameter(self, name: str) -> float:
        """Request the value of a parameter, and return it."""
        end = self.clock.now() + _PARAMETER_TIMEOUT
        while name not in self._parameters and self.clock.now() < end:
            self._send("param_request_read", *self._target, name.encode(), -1)
            self._wait(lambda: name in self._parameters, _REPEAT_PERIOD)
        if name not in self._parameters:
            raise OffboardError(f"{self.stack.name} did not send its parameter {name} within {_PARAMETER_TIMEOUT:g} s")
        return self._parameters[name]

    def set_mode(self, mode: str) -> None:
        """Command a flight mode, given the name that pymavlink gives it."""
        if self.stack is PX4:
            numbers = self._utilities.px4_map[mode]
        else:
            modes = self._utilities.mode_mapping_byname(self._mavlink.MAV_TYPE_QUADROTOR)
            numbers = (self._mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, modes[mode], 0)
        self._command(self._mavlink.MAV_CMD_DO_SET_MODE, *numbers)

    @property
    def mode_was_refused(self) -> bool:
        """True if the vehicle has refused a flight mode."""
        return self._mavlink.MAV_CMD_DO_SET_MODE in self._refusals

    def send_position(self, reference: Reference) -> None:
        """Send a setpoint of position, velocity, acceleration, yaw and yaw rate."""
        self._send(
            "set_position_target_local_ned",
            self._milliseconds,
            *self._target,
            self._mavlink.MAV_FRAME_LOCAL_NED,
            0,
            *position_fields(reference),
        )

    def send_attitude(self, target: AttitudeTarget, thrust: float) -> None:
        """Send a setpoint of the attitude, and of the thrust relative to the largest thrust."""
        self._send(
            "set_attitude_target",
            self._milliseconds,
            *self._target,
            _IGNORE_RATES,
            attitude_fields(target),
            0.0,
            0.0,
            0.0,
            thrust,
        )

    def send_rates(self, rates: BodyRates, thrust: float) -> None:
        """Send a setpoint of the body rates, and of the thrust relative to the largest thrust."""
        self._send(
            "set_attitude_target",
            self._milliseconds,
            *self._target,
            _IGNORE_ATTITUDE,
            (1.0, 0.0, 0.0, 0.0),
            *rate_fields(rates),
            thrust,
        )

    def close(self) -> None:
        """Close the connection."""
        self._connection.close()

    @property
    def _target(self) -> tuple[int, int]:
        return self._vehicle or (1, 1)

    @property
    def _milliseconds(self) -> int:
        return int(1e3 * (self.clock.now() - self._start)) & 0xFFFF_FFFF

    def _command(self, command: int, *parameters: float) -> None:
        self._refusals.pop(command, None)
        values = [float(each) for each in (*parameters, *[0.0] * (7 - len(parameters)))]
        self._send("command_long", *self._target, command, 0, *values)

    def _send(self, message: str, *fields: Any) -> None:
        try:
            getattr(self._connection.mav, f"{message}_send")(*fields)
        except OSError as error:
            raise OffboardError(f"{self._address} cannot be reached: {str(error.strerror).lower()}") from None

    def _wait(self, condition: Any, timeout: float) -> bool:
        """Receive messages until a condition is met, and return whether it was met within a time, s."""
        end = self.clock.now() + timeout
        while not condition():
            if self.clock.now() > end:
                return False
            self.receive()
            self.clock.sleep(_WAITING_STEP)
        return True
