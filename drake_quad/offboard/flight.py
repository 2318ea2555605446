"""Offboard flight: phases, checks at each tick, and the log.

1. The setpoint holds the present position, until the pilot switches to the mode that follows setpoints.
2. The vehicle turns to the first yaw of the route and comes to rest.
3. The vehicle follows the route, which is shifted so that it begins at the present position.
4. The vehicle is commanded to hold its position, to land or to return. Setpoints hold the position until the vehicle
   reports another mode.

Phase 4 follows at once if the vehicle exceeds a limit, its telemetry is too old, a control tick is late, or an error
occurs. If the pilot or a failsafe changes the mode, setpoints end as soon as a heartbeat reports it.
"""

import math
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple, TextIO, TypeVar

import numpy as np

from drake_quad.errors import InputError
from drake_quad.offboard.companion import Command, Companion
from drake_quad.offboard.limits import Fence, Limits, tilt_angle
from drake_quad.offboard.link import OffboardError, Telemetry, VehicleLink
from drake_quad.signals import AttitudeTarget, Reference, State, field_quantities

_Motion = TypeVar("_Motion", State, Reference)

_TELEMETRY_TIMEOUT = 5.0  # s until the first position
_RATE_WINDOW = 1.0  # s over which the rate of the telemetry is measured
_REPEAT_PERIOD = 1.0  # s after which a request for telemetry is repeated
# Smallest rate of the telemetry and largest age of position and attitude, for each kind of setpoints. A loop around the
# attitude needs younger measurements than the autopilot's own loops.
_MIN_TELEMETRY_RATES = {"position": 4.0, "attitude": 20.0, "rates": 30.0}  # 1/s
_MAX_AGES = {"position": 0.5, "attitude": 0.2, "rates": 0.1}  # s
_MAX_MODE_AGE = 2.5  # s; heartbeats arrive at least once per second
_MAX_DELAY = 0.5  # s; largest delay of a tick
_MAX_PERIOD = 0.2  # s; PX4 leaves Offboard mode without two setpoints per second
_POSITION_PERIOD = 0.05  # s; shortest period of position setpoints
# Bytes of the setpoint, and of the two messages with position and attitude (MAVLink 2, with header and checksum).
_SETPOINT_SIZES = {"position": 65, "attitude": 51, "rates": 51}
_TELEMETRY_SIZE = 80
_MAX_LOAD = 0.6  # largest fraction of the rate of a serial port that setpoints and telemetry may use
_STREAM_TIME_BEFORE_MODE_COMMAND = 2.0  # s; PX4 requires more than one second of setpoints
_MODE_ATTEMPTS = 3  # number of mode commands, which are sent at intervals of `_MODE_PERIOD`
_MODE_PERIOD = 2.0  # s
_FRESH_MODE_TIMEOUT = 1.5  # s until a heartbeat arrives
_TURNING_TIMEOUT = 30.0  # s until the vehicle is at rest at the start of the route
# Largest difference between the thrust in hover and its parameter, relative to the parameter. We chose 15 %, which is a
# disturbance of 1.5 m/s², as a wind of moderate strength causes. The telemetry rounds the thrust to 1 % of the largest.
_MAX_HOVER_ERROR, _THRUST_RESOLUTION = 0.15, 0.01
_REST_TIME = 1.0  # s for which the vehicle must be at rest
_REST_YAW = 0.1  # rad
_REST_SPEED = 0.3  # m/s
_REST_DISTANCE = 0.5  # m
_MAX_DRIFT = 0.3  # m; distance from the held position at which a new one is held, while the pilot flies
_MIN_THRUST = 0.05  # relative to the largest thrust
_MAX_THRUST = 0.95  # relative to the largest thrust


