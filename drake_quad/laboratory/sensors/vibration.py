"""Vibration of a vehicle that is caused by its rotors, as inertial sensors measure it.

Rotor i with the speed Ω, the phase φ (dφ/dt = Ω) and the direction of rotation s exerts two periodic forces at its hub.
An unbalance u, the mass of the rotor times the distance of its centre of mass from the axis, rotates in the plane of
the rotor. The thrust b Ω² varies by the fractions h_k at the harmonics k of the speed:

    F = Ω² (u cos φ, u s sin φ, b Σ_k h_k cos kφ)

The body of mass m and inertia J responds as a free rigid body. A sensor at the position r relative to the centre of
mass measures the vibration

    α = J⁻¹ (r_i × F),    f = F / m + α × r,    ω = ∫ α dt

The integral is taken at constant speed, which replaces Ω² cos kφ by Ω sin kφ / k. Products of ω with the other body
rates are neglected. The vibration does not move the simulated vehicle, whose rotor forces are averages over a turn.

The vibration is evaluated at the instant of a reading, so harmonics above half of the sampling rate are aliased as in a
real sensor. A low-pass filter ω_b / (s + ω_b) of the sensor acts on harmonic k as in continuous time: with x = k Ω /
ω_b,

    cos kφ → (cos kφ + x sin kφ) / (1 + x²)        sin kφ → (sin kφ - x cos kφ) / (1 + x²)

The phase is integrated with the mean of the speeds at two successive readings. This is exact at constant acceleration.
At the end of a change of speed, the error is h²/12 times the difference of the accelerations before and after the
change, so a change between two constant speeds leaves no error of this order.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

from drake_quad.framework.elementary import sin_cos, wrap_angle
from drake_quad.geometry.axes import Vector, cross, plus, times
from drake_quad.signals import Angle, Number, RotorRate, RotorSpeed, Row


class Responses(NamedTuple):
    """Response of a sensor to the vibration of one rotor, per squared rotor speed.

    Attributes:
        x: response to the x component u cos φ of the rotating force.
        y: response to the y component u s sin φ of the rotating force.
        z: response to a thrust of b Ω².
    """

    x: Vector
    y: Vector
    z: Vector


class RotorAngles(NamedTuple):
    """An angle for each rotor."""

    rotor_1: Angle
    rotor_2: Angle
    rotor_3: Angle
    rotor_4: Angle


class Vibration(NamedTuple):
    """Vibration parameters of a sensor.

    Attributes:
        responses: response of the sensor to each rotor.
        harmonics: fractions h_k of the thrust that vary at the harmonics 1, 2, ... of the rotor speed.
        initial_phases: phase of each rotor at the first reading.
        period: time between readings, s.
    """

    responses: tuple[Responses, Responses, Responses, Responses]
    harmonics: tuple[Number, ...]
    initial_phases: RotorAngles
    period: Row


class RotorPhases(NamedTuple):
    """Phases and speeds of the rotors at a reading."""

    phase: RotorAngles
    speed: RotorSpeed


class FreeBody(NamedTuple):
    """Body on which the rotors exert periodic forces.

    Attributes:
        mass: mass m of the body, kg.
        inertia: moments of inertia J of the body on x, y, z of B, kg m².
    """

    mass: Row
    inertia: Any

    def angular_acceleration(self, hub: Vector, force: Vector) -> Vector:
        """Return J⁻¹ (r_i × F) for a force F at the hub r_i of a rotor relative to the centre of mass."""
        return Vector._make(torque / moment for torque, moment in zip(cross(hub, force), self.inertia, strict=True))

    def specific_force(self, hub: Vector, force: Vector, position: Vector) -> Vector:
        """Return the specific force F / m + α × r at the position r of a sensor, for a force F at a hub."""
        return plus(times(1.0 / self.mass, force), cross(self.angular_acceleration(hub, force), position))


def rotor_forces(rotor: Any, unbalance: Row) -> tuple[Vector, Vector, Vector]:
    """Return the amplitudes of the three periodic forces of a rotor, divided by the squared rotor speed.

    The amplitudes are u along x, u s along y and b along z, with the unbalance u, the direction of rotation s and the
    thrust factor b.
    """
    return (
        Vector(unbalance, 0.0, 0.0),
        Vector(0.0, unbalance * rotor.direction, 0.0),
        Vector(0.0, 0.0, rotor.thrust_factor),
    )


def first_phases(vibration: Vibration, speed: RotorSpeed) -> RotorPhases:
    """Return the phases of the rotors at the first reading."""
    return RotorPhases(vibration.initial_phases, speed)


def next_phases(vibration: Vibration, phases: RotorPhases, speed: RotorSpeed) -> RotorPhases:
    """Return the phases of the rotors at the next reading, by the trapezoidal rule."""
    half = 0.5 * vibration.period
    turned = (
        wrap_angle(phase + half * (before + now))
        for phase, before, now in zip(phases.phase, phases.speed, speed, strict=True)
    )
    return RotorPhases(RotorAngles._make(turned), speed)


def vibration_force(vibration: Vibration, phases: RotorPhases, bandwidth: Row | None) -> Vector:
    """Return the specific force f of the vibration, m/s²; `bandwidth` is ω_b in rad/s, or None without a filter."""
    total = Vector(0.0, 0.0, 0.0)
    for response, phase, speed in zip(vibration.responses, *phases, strict=True):
        harmonics = _filtered_harmonics(phase, speed, len(vibration.harmonics), bandwidth)
        ripple = _weighted(vibration.harmonics, [cosine for cosine, _ in harmonics])
        (cosine, sine), *_ = harmonics
        total = plus(total, times(speed * speed, _sum(response, cosine, sine, ripple)))
    return total


def vibration_rate(vibration: Vibration, phases: RotorPhases, bandwidth: Row | None) -> Vector:
    """Return the angular velocity ω of the vibration, rad/s; `bandwidth` is ω_b in rad/s, or None without a filter."""
    total = Vector(0.0, 0.0, 0.0)
    for response, phase, speed in zip(vibration.responses, *phases, strict=True):
        harmonics = _filtered_harmonics(phase, speed, len(vibration.harmonics), bandwidth)
        ripple = _weighted(vibration.harmonics, [sine * (1.0 / (k + 1)) for k, (_, sine) in enumerate(harmonics)])
        (cosine, sine), *_ = harmonics
        total = plus(total, times(speed, _sum(response, sine, -cosine, ripple)))
    return total


def _filtered_harmonics(
    phase: Angle, speed: RotorRate, num_harmonics: int, bandwidth: Row | None
) -> list[tuple[Row, Row]]:
    """Return cos kφ and sin kφ for the harmonics k = 1, 2, ... (at least k = 1), after the sensor's low-pass filter."""
    sine, cosine = sin_cos(phase)
    c, s = cosine, sine
    harmonics = [(c, s)]
    for _ in range(num_harmonics - 1):
        c, s = c * cosine - s * sine, s * cosine + c * sine
        harmonics.append((c, s))
    if bandwidth is None:
        return harmonics
    filtered = []
    for k, (c, s) in enumerate(harmonics, start=1):
        x = float(k) * speed / bandwidth
        gain = 1.0 / (1.0 + x * x)
        filtered.append((gain * (c + x * s), gain * (s - x * c)))
    return filtered


def _weighted(weights: Sequence[Row], rows: Sequence[Row]) -> Row:
    weighted: Row = 0.0
    for weight, row in zip(weights, rows, strict=False):
        weighted = weighted + weight * row
    return weighted


def _sum(response: Responses, x: Row, y: Row, z: Row) -> Vector:
    return Vector._make(a * x + b * y + c * z for a, b, c in zip(*response, strict=True))
