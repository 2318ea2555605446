"""Continuous turbulence of MIL-F-8785C, section 3.7.2.2: Dryden's spectra at low altitude.

With T = L / V for each axis, white noise of a one-sided spectral density of 1 per rad/s goes through

    H_u = σ_u √(2 T / π) / (1 + T s)        H_v, H_w = σ √(T / π) (1 + √3 T s) / (1 + T s)²

On V and W that is σ / √2 (√3 f + (1 - √3) g), where f is the noise through √(2 T / π) / (1 + T s), of unit variance,
and g is f through another 1 / (1 + T s). Sampled every h, with η = h / T and p = exp(-η), f and g are exactly

    f⁺ = p f + noise_f        g⁺ = η p f + p g + noise_g

    var noise_f = P₁(2η)      cov = P₂(2η) / 2      var noise_g = P₃(2η) / 2

with P_k the regularised incomplete gamma function, which goes to 1 as h does to infinity: the stationary covariances
are 1, ½, ½. So σ is delivered whatever the step.
"""

import math
from typing import NamedTuple

import numpy as np
import scipy
from pydrake.common import RandomDistribution

from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.signals import Angle, Number, Row, VelocityW, Wind

FOOT, KNOT = 0.3048, 1852.0 / 3600.0
# The specification's wind at 20 feet, m/s.
WIND_AT_20_FEET = {"light": 15.0 * KNOT, "moderate": 30.0 * KNOT, "severe": 45.0 * KNOT}
# Below 10 feet scales and deviations are those at 10 feet; slower than this the air does not go by, m/s.
LEAST_HEIGHT, LEAST_AIRSPEED = 10.0 * FOOT, 1.0
# σ / √2 (√3 f + (1 - √3) g), without σ.
_OF_F, _OF_G = math.sqrt(1.5), math.sqrt(0.5) - math.sqrt(1.5)


class PerDirection(NamedTuple):
    """A number for the direction of the mean wind (u), and for those across it (v level, w up)."""

    u: Row
    v: Row
    w: Row


class Turbulence(NamedTuple):
    """Dryden's turbulence.

    Attributes:
        deviation: σ, m/s.
        length: L, m.
        airspeed: V with which it goes by.
    """

    deviation: PerDirection
    length: PerDirection
    airspeed: VelocityW

    @classmethod
    def at_low_altitude(cls, *, height: Row, wind_at_20_feet: Row, airspeed: Row) -> "Turbulence":
        """The specification's scales and deviations below 1000 feet, of numbers or arrays.

        Args:
            height: m; at least 10 feet count.
            wind_at_20_feet: m/s.
            airspeed: m/s; at least 1 m/s count.
        """
        feet = np.maximum(height, LEAST_HEIGHT) / FOOT
        shear = 0.177 + 0.000823 * feet
        vertical = 0.1 * wind_at_20_feet
        level = vertical / shear**0.4
        long = feet / shear**1.2 * FOOT
        return cls(
            PerDirection(level, level, vertical),
            PerDirection(long, long, feet * FOOT),
            np.maximum(airspeed, LEAST_AIRSPEED),
        )


class TurbulenceNumbers(NamedTuple):
    """Turbulence, and where it comes from.

    Attributes:
        turbulence: along and across the mean wind.
        heading: of the mean wind, from X towards Y.
    """

    turbulence: Turbulence
    heading: Angle = 0.0


class AxisFilter(NamedTuple):
    """Dryden's filter on one axis, from one sample to the next.

    Attributes:
        p: decay.
        b: standard deviation of the noise of f.
    """

    p: Number
    b: Number


class FilterAcross(NamedTuple):
    """The same on an axis across the mean wind, where g follows f.

    Attributes:
        p: decay.
        b: standard deviation of the noise of f.
        t: transfer η p from f to g.
        c: what the noise of g has of the same normal number.
        d: what it has of one of its own.
    """

    p: Number
    b: Number
    t: Number
    c: Number
    d: Number


class SampledTurbulence(NamedTuple):
    """Dryden's filters from one sample to the next.

    Attributes:
        u: along the mean wind.
        v: across it, level.
        w: across it, up.
        deviation: σ, m/s.
        cos_heading: cosine of the heading.
        sin_heading: sine of the heading.
    """

    u: AxisFilter
    v: FilterAcross
    w: FilterAcross
    deviation: PerDirection
    cos_heading: Number
    sin_heading: Number

    @classmethod
    def of(cls, numbers: TurbulenceNumbers, period: float) -> "SampledTurbulence":
        """The exact sampled filters, of numbers or arrays.

        Args:
            numbers: of the turbulence.
            period: h, s.
        """
        turbulence = numbers.turbulence
        u, v, w = (period * turbulence.airspeed / length for length in turbulence.length)
        return cls(
            AxisFilter(np.exp(-u), np.sqrt(scipy.special.gammainc(1.0, 2.0 * u))),
            _across(v),
            _across(w),
            turbulence.deviation,
            np.cos(numbers.heading),
            np.sin(numbers.heading),
        )