class Outcome(NamedTuple):
    """Outcome of an offboard flight.

    Attributes:
        completed: True if the vehicle flew the whole route, and then changed to the commanded mode.
        reason: reason why the flight ended.
        num_ticks: number of ticks on the route.
        rmse: root-mean-square distance from the reference, m; NaN without a tick on the route.
        largest_error: largest distance from the reference, m; NaN without a tick on the route.
        largest_tilt: largest commanded tilt, rad; 0 if only the reference was sent.
        thrusts: smallest and largest commanded thrust, relative to the largest thrust; NaN without thrusts.
        num_limited: number of ticks in which the commanded tilt, body rates or thrust were reduced to a limit.
    """

    completed: bool
    reason: str
    num_ticks: int
    rmse: float
    largest_error: float
    largest_tilt: float
    thrusts: tuple[float, float]
    num_limited: int


class _FlightEndError(Exception):
    """End of a flight, with the reason as its message.

    Args:
        reason: reason why the flight ends.
        completed: True if the vehicle has flown the whole route.
        command_end: False if the vehicle no longer follows setpoints, so that no mode is commanded.
    """

    def __init__(self, reason: str, *, completed: bool = False, command_end: bool = True) -> None:
        super().__init__(reason)
        self.completed, self.command_end = completed, command_end


