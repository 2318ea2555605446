"""Offboard flight: phases, checks at each tick, and the log.

1. The setpoint holds the present position, until the pilot switches to the mode that follows setpoints.
2. The vehicle turns to the first yaw of the route and comes to rest.
3. The vehicle follows the route, which is shifted so that it begins at the present position.
4. The vehicle is commanded to hold its position, to land or to return. Setpoints are sent until it has changed its
   mode.

If the vehicle leaves the limits, its messages are late or this computer is late, phase 4 follows at once. If the pilot
or a failsafe changes the mode, setpoints end at once.
"""

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple, TextIO, TypeVar

import numpy as np

from drake_quad.errors import InputError
from drake_quad.offboard.companion import Command, Companion
from drake_quad.offboard.limits import Fence, Limits, tilt_angle
from drake_quad.offboard.link import OffboardError, Telemetry, VehicleLink
from drake_quad.signals import AttitudeTarget, Reference, State, field_quantities

_Motion = TypeVar("_Motion", State, Reference)

_TELEMETRY_TIMEOUT = 5.0  # s until the first position
_RATE_WINDOW = 1.0  # s over which the rate of the telemetry is measured
_MIN_RATES = {"position": 4.0, "attitude": 20.0, "rates": 40.0}  # 1/s; smallest rate of telemetry
MAX_AGE = 0.5
"""Age of position or attitude, and delay of a tick, with which a flight ends, s."""
_ENGAGING_TIME = 1.0  # s for which setpoints are sent before the mode is commanded
_MODE_TIMEOUT = 5.0  # s until the commanded mode is active
_TURNING_TIMEOUT = 30.0  # s until the vehicle is at rest at the start of the route
_REST_TIME = 1.0  # s for which the vehicle must be at rest
_REST_YAW, _REST_SPEED, _REST_DISTANCE = 0.1, 0.3, 0.5  # rad, m/s, m
_MAX_START_SPEED = 0.3  # m/s; largest speed at the start of a route
_MIN_THRUST, _MAX_THRUST = 0.05, 0.95  # smallest and largest commanded thrust, relative to the largest thrust


