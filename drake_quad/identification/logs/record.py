"""What a flight log says, whoever wrote it: SI, the frames of this library, one clock."""

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import Annotated, Any

import numpy as np

from drake_quad.errors import InputError, shown
from drake_quad.signals import Quantity

Column = np.ndarray


@dataclass(frozen=True, eq=False)
class FlightRecord:
    """A logged flight: signals over one clock; None for what is not logged.

    Measurements are those of the log, with its noise; commands hold until the next sample. World frame W: z up. Body
    frame B: x forward, y to the left, z up. Rotors are numbered as in an x layout of this library: the first in front
    to the right, then clockwise seen from above.

    Attributes:
        name: of the log.
        time: (n,) rises, s; 0 at the first sample.
        position: (n, 3) of the vehicle in W, m.
        velocity: (n, 3) in W, m/s.
        attitude: (n, 3) roll, pitch, yaw, rad.
        body_rates: (n, 3) p, q, r about the axes of B, rad/s.
        specific_force: (n, 3) what an accelerometer measures, along the axes of B, m/s².
        rotor_speed: (n, 4) measured, rad/s.
        motor_command: (n, 4) share of the full command of each motor, 0 to 1.
        rotor_speed_command: (n, 4) rad/s.
        thrust_command: (n,) of all rotors, N.
        thrust_share: (n,) of all rotors, share of full thrust or throttle, as the controller sent it, 0 to 1.
        hover_share: (n,) share of full thrust with which the controller takes the vehicle to hover, 0 to 1.
        torque_command: (n, 3) along the axes of B, N m.
        attitude_command: (n, 3) roll, pitch, yaw, rad.
        body_rate_command: (n, 3) rad/s.
        reference_position: (n, 3) in W, m.
        reference_velocity: (n, 3) in W, m/s.
        reference_acceleration: (n, 3) in W, m/s².
        reference_yaw: (n,) rad.
        wind: (n, 3) velocity of the air in W, m/s.
        residual_force: (n, 3) force beside thrust and weight as the log has it, in W, N.
        battery_voltage: (n,) V.
        vehicle: name of a shipped vehicle that is near, to begin an identification with; None if
            such logs are of any vehicle.
        remarks: sentences on what was found and done: gaps, jumps of the clock, conversions, samples left out.
    """

    name: str
    time: Annotated[Column, Quantity("s")]
    position: Annotated[Column | None, Quantity("m", "W")] = None
    velocity: Annotated[Column | None, Quantity("m/s", "W")] = None
    attitude: Annotated[Column | None, Quantity("rad")] = None
    body_rates: Annotated[Column | None, Quantity("rad/s", "B")] = None
    specific_force: Annotated[Column | None, Quantity("m/s²", "B")] = None
    rotor_speed: Annotated[Column | None, Quantity("rad/s")] = None
    motor_command: Annotated[Column | None, Quantity("1")] = None
    rotor_speed_command: Annotated[Column | None, Quantity("rad/s")] = None
    thrust_command: Annotated[Column | None, Quantity("N", "B")] = None
    thrust_share: Annotated[Column | None, Quantity("1")] = None
    hover_share: Annotated[Column | None, Quantity("1")] = None
    torque_command: Annotated[Column | None, Quantity("N m", "B")] = None
    attitude_command: Annotated[Column | None, Quantity("rad")] = None
    body_rate_command: Annotated[Column | None, Quantity("rad/s", "B")] = None
    reference_position: Annotated[Column | None, Quantity("m", "W")] = None
    reference_velocity: Annotated[Column | None, Quantity("m/s", "W")] = None
    reference_acceleration: Annotated[Column | None, Quantity("m/s²", "W")] = None
    reference_yaw: Annotated[Column | None, Quantity("rad")] = None
    wind: Annotated[Column | None, Quantity("m/s", "W")] = None
    residual_force: Annotated[Column | None, Quantity("N", "W")] = None
    battery_voltage: Annotated[Column | None, Quantity("V")] = None
    vehicle: str | None = None
    remarks: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Refuses what is no record.

        Raises:
            InputError: time does not rise, or a signal has not its shape or holds what is no number.
        """
        if self.time.ndim != 1 or len(self.time) < 2 or not np.all(np.diff(self.time) > 0.0):
            raise InputError(f"the log {shown(self.name)} must have at least two samples whose time rises")
        for name, values in self.signals():
            columns = COLUMNS[name]
            shape = (len(self.time), columns) if columns > 1 else (len(self.time),)
            if values.shape != shape:
                raise InputError(
                    f"{name} of the log {shown(self.name)} has shape {values.shape}, and must have {shape}"
                )
            if not np.isfinite(values).all():
                row = int(np.argmin(np.isfinite(values.reshape(len(values), -1)).all(axis=1)))
                raise InputError(
                    f"{name} of the log {shown(self.name)} is no number at {self.time[row]:.6g} s, sample {row}"
                )

    def signals(self) -> Iterator[tuple[str, np.ndarray]]:
        """Name and values of each signal that is logged."""
        for name in COLUMNS:
            values = getattr(self, name)
            if values is not None:
                yield name, values

    @property
    def names(self) -> tuple[str, ...]:
        """Of the signals that are logged."""
        return tuple(name for name, _ in self.signals())

    @property
    def period(self) -> float:
        """Median time between samples, s."""
        return float(np.median(np.diff(self.time)))

    def of(self, name: str) -> np.ndarray:
        """The values of a signal that is needed.

        Raises:
            InputError: it is not logged.
        """
        values: np.ndarray | None = getattr(self, name)
        if values is None:
            raise InputError(f"the log {shown(self.name)} lacks {name}; it has {', '.join(self.names) or 'nothing'}")
        return values

    def part(self, chosen: slice | np.ndarray) -> "FlightRecord":
        """Some of the samples, in order; the clock goes on as it was.

        Args:
            chosen: a slice of the samples, or (n,) True for those that stay.
        """
        signals: dict[str, Any] = {name: values[chosen] for name, values in self.signals()}
        return replace(self, time=self.time[chosen], **signals)

    def __repr__(self) -> str:
        """A line of text."""
        return (
            f"<FlightRecord {self.name}: {self.time[-1] - self.time[0]:.1f} s, {len(self.time)} samples at"
            f" {1.0 / self.period:.0f} Hz; {', '.join(self.names)}>"
        )


_WIDTHS = {
    "rotor_speed": 4,
    "motor_command": 4,
    "rotor_speed_command": 4,
    "thrust_command": 1,
    "thrust_share": 1,
    "hover_share": 1,
    "reference_yaw": 1,
    "battery_voltage": 1,
}

# Name of each signal and how many columns it has.
COLUMNS = {
    each.name: _WIDTHS.get(each.name, 3)
    for each in fields(FlightRecord)
    if each.name not in ("name", "time", "vehicle", "remarks")
}