class OffboardFlight:
    """Flight of a real vehicle that follows the setpoints of a companion computer.

    Args:
        link: connection to the vehicle.
        companion: reference and controller.
        limits: limits on the motion.
        end_mode: key of `FlightStack.end_modes`, the mode after the flight. If the vehicle refuses it,
            it is commanded to land.
        engages: True to command the mode that follows setpoints; False to wait for the pilot.
        dry_run: True to send no setpoints and no mode commands. The route then begins at once, even if the vehicle is
            on the ground or disarmed.
        report: function that is called with a sentence for each phase of the flight.

    Raises:
        InputError: if the period is too long for an autopilot, or a serial port is too slow.
    """

    def __init__(
        self,
        link: VehicleLink,
        companion: Companion,
        *,
        limits: Limits = Limits(),
        end_mode: str = "hold",
        engages: bool = False,
        dry_run: bool = False,
        report: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._link, self._companion, self._limits = link, companion, limits
        self._end_mode, self._engages, self._dry_run = end_mode, engages, dry_run
        self._report, self._clock = report, link.clock
        self._fence = limits.fence
        self._hover_thrust = 1.0
        self._errors: list[float] = []
        self._tilts: list[float] = []
        self._thrusts: list[float] = []
        self._num_limited = 0
        self._first = companion.reference_at(0.0)
        self._last_state: State | None = None
        kind, period = companion.setpoint, companion.period
        if period > _MAX_PERIOD:
            raise InputError(f"the period of the command link is {period:g} s, but must be at most {_MAX_PERIOD:g} s")
        is_position = kind == "position"
        self._ticks_per_setpoint = max(1, round(_POSITION_PERIOD / period)) if is_position else 1
        setpoint_period = self._ticks_per_setpoint * period
        self._telemetry_period = min(
            max(period, _POSITION_PERIOD if is_position else 0.0), 0.5 / _MIN_TELEMETRY_RATES[kind]
        )
        load = _SETPOINT_SIZES[kind] / setpoint_period + _TELEMETRY_SIZE / self._telemetry_period
        if load > _MAX_LOAD * link.max_byte_rate:
            raise InputError(
                f"{kind} setpoints and telemetry need {load:.0f} bytes per second, but the serial port transmits only"
                f" {link.max_byte_rate:.0f}; use a network, or a faster port"
            )

    def run(self, log: Path) -> Outcome:
        """Fly, and return the outcome.

        Args:
            log: CSV file for measurements, references and commands on the route. A row is written at each tick.

        Raises:
            InputError: if the route, started at the present position, leaves the geofence.
            OffboardError: if the vehicle sends no telemetry, or sends it too slowly.
        """
        companion = self._companion
        companion.warm_up()
        telemetry = self._wait_for_telemetry()
        if companion.setpoint != "position":
            self._hover_thrust = self._link.hover_thrust()
        if self._dry_run or self._limits.fence is not None:
            self._check_fence(telemetry.state)
        with _interruptions():
            reason, completed = self._fly_phases(telemetry, log)
        errors = np.array(self._errors)
        return Outcome(
            completed,
            reason,
            len(errors),
            float(np.sqrt(np.mean(errors**2))) if len(errors) else math.nan,
            max(self._errors, default=math.nan),
            max(self._tilts, default=0.0),
            (min(self._thrusts, default=math.nan), max(self._thrusts, default=math.nan)),
            self._num_limited,
        )

    def _fly_phases(self, telemetry: Telemetry, log: Path) -> tuple[str, bool]:
        """Fly all phases. Return the reason why the flight ended, and whether it was completed."""
        completed, command_end = False, True
        try:
            held = _at_rest(telemetry.state, telemetry.state.yaw)
            if not self._dry_run:
                held = self._turn(self._wait_for_mode())
            self._follow_route(held, log)
        except _FlightEndError as end:
            reason, completed, command_end = str(end), end.completed, end.command_end
        except KeyboardInterrupt:
            reason = "interrupted"
        except Exception as error:  # whatever fails, the vehicle must not stay without setpoints
            reason = str(error) if isinstance(error, OffboardError | InputError) else f"{type(error).__name__}: {error}"
        else:
            raise AssertionError("unreachable: the last phase ends with an error")
        if command_end and not self._dry_run:
            ending, changed = self._command_end()
            reason, completed = f"{reason}; {ending}", completed and changed
        return reason, completed

    def _say(self, text: str) -> None:
        """Report a phase. A closed pipe must not end the flight."""
        with suppress(OSError):
            self._report(text)

    def _wait_for_telemetry(self) -> Telemetry:
        """Request telemetry, and return it as soon as it arrives at a sufficient rate."""
        name, start = self._link.stack.name, self._clock.now()
        next_request = start
        while (telemetry := self._link.telemetry()) is None:
            if self._clock.now() >= next_request:
                self._link.request_telemetry(self._telemetry_period)
                next_request += _REPEAT_PERIOD
            if self._clock.now() - start > _TELEMETRY_TIMEOUT:
                raise OffboardError(
                    f"{name} sent no position and attitude within {_TELEMETRY_TIMEOUT:g} s; it has no estimate of its"
                    " position, or its messages are not streamed to this connection"
                )
            self._clock.sleep(0.01)
        kind = self._companion.setpoint
        for _ in range(3):
            self._link.request_telemetry(self._telemetry_period)
            begin, times = self._clock.now(), set()
            while self._clock.now() - begin < _RATE_WINDOW:
                telemetry = self._link.telemetry() or telemetry
                times.add(telemetry.time)
                self._clock.sleep(0.002)
            rate = (len(times) - 1) / (self._clock.now() - begin)
            if rate >= _MIN_TELEMETRY_RATES[kind]:
                break
        else:
            raise OffboardError(
                f"{name} sends position and attitude {rate:.0f} times per second, but {kind} setpoints need at least"
                f" {_MIN_TELEMETRY_RATES[kind]:g}; stream LOCAL_POSITION_NED and ATTITUDE faster"
            )
        self._say(f"system {self._link.system}, {name}: position and attitude {rate:.0f} times per second")
        self._last_state = telemetry.state
        return telemetry

    def _check_fence(self, start: State | Reference) -> None:
        """Check that the route lies inside the geofence if it begins at a position. Choose the default geofence."""
        positions = self._companion.route()[:, :3] + self._shift(start)
        self._fence = self._limits.fence or Fence.around(positions)
        self._fence.check_route(positions)

    def _shift(self, start: State | Reference) -> np.ndarray:
        """Return the displacement (3,) from the first point of the route to `start`, m."""
        return np.array(start[:3]) - np.array(self._first[:3])

    def _wait_for_mode(self) -> Reference:
        """Hold the present position until the vehicle follows setpoints, and return the setpoint."""
        stack, start = self._link.stack, self._clock.now()
        if self._engages:
            self._say(f"switching to {stack.offboard_mode}")
        else:
            self._say(
                f"waiting: let the vehicle hover where the route begins, then switch to {stack.offboard_mode} (Ctrl-C"
                " cancels)"
            )
        held: Reference | None = None
        num_commands, next_command = 0, start + _STREAM_TIME_BEFORE_MODE_COMMAND
        was_in_other_mode = False
        for tick, telemetry in enumerate(self._ticks()):
            if held is None or _distance(telemetry.state, held) > _MAX_DRIFT:
                held = _at_rest(telemetry.state, telemetry.state.yaw)
            self._send_held(tick, held)
            if telemetry.mode == stack.offboard_mode:
                if not self._engages and not was_in_other_mode:
                    raise _FlightEndError(
                        f"the vehicle is already in {stack.offboard_mode}; switch to another mode, and start again",
                        command_end=False,
                    )
                if not (telemetry.is_armed and telemetry.is_in_air):
                    raise _FlightEndError(
                        "the autopilot does not report that the vehicle is in the air; take off first"
                    )
                return held
            was_in_other_mode = True
            if not self._engages or self._clock.now() < next_command:
                continue
            if num_commands == _MODE_ATTEMPTS:
                raise _FlightEndError(f"{stack.name} did not switch to {stack.offboard_mode}{self._warnings()}")
            self._link.set_mode(stack.offboard_mode)
            num_commands, next_command = num_commands + 1, next_command + _MODE_PERIOD
        raise AssertionError("unreachable: the ticks do not end")

    def _turn(self, held: Reference) -> Reference:
        """Turn to the first yaw of the route, wait until the vehicle is at rest, and return the setpoint."""
        self._check_fence(held)
        self._say("turning to the first yaw of the route")
        held = held._replace(yaw=self._first.yaw)
        start = rest_start = self._clock.now()
        thrusts: list[float | None] = []
        for tick, telemetry in enumerate(self._ticks()):
            state, now = telemetry.state, self._clock.now()
            self._check(telemetry, held)
            self._send_held(tick, held)
            at_rest = (
                abs(math.remainder(state.yaw - held.yaw, 2.0 * math.pi)) < _REST_YAW
                and math.hypot(state.v_x, state.v_y, state.v_z) < _REST_SPEED
                and _distance(state, held) < _REST_DISTANCE
            )
            if not at_rest:
                rest_start, thrusts = now, []
            else:
                thrusts.append(telemetry.thrust)
                if now - rest_start > _REST_TIME:
                    self._check_hover_thrust(thrusts)
                    return held
            if now - start > _TURNING_TIMEOUT:
                raise _FlightEndError(f"the vehicle did not come to rest at the start within {_TURNING_TIMEOUT:g} s")
        raise AssertionError("unreachable: the ticks do not end")

    def _check_hover_thrust(self, thrusts: Sequence[float | None]) -> None:
        """End the flight if the thrusts of a vehicle at rest contradict the parameter with the thrust in hover."""
        if self._companion.setpoint == "position":
            return
        name, known = self._link.stack.hover_parameter, [each for each in thrusts if each is not None]
        if not known:
            raise _FlightEndError(f"the autopilot does not send its thrust (VFR_HUD), so {name} cannot be checked")
        flown = sum(known) / len(known)
        if abs(flown - self._hover_thrust) > _MAX_HOVER_ERROR * self._hover_thrust + _THRUST_RESOLUTION:
            raise _FlightEndError(
                f"the vehicle hovers with {flown:.0%} of the largest thrust, but {name} is {self._hover_thrust:.2g};"
                f" set {name} to {flown:.2f}"
            )

    def _follow_route(self, held: Reference, log: Path) -> None:
        """Follow the route from the held position."""
        companion, shift = self._companion, self._shift(held)
        self._say(f"following the route for {companion.duration:.1f} s")
        with log.open("w", encoding="utf-8") as file:
            self._write(file, ["time (s)", *_headings(companion)])
            for tick, telemetry in enumerate(self._ticks()):
                measured = _shifted(telemetry.state, -shift)
                command = companion.command(measured)
                reference = _shifted(command.reference, shift)
                if not self._dry_run:
                    self._check(telemetry, reference)
                self._send(tick, command, reference)
                self._errors.append(_distance(telemetry.state, reference))
                numbers = [*measured, *command.reference, *(command.target or ())]
                self._write(file, [repr(tick * companion.period), *(f"{number:.9g}" for number in numbers)])
                if tick + 1 >= companion.num_ticks:
                    raise _FlightEndError("the route is complete", completed=True)
                companion.advance()

    def _send_held(self, tick: int, held: Reference) -> None:
        if tick % self._ticks_per_setpoint == 0:
            self._link.send_position(held)

    def _send(self, tick: int, command: Command, reference: Reference) -> None:
        """Limit the thrust of the command of a tick, and send it unless this is a dry run."""
        if command.target is None or command.rates is None:
            if not self._dry_run:
                self._send_held(tick, reference)
            return
        thrust = self._hover_thrust * command.thrust
        if not all(map(math.isfinite, (*command.target, *command.rates, thrust))):
            raise _FlightEndError("the command of the controller is not finite")
        applied = min(max(thrust, _MIN_THRUST), _MAX_THRUST)
        self._num_limited += command.is_limited or applied != thrust
        self._tilts.append(tilt_angle(command.target.roll, command.target.pitch))
        self._thrusts.append(applied)
        if self._dry_run:
            return
        if self._companion.setpoint == "attitude":
            self._link.send_attitude(command.target, applied)
        else:
            self._link.send_rates(command.rates, applied)

    def _check(self, telemetry: Telemetry, reference: Reference) -> None:
        """End the flight if the pilot has taken over, or the vehicle exceeds a limit."""
        if telemetry.mode != self._link.stack.offboard_mode:
            raise _FlightEndError(f"the vehicle changed to {telemetry.mode}{self._warnings()}", command_end=False)
        if not telemetry.is_armed:
            raise _FlightEndError("the vehicle was disarmed", command_end=False)
        reason = self._limits._replace(fence=self._fence).violation(telemetry.state, reference)
        if reason:
            raise _FlightEndError(reason)

    def _ticks(self) -> Iterator[Telemetry]:
        """Yield the telemetry at each tick, and end the flight if the telemetry or a tick is late."""
        period, next_tick = self._companion.period, self._clock.now()
        while True:
            self._clock.sleep(next_tick - self._clock.now())
            now = self._clock.now()
            if now - next_tick > _MAX_DELAY:
                raise _FlightEndError(
                    f"a control tick was {now - next_tick:.1f} s late; this computer is too slow or busy"
                )
            telemetry = self._link.telemetry()
            assert telemetry is not None
            age, mode_age = now - telemetry.time, now - telemetry.mode_time
            if age > _MAX_AGES[self._companion.setpoint]:
                raise _FlightEndError(f"the latest position or attitude is {age:.2f} s old")
            if mode_age > _MAX_MODE_AGE:
                raise _FlightEndError(f"the latest heartbeat is {mode_age:.1f} s old")
            if not all(map(math.isfinite, telemetry.state)):
                raise _FlightEndError("the measured state is not finite")
            self._last_state = telemetry.state
            yield telemetry
            # Missed ticks are omitted, so that setpoints are not sent in a burst.
            next_tick = max(next_tick + period, self._clock.now())

    def _command_end(self) -> tuple[str, bool]:
        """Command the mode after the flight. Return a description of the result, and whether the vehicle obeyed."""
        try:
            with _ignored_interruptions():
                ending = self._change_mode()
            if ending is None:
                self._say("the vehicle does not change its mode; switch it by hand (setpoints hold the position)")
                while self._hold_and_read() == self._link.stack.offboard_mode:
                    if self._mode_age() > _MAX_MODE_AGE:
                        return "no heartbeat confirms that the vehicle has changed its mode", False
                    self._clock.sleep(_POSITION_PERIOD)
                return "the mode was changed by hand", False
        except OffboardError as error:
            return f"{error}, so no mode was commanded", False
        except KeyboardInterrupt:
            return "the vehicle did not change its mode", False
        return ending

    def _change_mode(self) -> tuple[str, bool] | None:
        """Command modes until the vehicle obeys, as `_command_end`. Return None if it refuses to change its mode."""
        stack = self._link.stack
        # The pilot may have changed the mode after the last heartbeat. A mode command would then take the vehicle from
        # the pilot, so the mode must be known first.
        self._link.request_mode()
        start = self._clock.now()
        deadline = start + _FRESH_MODE_TIMEOUT
        while self._mode_age() > self._clock.now() - start and self._clock.now() < deadline:
            self._hold_and_read()
            self._clock.sleep(0.02)
        mode = self._hold_and_read()
        if mode != stack.offboard_mode:
            return f"the vehicle changed to {mode}", False
        modes = dict.fromkeys((stack.end_modes[self._end_mode], stack.end_modes["land"]))
        for commanded in modes:
            for _ in range(_MODE_ATTEMPTS):
                self._link.set_mode(commanded)
                deadline = self._clock.now() + _MODE_PERIOD / _MODE_ATTEMPTS
                while self._clock.now() < deadline and not self._link.mode_was_refused:
                    mode = self._hold_and_read()
                    if mode != stack.offboard_mode:
                        return f"the vehicle changed to {mode}", mode == stack.end_modes[self._end_mode]
                    self._clock.sleep(0.02)
        return None

    def _mode_age(self) -> float:
        telemetry = self._link.telemetry()
        return math.inf if telemetry is None else self._clock.now() - telemetry.mode_time

    def _hold_and_read(self) -> str:
        """Send a setpoint that holds the last known position, and return the latest mode.

        Without setpoints, PX4's failsafe could act before the mode command, and ArduPilot would keep the last attitude
        or body rates for seconds.
        """
        if self._last_state is not None:
            self._link.send_position(_at_rest(self._last_state, self._last_state.yaw))
        telemetry = self._link.telemetry()
        assert telemetry is not None
        return telemetry.mode

    def _warnings(self) -> str:
        texts = [text for _, text in self._link.recent_warnings()][-2:]
        return f" ({'; '.join(texts)})" if texts else ""

    @staticmethod
    def _write(file: TextIO, cells: list[str]) -> None:
        file.write(",".join(cells) + "\n")


def _distance(state: State, reference: Reference) -> float:
    """Return the distance of a vehicle from its reference, m."""
    return math.dist((state.x, state.y, state.z), (reference.x, reference.y, reference.z))


def _at_rest(state: State, yaw: float) -> Reference:
    """Return a reference that rests at the position of a state."""
    return Reference(state.x, state.y, state.z, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, yaw, 0.0)


def _shifted(value: _Motion, shift: np.ndarray) -> _Motion:
    """Return a state or a reference with its position shifted by a vector (3,)."""
    x, y, z = (np.array(value[:3]) + shift).tolist()
    return value._replace(x=x, y=y, z=z)


def _headings(companion: Companion) -> list[str]:
    """Return the headings of the log after the time, as in the tables of simulated flights."""
    signals: dict[str, type] = {"measurement": State, "reference": Reference}
    if companion.setpoint != "position":
        signals["attitude_target"] = AttitudeTarget
    return [
        f"{signal}.{row} ({quantity.unit})"
        for signal, kind in signals.items()
        for row, quantity in field_quantities(kind).items()
    ]


@contextmanager
def _handlers(signals: tuple[signal.Signals, ...], handler: Any) -> Iterator[None]:
    """Handle signals inside a `with` statement. Only the main thread can do so."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {each: signal.signal(each, handler) for each in signals}
    try:
        yield
    finally:
        for each, previous in before.items():
            signal.signal(each, previous)


def _interruptions() -> Any:
    """Return a context in which the end of a terminal or session interrupts the flight, as Ctrl-C does."""

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    return _handlers((signal.SIGTERM, signal.SIGHUP), interrupt)


def _ignored_interruptions() -> Any:
    """Return a context in which interruptions are ignored, so that the vehicle is commanded to end the flight."""
    return _handlers((signal.SIGINT, signal.SIGTERM, signal.SIGHUP), signal.SIG_IGN)