class Outcome(NamedTuple):
    """Outcome of an offboard flight.

    Attributes:
        completed: True if the vehicle flew the whole route.
        reason: reason why the flight ended.
        num_ticks: number of ticks on the route.
        rmse: root-mean-square distance from the reference, m; NaN without a tick on the route.
        largest_error: largest distance from the reference, m; NaN without a tick on the route.
        largest_tilt: largest commanded tilt, rad; 0 if only the reference was sent.
        thrusts: smallest and largest commanded thrust, relative to the largest thrust; NaN without thrusts.
        num_limited: number of ticks in which the commanded tilt or thrust was limited.
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
    """End of a flight. The message is the reason; `command_end` is False if setpoints must end at once."""

    def __init__(self, reason: str, *, completed: bool = False, command_end: bool = True) -> None:
        super().__init__(reason)
        self.completed, self.command_end = completed, command_end


class OffboardFlight:
    """Flight of a real vehicle that follows the setpoints of a companion computer.

    Args:
        link: connection to the vehicle.
        companion: reference and controller.
        limits: limits on the motion.
        end_mode: key of `FlightStack.end_modes`: the mode after the flight.
        engages: True to command the mode that follows setpoints; False to wait for the pilot.
        dry_run: True to send neither setpoints nor modes. The route then begins at once, whatever the vehicle does.
        report: function that is called with a sentence for each phase of the flight.
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
        self._hover_thrust = 1.0
        self._errors: list[float] = []
        self._tilts: list[float] = []
        self._thrusts: list[float] = []
        self._num_limited = 0
        first = companion.reference_at(0.0)
        if math.hypot(first.v_x, first.v_y, first.v_z) > _MAX_START_SPEED:
            raise InputError(
                f"the route begins with a speed of {math.hypot(first.v_x, first.v_y, first.v_z):.2g} m/s, but the"
                " vehicle hovers before it begins; choose a route that begins at rest"
            )
        self._first = first

    def run(self, log: Path) -> Outcome:
        """Fly, and return the outcome.

        Args:
            log: CSV file for measurements, references and commands on the route. A row is written at each tick.

        Raises:
            InputError: if the route does not fit the limits at the present position.
            OffboardError: if the vehicle sends no telemetry, or sends it too slowly.
        """
        telemetry = self._wait_for_telemetry()
        if self._companion.setpoint != "position":
            self._hover_thrust = self._link.hover_thrust()
        self._check_route(telemetry)
        held = self._reference_at_rest(telemetry.state, telemetry.state.yaw)
        try:
            if not self._dry_run:
                held = self._wait_for_mode()
                held = self._turn(held)
            self._fly(held, log)
        except _FlightEndError as end:
            reason, completed = str(end), end.completed
            if end.command_end and not self._dry_run:
                reason = f"{reason}; {self._command_end()}"
        except OffboardError as error:
            reason, completed = str(error), False
        except KeyboardInterrupt:
            reason, completed = "interrupted", False
            if not self._dry_run:
                reason = f"{reason}; {self._command_end()}"
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

    def _wait_for_telemetry(self) -> Telemetry:
        """Request telemetry, and return it as soon as it arrives at a sufficient rate."""
        name, start = self._link.stack.name, self._clock.now()
        self._link.request_telemetry(self._companion.period)
        while (telemetry := self._link.telemetry()) is None:
            if self._clock.now() - start > _TELEMETRY_TIMEOUT:
                raise OffboardError(
                    f"{name} sent no position and attitude within {_TELEMETRY_TIMEOUT:g} s; it has no estimate of its"
                    " position, or its messages are not streamed to this connection"
                )
            self._clock.sleep(0.01)
        begin, times = self._clock.now(), {telemetry.time}
        while self._clock.now() - begin < _RATE_WINDOW:
            telemetry = self._link.telemetry() or telemetry
            times.add(telemetry.time)
            self._clock.sleep(0.002)
        rate, smallest = (len(times) - 1) / _RATE_WINDOW, _MIN_RATES[self._companion.setpoint]
        if rate < smallest:
            raise OffboardError(
                f"{name} sends position and attitude {rate:.0f} times per second, but {self._companion.setpoint}"
                f" setpoints need at least {smallest:g}; stream LOCAL_POSITION_NED and ATTITUDE faster"
            )
        self._report(f"{name} sends position and attitude {rate:.0f} times per second")
        return telemetry

    def _check_route(self, telemetry: Telemetry) -> None:
        """Check that the route lies inside the geofence if it begins at the present position."""
        positions = self._companion.positions() + self._shift(telemetry.state)
        if self._limits.fence is None:
            self._limits = self._limits._replace(fence=Fence.around(positions))
        assert self._limits.fence is not None
        self._limits.fence.check_route(positions)

    def _shift(self, start: State | Reference) -> np.ndarray:
        """Return the vector (3,) from the start of the route to the place where it begins."""
        return np.array(start[:3]) - np.array(self._first[:3])

    @staticmethod
    def _reference_at_rest(state: State, yaw: float) -> Reference:
        return Reference(state.x, state.y, state.z, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, yaw, 0.0)

    def _wait_for_mode(self) -> Reference:
        """Hold the present position until the vehicle follows setpoints, and return the setpoint."""
        stack, start = self._link.stack, self._clock.now()
        if self._engages:
            self._report(f"switching to {stack.offboard_mode}")
        else:
            self._report(f"switch to {stack.offboard_mode} when the vehicle hovers at the start; Ctrl-C ends")
        commanded = False
        for telemetry in self._ticks():
            held = self._reference_at_rest(telemetry.state, telemetry.state.yaw)
            self._link.send_position(held)
            elapsed = self._clock.now() - start
            if telemetry.mode == stack.offboard_mode:
                if not telemetry.is_armed or telemetry.is_on_ground:
                    raise _FlightEndError("the vehicle is not in the air; take off first")
                return held
            if self._engages and not commanded and elapsed > _ENGAGING_TIME:
                self._link.set_mode(stack.offboard_mode)
                commanded = True
            if commanded and (self._link.mode_was_refused or elapsed > _ENGAGING_TIME + _MODE_TIMEOUT):
                raise _FlightEndError(
                    f"{stack.name} did not switch to {stack.offboard_mode}{self._warnings()}", command_end=False
                )
        raise AssertionError("unreachable: the ticks do not end")

    def _turn(self, held: Reference) -> Reference:
        """Turn to the first yaw of the route, wait until the vehicle is at rest, and return the setpoint."""
        self._report("turning to the first yaw of the route")
        held = held._replace(yaw=self._first.yaw)
        start = rest_start = self._clock.now()
        for telemetry in self._ticks():
            state, now = telemetry.state, self._clock.now()
            self._check(telemetry, held)
            self._link.send_position(held)
            at_rest = (
                abs(math.remainder(state.yaw - held.yaw, 2.0 * math.pi)) < _REST_YAW
                and math.hypot(state.v_x, state.v_y, state.v_z) < _REST_SPEED
                and math.dist(state[:3], held[:3]) < _REST_DISTANCE
            )
            if not at_rest:
                rest_start = now
            elif now - rest_start > _REST_TIME:
                return held
            if now - start > _TURNING_TIMEOUT:
                raise _FlightEndError(f"the vehicle did not come to rest at the start within {_TURNING_TIMEOUT:g} s")
        raise AssertionError("unreachable: the ticks do not end")

    def _fly(self, held: Reference, log: Path) -> None:
        """Follow the route from the held position."""
        companion = self._companion
        shift = self._shift(held)
        self._report(f"following the route for {companion.duration:.1f} s")
        with log.open("w", encoding="utf-8") as file:
            self._write(file, ["time (s)", *_headings(companion)])
            for tick, telemetry in enumerate(self._ticks()):
                measured = _shifted(telemetry.state, -shift)
                command = companion.step(measured)
                reference = _shifted(command.reference, shift)
                self._errors.append(math.dist(telemetry.state[:3], reference[:3]))
                numbers = [*measured, *command.reference, *(command.target or ())]
                self._write(file, [repr(tick * companion.period), *(f"{number:.9g}" for number in numbers)])
                if not self._dry_run:
                    self._check(telemetry, reference)
                self._send(command, reference)
                if tick + 1 >= companion.num_ticks:
                    raise _FlightEndError("the route is complete", completed=True)

    def _send(self, command: Command, reference: Reference) -> None:
        """Limit the thrust of the command of a tick, and send it unless this is a dry run."""
        if command.target is None or command.rates is None:
            if not self._dry_run:
                self._link.send_position(reference)
            return
        thrust = self._hover_thrust * command.thrust
        if not all(map(math.isfinite, (*command.target, thrust))):
            raise _FlightEndError("the command of the controller is not finite")
        applied = min(max(thrust, _MIN_THRUST), _MAX_THRUST)
        self._num_limited += command.tilt_is_limited or applied != thrust
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
            raise _FlightEndError(f"the vehicle has switched to {telemetry.mode}{self._warnings()}", command_end=False)
        if not telemetry.is_armed:
            raise _FlightEndError("the vehicle was disarmed", command_end=False)
        reason = self._limits.violation(telemetry.state, reference)
        if reason:
            raise _FlightEndError(reason)

    def _ticks(self) -> Iterator[Telemetry]:
        """Yield the telemetry at each tick, and end the flight if the telemetry or a tick is late."""
        period, next_tick = self._companion.period, self._clock.now()
        while True:
            self._clock.sleep(next_tick - self._clock.now())
            now = self._clock.now()
            if now - next_tick > MAX_AGE:
                raise _FlightEndError(f"this computer was {now - next_tick:.1f} s late")
            telemetry = self._link.telemetry()
            assert telemetry is not None
            if now - telemetry.time > MAX_AGE:
                raise _FlightEndError(f"position or attitude are {now - telemetry.time:.1f} s old")
            yield telemetry
            next_tick += period

    def _command_end(self) -> str:
        """Command the mode after the flight, and return a description of what the vehicle does."""
        stack, start = self._link.stack, self._clock.now()
        mode = stack.end_modes[self._end_mode]
        held: Reference | None = None
        next_command = start
        while self._clock.now() - start < _MODE_TIMEOUT:
            try:
                telemetry = self._link.telemetry()
                if telemetry is not None and telemetry.mode != stack.offboard_mode:
                    return f"the vehicle is in mode {telemetry.mode}"
                if self._clock.now() >= next_command:
                    self._link.set_mode(mode)
                    next_command += _MODE_TIMEOUT / 5.0
                # Without setpoints, the vehicle would leave the mode by its failsafe before it obeys the command.
                if telemetry is not None and self._clock.now() - telemetry.time < MAX_AGE:
                    held = held or self._reference_at_rest(telemetry.state, telemetry.state.yaw)
                    self._link.send_position(held)
            except OffboardError as error:
                return str(error)
            self._clock.sleep(min(self._companion.period, 0.05))
        return f"the vehicle did not switch to {mode}{self._warnings()}"

    def _warnings(self) -> str:
        texts = self._link.warnings[-2:]
        return f" ({'; '.join(texts)})" if texts else ""

    @staticmethod
    def _write(file: TextIO, cells: list[str]) -> None:
        file.write(",".join(cells) + "\n")


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
