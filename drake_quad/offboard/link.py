"""MAVLink connection to the autopilot of a vehicle."""

import math
import os
import socket
import stat
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol

from drake_quad.errors import InputError
from drake_quad.extras import import_extra
from drake_quad.offboard.setpoints import attitude_fields, measured_state, position_fields, rate_fields
from drake_quad.signals import AttitudeTarget, BodyRates, Reference, State

_NETWORK_ADDRESSES = ("udpin:", "udpout:", "tcp:", "tcpin:")
_HEARTBEAT_PERIOD = 1.0  # s
_CONNECTION_TIMEOUT = 10.0  # s until the first heartbeat
_SEARCH_TIME = 1.5  # s for which heartbeats of other vehicles are collected
_PARAMETER_TIMEOUT = 5.0  # s until the value of a parameter
_REPEAT_PERIOD = 1.0  # s after which a request without an answer is repeated
_WAITING_STEP = 0.01  # s
_WARNING_TIME = 5.0  # s for which a warning of the autopilot is remembered
_TELEMETRY = ("LOCAL_POSITION_NED", "ATTITUDE")
_STATUS_PERIODS = {"HEARTBEAT": 0.1, "EXTENDED_SYS_STATE": 0.2, "VFR_HUD": 0.2}  # s
_AUTOPILOT_COMPONENT = 1
_IN_AIR = 2  # value of landed_state
_IGNORE_RATES, _IGNORE_ATTITUDE = 0b0000_0111, 0b1000_0000  # in the type mask of SET_ATTITUDE_TARGET
# Bit of ArduPilot's parameter GUID_OPTIONS with which the thrust in SET_ATTITUDE_TARGET is a thrust, and not a climb
# rate.
_THRUST_AS_THRUST = 0b1000
_MIN_HOVER_THRUST, _MAX_HOVER_THRUST = 0.05, 0.95


class OffboardError(RuntimeError):
    """Error raised if the vehicle cannot be reached, or does not respond as required."""


class Clock(Protocol):
    """Clock of a flight."""

    def now(self) -> float:
        """Return the time, s."""

    def sleep(self, duration: float) -> None:
        """Wait for a duration, s."""


class RealTime:
    """Monotonic clock of the system."""

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
        end_modes: name of the mode for each value in `END_MODES`.
        hover_parameter: parameter with the thrust in hover, from 0 to 1.
    """

    name: str
    offboard_mode: str
    end_modes: Mapping[str, str]
    hover_parameter: str


END_MODES = ("hold", "land", "return")
"""Choices for the end of a flight: hold the position, land, or return to the place of take-off."""
PX4 = FlightStack(
    "PX4", "OFFBOARD", MappingProxyType({"hold": "LOITER", "land": "LAND", "return": "RTL"}), "MPC_THR_HOVER"
)
"""Modes of PX4, with the names that pymavlink gives them."""
ARDUPILOT = FlightStack(
    "ArduPilot", "GUIDED", MappingProxyType({"hold": "BRAKE", "land": "LAND", "return": "RTL"}), "MOT_THST_HOVER"
)
"""Modes of ArduPilot's copters."""


class Telemetry(NamedTuple):
    """Latest telemetry of the vehicle.

    Attributes:
        state: state of the vehicle; the origin is that of the autopilot's local frame.
        time: time at which the older one of position and attitude was sent, s; see `VehicleLink`.
        mode: name of the flight mode.
        mode_time: time at which the heartbeat with this mode arrived, s.
        is_armed: True if the motors are armed.
        is_in_air: True if the autopilot reports that the vehicle is in the air.
        thrust: present thrust relative to the largest one, in whole percent; None if it is unknown.
    """

    state: State
    time: float
    mode: str
    mode_time: float
    is_armed: bool
    is_in_air: bool
    thrust: float | None


