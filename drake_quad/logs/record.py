"""Record of a flight: the signals of a log on one clock, in SI units and the frames of this library."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Annotated, Any, NamedTuple, get_type_hints

import numpy as np

from drake_quad.errors import InputError, short_repr
from drake_quad.signals import Quantity

Column = np.ndarray


class SignalOrigin(NamedTuple):
    """Description of how a signal was read from a log.

    Attributes:
        signal: name of the signal.
        columns: names of the columns, and their unit if it was converted.
        rate: rate at which the columns were logged, Hz.
        resampling: "interpolated" or "held" if the rate or the clock of the columns is not that of the record.
        missing_fraction: fraction of the logged samples that are NaN.
    """

    signal: str
    columns: str
    rate: float
    resampling: str
    missing_fraction: float


@dataclass(frozen=True, eq=False)
class FlightRecord:
    """Logged flight: signals on one clock; a signal that is not logged is None.

    Measurements contain noise, and commands hold until the next sample. World frame W: z up. Body frame B: x forward, y
    to the left, z up. Rotors are numbered as in an x layout of this library: rotor 1 is front right, and rotors 2 to 4
    follow clockwise as seen from above.

    Attributes:
        name: name of the log.
        time: (n,) increasing times, 0 at the first sample, s.
        position: (n, 3) position in W, m.
        velocity: (n, 3) velocity in W, m/s.
        attitude: (n, 3) roll, pitch, yaw, rad.
        body_rates: (n, 3) p, q, r about the axes of B, rad/s.
        specific_force: (n, 3) measurement of an accelerometer, along the axes of B, m/s².
        rotor_speed: (n, 4) measured rotor speeds, rad/s.
        motor_command: (n, 4) command of each motor as a fraction of the full command, 0 to 1.
        rotor_speed_command: (n, 4) commanded rotor speeds, rad/s.
        thrust_command: (n,) commanded thrust of all rotors, N.
        thrust_fraction: (n,) commanded thrust of all rotors as a fraction of full thrust or throttle, 0 to 1.
        hover_thrust_fraction: (n,) fraction of full thrust at which the vehicle hovers, as estimated by the controller.
        torque_command: (n, 3) commanded torque along the axes of B, N m.
        attitude_command: (n, 3) commanded roll, pitch, yaw, rad.
        body_rate_command: (n, 3) commanded p, q, r, rad/s.
        reference_position: (n, 3) position of the reference in W, m.
        reference_velocity: (n, 3) velocity of the reference in W, m/s.
        reference_acceleration: (n, 3) acceleration of the reference in W, m/s².
        reference_yaw: (n,) yaw of the reference, rad.
        wind: (n, 3) velocity of the air in W, m/s.
        residual_force: (n, 3) logged force other than thrust and weight, in W, N.
        battery_voltage: (n,) voltage of the battery, V.
        reference_period: period with which reference_position was logged, s; 0 if it is the period of the record. The
            values of reference_position are held for this period.
        vehicle: name of a similar shipped vehicle with which an identification can begin; None if there is none.
        remarks: remarks on gaps, jumps of the clock, conversions, and samples that were left out.
        origins: description of how each signal was read from the file.
    """

    name: str
    time: Annotated[Column, Quantity("s")]
    position: Annotated[Column | None, Quantity("m", "W")] = None
    velocity: Annotated[Column | None, Quantity("m/s", "W")] = None
    attitude: Annotated[Column | None, Quantity("rad")] = None
    body_rates: Annotated[Column | None, Quantity("rad/s", "B")] = None
    specific_force: Annotated[Column | None, Quantity("m/s²", "B")] = None
    rotor_speed: Annotated[Column | None, Quantity("rad/s"), 4] = None
    motor_command: Annotated[Column | None, Quantity("1"), 4] = None
    rotor_speed_command: Annotated[Column | None, Quantity("rad/s"), 4] = None
    thrust_command: Annotated[Column | None, Quantity("N", "B"), 1] = None
    thrust_fraction: Annotated[Column | None, Quantity("1"), 1] = None
    hover_thrust_fraction: Annotated[Column | None, Quantity("1"), 1] = None
    torque_command: Annotated[Column | None, Quantity("N m", "B")] = None
    attitude_command: Annotated[Column | None, Quantity("rad")] = None
    body_rate_command: Annotated[Column | None, Quantity("rad/s", "B")] = None
    reference_position: Annotated[Column | None, Quantity("m", "W")] = None
    reference_velocity: Annotated[Column | None, Quantity("m/s", "W")] = None
    reference_acceleration: Annotated[Column | None, Quantity("m/s²", "W")] = None
    reference_yaw: Annotated[Column | None, Quantity("rad"), 1] = None
    wind: Annotated[Column | None, Quantity("m/s", "W")] = None
    residual_force: Annotated[Column | None, Quantity("N", "W")] = None
    battery_voltage: Annotated[Column | None, Quantity("V"), 1] = None
    reference_period: float = 0.0
    vehicle: str | None = None
    remarks: tuple[str, ...] = ()
    origins: tuple[SignalOrigin, ...] = ()

    def __post_init__(self) -> None:
        """Check times, shapes and values.

        Raises:
            InputError: if the times do not increase, or a signal has a wrong shape or contains values that are not
                finite.
        """
        if self.time.ndim != 1 or len(self.time) < 2 or not np.all(np.diff(self.time) > 0.0):
            raise InputError(f"the log {short_repr(self.name)} must have at least two samples with increasing times")
        for name, values in self.signals():
            columns = COLUMNS[name]
            shape = (len(self.time), columns) if columns > 1 else (len(self.time),)
            if values.shape != shape:
                raise InputError(
                    f"{name} of the log {short_repr(self.name)} has shape {values.shape}, but must have {shape}"
                )
            if not np.isfinite(values).all():
                row = int(np.argmin(np.isfinite(values.reshape(len(values), -1)).all(axis=1)))
                raise InputError(
                    f"{name} of the log {short_repr(self.name)} is not a number at {self.time[row]:.6g} s, sample {row}"
                )

    def signals(self) -> Iterator[tuple[str, np.ndarray]]:
        """Yield the name and the values of each logged signal."""
        for name in COLUMNS:
            values = getattr(self, name)
            if values is not None:
                yield name, values

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the logged signals."""
        return tuple(name for name, _ in self.signals())

    @property
    def period(self) -> float:
        """Median time between two samples of the log, s."""
        return float(np.median(np.diff(self.time)))

    def of(self, name: str) -> np.ndarray:
        """Return the values of a signal.

        Raises:
            InputError: if the signal is not logged.
        """
        values: np.ndarray | None = getattr(self, name)
        if values is None:
            raise InputError(
                f"the log {short_repr(self.name)} lacks {name}; it has {', '.join(self.names) or 'no signals'}"
            )
        return values

    def subset(self, chosen: slice | np.ndarray) -> "FlightRecord":
        """Return a record of some of the samples, on the same clock.

        Args:
            chosen: slice of the samples, or (n,) mask.
        """
        signals: dict[str, Any] = {name: values[chosen] for name, values in self.signals()}
        return replace(self, time=self.time[chosen], **signals)

    def __repr__(self) -> str:
        """Return a summary of the log: duration, number and rate of the samples, and names of the signals."""
        return (
            f"<FlightRecord {self.name}: {self.time[-1] - self.time[0]:.1f} s, {len(self.time)} samples at"
            f" {1.0 / self.period:.0f} Hz; {', '.join(self.names)}>"
        )


_SIGNALS = {
    name: hint.__metadata__
    for name, hint in get_type_hints(FlightRecord, include_extras=True).items()
    if name != "time" and hasattr(hint, "__metadata__")
}
QUANTITIES: dict[str, Quantity] = {name: quantity for name, (quantity, *_) in _SIGNALS.items()}
"""Unit and frame of each signal."""
COLUMNS: dict[str, int] = {name: width[0] if width else 3 for name, (_, *width) in _SIGNALS.items()}
"""Number of columns of each signal: 3 unless its annotation states another number."""
