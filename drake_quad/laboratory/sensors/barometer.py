"""Barometer: height from the pressure of the air.

    reading = h + b + d - κ V² / 2g - D exp(-h / L) + σ n

with the height h of the sensor, a bias b, a stationary Gauss-Markov process d, and standard normal n. The pressure at
the port of the sensor differs from the static pressure by κ ρ V² / 2, where V is the speed of the air relative to the
vehicle, which changes the reading by -κ V² / 2g. Close to the ground, the air below the rotors has a higher pressure,
so the reading is too low: by D at the ground, and by less above it. The rotors are assumed to turn as in hover.
"""

from typing import Annotated, NamedTuple

from drake_quad.framework.elementary import exp
from drake_quad.laboratory.sensors.gauss_markov import Correlation
from drake_quad.laboratory.sensors.mounting import SensorPosition, axes_of, place
from drake_quad.laboratory.sensors.sensor import SensorLaw, SensorMemory
from drake_quad.signals import Number, PositionW, Quantity, Row, State, Wind

_Length = Annotated[Row, Quantity("m")]


class PressureHeight(NamedTuple):
    """Height above the origin of W, from the pressure."""

    height: PositionW


class HeightDrift(NamedTuple):
    """Slowly varying error of the measured height, a Gauss-Markov process.

    Attributes:
        deviation: standard deviation.
        correlation: correlation between successive readings.
    """

    deviation: _Length
    correlation: Correlation


class GroundPressure(NamedTuple):
    """Error of the measured height close to the ground.

    Attributes:
        depth: amount D by which the reading is too low at the ground.
        length: height L over which the error decays by the factor e.
    """

    depth: _Length
    length: _Length


class BarometerErrors(NamedTuple):
    """Errors that can be switched off; None for an error that is switched off.

    Attributes:
        drift: slowly varying error of the measured height.
        dynamic_pressure: coefficient κ / 2g of the squared airspeed, s²/m.
        ground_effect: error close to the ground.
    """

    drift: HeightDrift | None = None
    dynamic_pressure: Row | None = None
    ground_effect: GroundPressure | None = None


class BarometerParameters(NamedTuple):
    """Position and errors of a barometer.

    Attributes:
        position: position of the sensor.
        bias: constant error of the readings.
        height_noise: standard deviation of the noise of a reading.
        latency_samples: latency, a whole number of periods.
        errors: errors that can be switched off.
    """

    position: SensorPosition = SensorPosition()
    bias: _Length = 0.0
    height_noise: Annotated[Row, Quantity("m", sign="nonnegative")] = 0.0
    latency_samples: Number = 0.0
    errors: BarometerErrors = BarometerErrors()


class BarometerNoise(NamedTuple):
    """Standard normal samples for the white noise and for the drift."""

    white: Number
    drift: Number | None


class BarometerMemory(NamedTuple):
    """Slowly varying error of the measured height at a reading; None if it is switched off."""

    drift: _Length | None


def barometer_noise(parameters: BarometerParameters) -> BarometerNoise:
    """Return a noise record of zeros for a reading; the fields of errors that are switched off are None."""
    return BarometerNoise(0.0, None if parameters.errors.drift is None else 0.0)


def first_barometer_memory(
    parameters: BarometerParameters, noise: BarometerNoise | None, state: State, wind: Wind | None
) -> BarometerMemory:
    """Return the slowly varying errors at the first reading, drawn from their stationary distribution."""
    drift = parameters.errors.drift
    if drift is None or noise is None or noise.drift is None:
        return BarometerMemory(None)
    return BarometerMemory(drift.deviation * noise.drift)


def next_barometer_memory(
    parameters: BarometerParameters,
    noise: BarometerNoise | None,
    memory: BarometerMemory,
    state: State,
    wind: Wind | None,
) -> BarometerMemory:
    """Return the slowly varying errors at the next reading; `memory` contains the errors at the previous reading."""
    drift = parameters.errors.drift
    if drift is None or noise is None or noise.drift is None or memory.drift is None:
        return memory
    return BarometerMemory(drift.correlation.step(memory.drift, drift.deviation, noise.drift))


def barometer_reading(
    parameters: BarometerParameters,
    noise: BarometerNoise | None,
    memory: BarometerMemory,
    state: State,
    wind: Wind | None,
) -> PressureHeight:
    """Return a reading of a barometer, with noise unless `noise` is None."""
    errors = parameters.errors
    true = place(state, axes_of(state), parameters.position).z
    height = true + parameters.bias
    if memory.drift is not None:
        height = height + memory.drift
    if errors.dynamic_pressure is not None and wind is not None:
        x, y, z = state.v_x - wind.x, state.v_y - wind.y, state.v_z - wind.z
        height = height - errors.dynamic_pressure * (x * x + y * y + z * z)
    if errors.ground_effect is not None:
        height = height - errors.ground_effect.depth * exp(-true / errors.ground_effect.length)
    if noise is not None:
        height = height + parameters.height_noise * noise.white
    return PressureHeight(height)


BAROMETER = SensorLaw(
    PressureHeight,
    barometer_reading,
    ("state",),
    errors_that_read=(("dynamic_pressure", "wind"),),
    memory=SensorMemory(first_barometer_memory, next_barometer_memory),
    noise=barometer_noise,
)
"""Measurement law of a barometer."""