class VehicleLink:
    """MAVLink connection to the autopilot of a vehicle.

    Messages of other systems are ignored. The time at which a message was sent is computed from the clock of the
    autopilot. The assumed difference of the two clocks is the smallest one so far, so that the delay of messages that
    waited in a queue is noticed.

    Args:
        address: address in the notation of pymavlink, such as "udpin:127.0.0.1:14540", "tcp:127.0.0.1:5760" or
            "/dev/ttyUSB0".
        baud: baud rate of a serial port.
        system: MAVLink identifier of the vehicle; None if it is the only one.
        clock: clock of the flight.

    Attributes:
        stack: flight stack of the autopilot.
        system: MAVLink identifier of the vehicle.
        max_byte_rate: bytes per second that a serial port transmits; infinite for a network.

    Raises:
        ImportError: if the library pymavlink or pyserial is not installed.
        InputError: if the address cannot be opened.
        OffboardError: if no heartbeat of an autopilot arrives within 10 s, the autopilot is not supported, or there are
            several vehicles.
    """

    def __init__(
        self, address: str, *, baud: int = 57_600, system: int | None = None, clock: Clock | None = None
    ) -> None:
        os.environ.setdefault("MAVLINK20", "1")  # pymavlink reads the protocol version when it is imported
        self._utilities = import_extra("pymavlink.mavutil", "px4")
        self._mavlink = self._utilities.mavlink
        self.clock, self._address = clock or RealTime(), address
        self.max_byte_rate = math.inf
        if not address.startswith(_NETWORK_ADDRESSES):
            import_extra("serial", "px4")
            self.max_byte_rate = baud / 10.0  # a byte has a start and a stop bit
        self._connection = self._opened(baud)
        self._system = system
        self._position: Any = None
        self._attitude: Any = None
        self._clock_difference = math.inf  # time of this clock minus time of the autopilot, s
        self._heartbeats: dict[int, Any] = {}  # by system
        self._heartbeat_time = -math.inf
        self._landed_state: int | None = None
        self._thrust: float | None = None
        self._parameters: dict[str, float] = {}
        self._refused_commands: set[int] = set()
        self._warnings: list[tuple[float, str]] = []
        self._start = self.clock.now()
        self._next_heartbeat = self._start
        try:
            self.stack = self._connect()
        except BaseException:
            self._connection.close()
            raise

    def _opened(self, baud: int) -> Any:
        """Return pymavlink's connection to the address."""
        address = self._address
        try:
            # pymavlink would also open log files, and start programs.
            if not address.startswith(_NETWORK_ADDRESSES) and not stat.S_ISCHR(Path(address).stat().st_mode):
                raise ValueError("it must be a serial port, or begin with udpin:, udpout:, tcp: or tcpin:")
            # A companion computer is a component of the vehicle. Heartbeats with the identifier of a ground station
            # would hide the loss of that station from the autopilot's failsafe.
            return self._utilities.mavlink_connection(
                address,
                baud=baud,
                source_system=1,
                source_component=self._mavlink.MAV_COMP_ID_ONBOARD_COMPUTER,
                autoreconnect=False,
                retries=1,
            )
        except (OSError, ValueError, IndexError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            raise InputError(f"the address {address!r} cannot be opened: {reason.lower()}") from None

    def _connect(self) -> FlightStack:
        """Wait for a heartbeat of an autopilot, and return its flight stack."""
        if not self._wait(lambda: bool(self._heartbeats), _CONNECTION_TIMEOUT):
            raise OffboardError(
                f"no autopilot sent a heartbeat to {self._address} within {_CONNECTION_TIMEOUT:g} s; check the address"
                " and that no other program uses it"
            )
        if self._system is None:
            self._wait(lambda: False, _SEARCH_TIME)
            if len(self._heartbeats) > 1:
                systems = ", ".join(map(str, sorted(self._heartbeats)))
                raise OffboardError(f"several vehicles send to {self._address}: systems {systems}; choose one of them")
            (self._system,) = self._heartbeats
        elif not self._wait(lambda: self._system in self._heartbeats, _CONNECTION_TIMEOUT):
            systems = ", ".join(map(str, sorted(self._heartbeats)))
            raise OffboardError(f"system {self._system} does not send to {self._address}, but only {systems}")
        stacks = {self._mavlink.MAV_AUTOPILOT_PX4: PX4, self._mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: ARDUPILOT}
        stack = stacks.get(self._heartbeat.autopilot)
        if stack is None or self._heartbeat.type != self._mavlink.MAV_TYPE_QUADROTOR:
            raise OffboardError(
                f"the vehicle at {self._address} is not a quadrotor with PX4 or ArduPilot (MAV_TYPE"
                f" {self._heartbeat.type}, MAV_AUTOPILOT {self._heartbeat.autopilot})"
            )
        self._connection.mav.srcSystem = self._system
        return stack

    @property
    def system(self) -> int:
        """MAVLink identifier of the vehicle."""
        return self._system or 1

    @property
    def _heartbeat(self) -> Any:
        return self._heartbeats[self.system]

    def request_telemetry(self, period: float) -> None:
        """Request position and attitude with a period (s), and the mode several times per second."""
        for message, interval in {**dict.fromkeys(_TELEMETRY, period), **_STATUS_PERIODS}.items():
            self._set_interval(message, 1e6 * interval)

    def _set_interval(self, message: str, microseconds: float) -> None:
        number = getattr(self._mavlink, f"MAVLINK_MSG_ID_{message}")
        self._command(self._mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, number, microseconds)

    def request_mode(self) -> None:
        """Request a heartbeat, which contains the flight mode."""
        self._command(self._mavlink.MAV_CMD_REQUEST_MESSAGE, self._mavlink.MAVLINK_MSG_ID_HEARTBEAT)

    def telemetry(self) -> Telemetry | None:
        """Process all messages that have arrived, and return the latest telemetry; None before the first position.

        Raises:
            OffboardError: if the connection was closed.
        """
        self._receive()
        if self._position is None or self._attitude is None:
            return None
        boot_time = 1e-3 * min(self._position.time_boot_ms, self._attitude.time_boot_ms)
        return Telemetry(
            measured_state(self._position, self._attitude),
            boot_time + self._clock_difference,
            self._mode(),
            self._heartbeat_time,
            bool(self._heartbeat.base_mode & self._mavlink.MAV_MODE_FLAG_SAFETY_ARMED),
            self._landed_state == _IN_AIR,
            self._thrust,
        )

    def _mode(self) -> str:
        """Return the name of the flight mode in the last heartbeat."""
        number = self._heartbeat.custom_mode
        if self.stack is PX4:
            main, sub = number >> 16 & 0xFF, number >> 24
            names = {(modes[1], modes[2]): name for name, modes in self._utilities.px4_map.items()}
            return str(names.get((main, sub), f"mode {main}.{sub}"))
        return str(self._utilities.mode_mapping_acm.get(number, f"mode {number}"))

    def _receive(self) -> None:
        """Process all messages that have arrived, and send a heartbeat if one is due."""
        now = self.clock.now()
        self._check_connection()
        # A network may fail for a moment. The age of the telemetry decides whether a flight must end.
        with suppress(OSError):
            while (message := self._connection.recv_msg()) is not None:
                self._process(message, now)
        if now >= self._next_heartbeat:
            self._next_heartbeat = now + _HEARTBEAT_PERIOD
            self._send(
                "heartbeat", self._mavlink.MAV_TYPE_ONBOARD_CONTROLLER, self._mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 0
            )

    def _check_connection(self) -> None:
        """Raise an `OffboardError` if the other side has closed a TCP connection, which pymavlink ignores."""
        port = self._connection.port
        if not isinstance(port, socket.socket) or port.type != socket.SOCK_STREAM:
            return
        with suppress(BlockingIOError, InterruptedError):
            try:
                is_closed = port.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT) == b""
            except BlockingIOError:
                raise
            except OSError:
                is_closed = True
            if is_closed:
                raise OffboardError(f"the connection to {self._address} was closed")

    def _process(self, message: Any, now: float) -> None:
        kind, system = message.get_type(), message.get_srcSystem()
        if message.get_srcComponent() != _AUTOPILOT_COMPONENT:
            return
        if kind == "HEARTBEAT" and message.autopilot != self._mavlink.MAV_AUTOPILOT_INVALID:
            self._heartbeats[system] = message
            if system == self._system:
                self._heartbeat_time = now
        if system != self._system:
            return
        if kind in _TELEMETRY:
            self._clock_difference = min(self._clock_difference, now - 1e-3 * message.time_boot_ms)
            if kind == "ATTITUDE":
                self._attitude = message
            else:
                self._position = message
        elif kind == "EXTENDED_SYS_STATE":
            self._landed_state = message.landed_state
        elif kind == "VFR_HUD":
            self._thrust = 0.01 * message.throttle
        elif kind == "PARAM_VALUE":
            self._parameters[message.param_id] = message.param_value
        elif kind == "COMMAND_ACK" and getattr(message, "target_system", 0) in (0, system):
            accepted = (self._mavlink.MAV_RESULT_ACCEPTED, self._mavlink.MAV_RESULT_IN_PROGRESS)
            if message.result not in accepted:
                self._refused_commands.add(message.command)
        elif kind == "STATUSTEXT" and message.severity <= self._mavlink.MAV_SEVERITY_WARNING:
            self._warnings = [*self.recent_warnings(), (now, message.text)]

    def recent_warnings(self) -> list[tuple[float, str]]:
        """Return the warnings that the autopilot has sent within the last 5 s, each with its time, s."""
        now = self.clock.now()
        return [(since, text) for since, text in self._warnings if now - since < _WARNING_TIME]

    def hover_thrust(self) -> float:
        """Return the thrust of the vehicle in hover, relative to the largest thrust.

        Raises:
            OffboardError: if the autopilot does not send the parameter, or would change the commanded thrust.
        """
        if self.stack is ARDUPILOT:
            if not int(self._parameter("GUID_OPTIONS")) & _THRUST_AS_THRUST:
                raise OffboardError(
                    "ArduPilot would interpret the commanded thrust as a climb rate; set bit 3 of its parameter"
                    " GUID_OPTIONS (add 8)"
                )
            if self._parameter("ATC_ANGLE_BOOST") != 0.0:
                raise OffboardError(
                    "ArduPilot would increase the commanded thrust of a tilted vehicle; set its parameter"
                    " ATC_ANGLE_BOOST to 0"
                )
        value = self._parameter(self.stack.hover_parameter)
        if not _MIN_HOVER_THRUST < value < _MAX_HOVER_THRUST:
            raise OffboardError(
                f"{self.stack.hover_parameter} is {value:g}, but must be between {_MIN_HOVER_THRUST:g} and"
                f" {_MAX_HOVER_THRUST:g}"
            )
        return value

    def _parameter(self, name: str) -> float:
        """Request the value of a parameter, and return it."""
        end = self.clock.now() + _PARAMETER_TIMEOUT
        while name not in self._parameters and self.clock.now() < end:
            self._send("param_request_read", self.system, _AUTOPILOT_COMPONENT, name.encode(), -1)
            self._wait(lambda: name in self._parameters, _REPEAT_PERIOD)
        if name not in self._parameters:
            raise OffboardError(f"{self.stack.name} did not send its parameter {name} within {_PARAMETER_TIMEOUT:g} s")
        return self._parameters[name]

    def set_mode(self, mode: str) -> None:
        """Command a flight mode, given the name that pymavlink gives it."""
        armed = self._heartbeat.base_mode & self._mavlink.MAV_MODE_FLAG_SAFETY_ARMED
        if self.stack is PX4:
            base, main, sub = self._utilities.px4_map[mode]
        else:
            modes = self._utilities.mode_mapping_byname(self._mavlink.MAV_TYPE_QUADROTOR)
            base, main, sub = self._mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, modes[mode], 0
        self._command(self._mavlink.MAV_CMD_DO_SET_MODE, base | armed, main, sub)

    @property
    def mode_was_refused(self) -> bool:
        """True if the vehicle has refused the last mode command."""
        return self._mavlink.MAV_CMD_DO_SET_MODE in self._refused_commands

    def send_position(self, reference: Reference) -> None:
        """Send a setpoint of position, velocity, acceleration, yaw and yaw rate.

        Raises:
            OffboardError: if a number of the setpoint is not finite.
        """
        self._send_setpoint(
            "set_position_target_local_ned", self._mavlink.MAV_FRAME_LOCAL_NED, 0, *position_fields(reference)
        )

    def send_attitude(self, target: AttitudeTarget, thrust: float) -> None:
        """Send a setpoint of the attitude, and of the thrust relative to the largest thrust.

        Raises:
            OffboardError: if a number of the setpoint is not finite.
        """
        self._send_setpoint("set_attitude_target", _IGNORE_RATES, attitude_fields(target), 0.0, 0.0, 0.0, thrust)

    def send_rates(self, rates: BodyRates, thrust: float) -> None:
        """Send a setpoint of the body rates, and of the thrust relative to the largest thrust.

        Raises:
            OffboardError: if a number of the setpoint is not finite.
        """
        self._send_setpoint("set_attitude_target", _IGNORE_ATTITUDE, (1.0, 0.0, 0.0, 0.0), *rate_fields(rates), thrust)

    def _send_setpoint(self, message: str, *fields: Any) -> None:
        numbers = [part for field in fields for part in (field if isinstance(field, tuple) else (field,))]
        if not all(map(math.isfinite, numbers)):
            raise OffboardError("a number of the setpoint is not finite")
        milliseconds = int(1e3 * (self.clock.now() - self._start)) & 0xFFFF_FFFF
        self._send(message, milliseconds, self.system, _AUTOPILOT_COMPONENT, *fields)

    def close(self) -> None:
        """Restore the default rates of the telemetry, and close the connection."""
        with suppress(OffboardError):
            for message in (*_TELEMETRY, *_STATUS_PERIODS):
                self._set_interval(message, 0.0)
        self._connection.close()

    def _command(self, command: int, *parameters: float) -> None:
        self._refused_commands.discard(command)
        values = [float(each) for each in (*parameters, *[0.0] * (7 - len(parameters)))]
        self._send("command_long", self.system, _AUTOPILOT_COMPONENT, command, 0, *values)

    def _send(self, message: str, *fields: Any) -> None:
        self._check_connection()
        with suppress(OSError):  # as for received messages, the age of the telemetry decides
            getattr(self._connection.mav, f"{message}_send")(*fields)

    def _wait(self, condition: Callable[[], bool], timeout: float) -> bool:
        """Receive messages until a condition is met, and return whether it was met within a time, s."""
        end = self.clock.now() + timeout
        while not condition():
            if self.clock.now() > end:
                return False
            self._receive()
            self.clock.sleep(_WAITING_STEP)
        return True