def _across(eta: Row) -> FilterAcross:
    noise_f = np.sqrt(scipy.special.gammainc(1.0, 2.0 * eta))
    shared = 0.5 * scipy.special.gammainc(2.0, 2.0 * eta) / noise_f
    own = np.sqrt(0.5 * scipy.special.gammainc(3.0, 2.0 * eta) - shared * shared)
    return FilterAcross(np.exp(-eta), noise_f, eta * np.exp(-eta), shared, own)


class FilterState(NamedTuple):
    """The state of the filters: f of each axis, and g of those across. Or a normal number for each."""

    f_u: Number
    f_v: Number
    f_w: Number
    g_v: Number
    g_w: Number


class Turbulent(NamedTuple):
    """The states of a `DrydenTurbulence`."""

    wind: Wind
    filter: FilterState


def filtered(state: FilterState, noise: FilterState, sampled: SampledTurbulence) -> FilterState:
    """The state of the filters a period later, given normal numbers."""
    u, v, w = sampled.u, sampled.v, sampled.w
    return FilterState(
        u.p * state.f_u + u.b * noise.f_u,
        v.p * state.f_v + v.b * noise.f_v,
        w.p * state.f_w + w.b * noise.f_w,
        v.t * state.f_v + v.p * state.g_v + v.c * noise.f_v + v.d * noise.g_v,
        w.t * state.f_w + w.p * state.g_w + w.c * noise.f_w + w.d * noise.g_w,
    )


def stationary_state(noise: FilterState) -> FilterState:
    """A state of the filters that is as likely as any later one, given normal numbers."""
    return noise._replace(g_v=0.5 * (noise.f_v + noise.g_v), g_w=0.5 * (noise.f_w + noise.g_w))


def filtered_velocity(state: FilterState, deviation: PerDirection) -> PerDirection:
    """The turbulence (m/s) of a state of the filters."""
    return PerDirection(
        deviation.u * state.f_u,
        deviation.v * (_OF_F * state.f_v + _OF_G * state.g_v),
        deviation.w * (_OF_F * state.f_w + _OF_G * state.g_w),
    )


def first_sample(noise: FilterState, sampled: SampledTurbulence) -> Turbulent:
    """Wind and filters at the beginning, given normal numbers."""
    state = stationary_state(noise)
    return Turbulent(_wind(state, sampled), state)


def next_sample(state: FilterState, noise: FilterState, sampled: SampledTurbulence) -> Turbulent:
    """The same a period later."""
    later = filtered(state, noise, sampled)
    return Turbulent(_wind(later, sampled), later)


def _wind(state: FilterState, sampled: SampledTurbulence) -> Wind:
    u, v, w = filtered_velocity(state, sampled.deviation)
    cos_heading, sin_heading = sampled.cos_heading, sampled.sin_heading
    return Wind(u * cos_heading - v * sin_heading, u * sin_heading + v * cos_heading, w)


@fleet_system(float, AutoDiffXd)
class DrydenTurbulence(FleetSystem):
    """Dryden's turbulence, frozen in the air that goes by.

    .. pydrake_system::

        name: DrydenTurbulence
        input_ports:
        - turbulence_noise
        output_ports:
        - wind

    `turbulence_noise` is random: normal numbers, new ones at every sample. `wind` has Dryden's spectra along and across
    the heading and upwards. It is stationary from the first sample on, which a simulator takes when it initializes: one
    that goes on with a flight must suppress initialization events.

    The states are `wind` and `filter`, the only parameter of the context is `turbulence`.

    Args:
        num_vehicles: N; each in turbulence of its own.
        period: of the samples, s; the vehicle's time step.
        numbers: of the turbulence.
    """

    def declare(self, *, period: float = 0.01, numbers: TurbulenceNumbers) -> None:
        """Declares the system."""
        turbulence = self.parameter("turbulence", lambda numbers: SampledTurbulence.of(numbers, period))
        noise = self.random_input("turbulence_noise", FilterState, RandomDistribution.kGaussian, period=period)
        wind = self.state("wind", lambda _: Wind(0.0, 0.0, 0.0))
        filters = self.state("filter", lambda _: FilterState(0.0, 0.0, 0.0, 0.0, 0.0))
        self.initialize(first_sample, noise, turbulence, writes=[wind, filters])
        # The first sample has used up the numbers of time zero.
        self.update(period, next_sample, filters, noise, turbulence, writes=[wind, filters], at_start=False)
        self.state_output(wind)
