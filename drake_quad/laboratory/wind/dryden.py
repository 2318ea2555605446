"""Continuous turbulence at low altitude with Dryden's spectra, from MIL-F-8785C, section 3.7.2.2.

With T = L / V for each axis, white noise with a one-sided spectral density of 1 per rad/s is filtered by

    H_u = σ_u √(2 T / π) / (1 + T s)        H_v, H_w = σ √(T / π) (1 + √3 T s) / (1 + T s)²

The output of H_v and H_w is σ / √2 (√3 f + (1 - √3) g). Here f is the noise filtered by √(2 T / π) / (1 + T s), with
unit variance, and g is f filtered by 1 / (1 + T s). With samples at intervals h, η = h / T and p = exp(-η), the exact
discrete-time equations are

    f⁺ = p f + noise_f        g⁺ = η p f + p g + noise_g

    var noise_f = P₁(2η)      cov = P₂(2η) / 2      var noise_g = P₃(2η) / 2

P_k is the regularised lower incomplete gamma function of order k. It approaches 1 for large h, so the stationary
covariances are 1, ½ and ½, and the standard deviation is σ for every sampling interval.
"""

import math
from typing import NamedTuple

import numpy as np
import scipy
from pydrake.common import RandomDistribution

from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.signals import Angle, Number, Row, VelocityW, Wind

FOOT = 0.3048  # m
KNOT = 1852.0 / 3600.0  # m/s
WIND_AT_20_FEET = {"light": 15.0 * KNOT, "moderate": 30.0 * KNOT, "severe": 45.0 * KNOT}
"""Wind speed at a height of 20 feet for each intensity of turbulence in the specification, m/s."""
# Smallest height for which the specification is defined, m. Below it, the length scales and standard deviations at 10
# feet are used.
MIN_HEIGHT = 10.0 * FOOT
# Smallest speed at which the turbulence moves past the vehicle, m/s. At zero speed, the turbulence would be constant.
MIN_AIRSPEED = 1.0
# The turbulence across the mean wind is σ (√3 f + (1 - √3) g) / √2, where f and g are the states of the filter.
_F_FACTOR = math.sqrt(1.5)  # factor of f in the turbulence, √3 / √2
_G_FACTOR = math.sqrt(0.5) - math.sqrt(1.5)  # factor of g in the turbulence, (1 - √3) / √2


class PerDirection(NamedTuple):
    """A value for each direction: u along the mean wind, v horizontally across it, w upwards."""

    u: Row
    v: Row
    w: Row


class Turbulence(NamedTuple):
    """Parameters of Dryden's turbulence.

    Attributes:
        deviation: standard deviations σ, m/s.
        length: length scales L, m.
        airspeed: speed V at which the turbulence moves past the vehicle.
    """

    deviation: PerDirection
    length: PerDirection
    airspeed: VelocityW

    @classmethod
    def at_low_altitude(cls, *, height: Row, wind_at_20_feet: Row, airspeed: Row) -> "Turbulence":
        """Return the turbulence of the specification for heights below 1000 feet; arguments are numbers or arrays.

        Args:
            height: height above the ground, m; smaller values are replaced with `MIN_HEIGHT`.
            wind_at_20_feet: wind speed at a height of 20 feet, m/s.
            airspeed: airspeed, m/s; smaller values are replaced with `MIN_AIRSPEED`.
        """
        feet = np.maximum(height, MIN_HEIGHT) / FOOT
        shear = 0.177 + 0.000823 * feet
        vertical_deviation = 0.1 * wind_at_20_feet
        horizontal_deviation = vertical_deviation / shear**0.4
        horizontal_length = feet / shear**1.2 * FOOT
        return cls(
            PerDirection(horizontal_deviation, horizontal_deviation, vertical_deviation),
            PerDirection(horizontal_length, horizontal_length, feet * FOOT),
            np.maximum(airspeed, MIN_AIRSPEED),
        )


class TurbulenceParameters(NamedTuple):
    """Turbulence, and the direction of the mean wind.

    Attributes:
        turbulence: turbulence along and across the mean wind.
        heading: direction of the mean wind, as an angle from X towards Y of W.
    """

    turbulence: Turbulence
    heading: Angle = 0.0


class AxisFilter(NamedTuple):
    """Discrete-time filter along the mean wind, f⁺ = p f + b n with standard normal n.

    Attributes:
        p: factor by which the state f decays over a sampling interval.
        b: standard deviation of the noise that drives f.
    """

    p: Number
    b: Number


class CrossAxisFilter(NamedTuple):
    """Discrete-time filter on an axis across the mean wind, with standard normal n_f and n_g.

    The states f and g follow f⁺ = p f + b n_f and g⁺ = t f + p g + c n_f + d n_g.

    Attributes:
        p: factor by which the states f and g decay over a sampling interval.
        b: standard deviation of the noise that drives f.
        t: coefficient of f in the equation of g, equal to η p.
        c: coefficient, in the equation of g, of the noise sample n_f that also drives f.
        d: coefficient, in the equation of g, of the independent noise sample n_g.
    """

    p: Number
    b: Number
    t: Number
    c: Number
    d: Number


class SampledTurbulence(NamedTuple):
    """Discrete-time filters of the turbulence.

    Attributes:
        u: filter along the mean wind.
        v: filter horizontally across the mean wind.
        w: filter upwards.
        deviation: standard deviations σ, m/s.
        cos_heading: cosine of the heading.
        sin_heading: sine of the heading.
    """

    u: AxisFilter
    v: CrossAxisFilter
    w: CrossAxisFilter
    deviation: PerDirection
    cos_heading: Number
    sin_heading: Number

    @classmethod
    def of(cls, parameters: TurbulenceParameters, period: float) -> "SampledTurbulence":
        """Return the exact discrete-time filters.

        Args:
            parameters: parameters of the turbulence, numbers or arrays.
            period: sampling interval h, s.
        """
        turbulence = parameters.turbulence
        u, v, w = (period * turbulence.airspeed / length for length in turbulence.length)
        return cls(
            AxisFilter(np.exp(-u), np.sqrt(scipy.special.gammainc(1.0, 2.0 * u))),
            _cross_axis_filter(v),
            _cross_axis_filter(w),
            turbulence.deviation,
            np.cos(parameters.heading),
            np.sin(parameters.heading),
        )


def _cross_axis_filter(eta: Row) -> CrossAxisFilter:
    """Return the filter on an axis across the mean wind for η = h / T."""
    noise_f = np.sqrt(scipy.special.gammainc(1.0, 2.0 * eta))
    shared = 0.5 * scipy.special.gammainc(2.0, 2.0 * eta) / noise_f
    noise_g = np.sqrt(0.5 * scipy.special.gammainc(3.0, 2.0 * eta) - shared * shared)
    return CrossAxisFilter(np.exp(-eta), noise_f, eta * np.exp(-eta), shared, noise_g)


class FilterState(NamedTuple):
    """State of the filters (f for each axis, g for the axes across the mean wind), or a normal sample for each."""

    f_u: Number
    f_v: Number
    f_w: Number
    g_v: Number
    g_w: Number


class TurbulenceState(NamedTuple):
    """States of a `DrydenTurbulence`."""

    wind: Wind
    filter: FilterState


def next_filter_state(state: FilterState, noise: FilterState, sampled: SampledTurbulence) -> FilterState:
    """Return the state of the filters one sampling interval later; `noise` contains standard normal samples."""
    u, v, w = sampled.u, sampled.v, sampled.w
    return FilterState(
        u.p * state.f_u + u.b * noise.f_u,
        v.p * state.f_v + v.b * noise.f_v,
        w.p * state.f_w + w.b * noise.f_w,
        v.t * state.f_v + v.p * state.g_v + v.c * noise.f_v + v.d * noise.g_v,
        w.t * state.f_w + w.p * state.g_w + w.c * noise.f_w + w.d * noise.g_w,
    )


def stationary_state(noise: FilterState) -> FilterState:
    """Return a random state of the filters with the stationary distribution; `noise` is standard normal."""
    return noise._replace(g_v=0.5 * (noise.f_v + noise.g_v), g_w=0.5 * (noise.f_w + noise.g_w))


def turbulent_velocity(state: FilterState, deviation: PerDirection) -> PerDirection:
    """Return the turbulent velocity (m/s) for a state of the filters."""
    return PerDirection(
        deviation.u * state.f_u,
        deviation.v * (_F_FACTOR * state.f_v + _G_FACTOR * state.g_v),
        deviation.w * (_F_FACTOR * state.f_w + _G_FACTOR * state.g_w),
    )


def first_sample(noise: FilterState, sampled: SampledTurbulence) -> TurbulenceState:
    """Return the initial wind and state of the filters; `noise` contains standard normal samples."""
    state = stationary_state(noise)
    return TurbulenceState(_wind(state, sampled), state)


def next_sample(state: FilterState, noise: FilterState, sampled: SampledTurbulence) -> TurbulenceState:
    """Return the wind and the state of the filters one sampling interval later; `noise` is standard normal."""
    next_state = next_filter_state(state, noise, sampled)
    return TurbulenceState(_wind(next_state, sampled), next_state)


def _wind(state: FilterState, sampled: SampledTurbulence) -> Wind:
    """Return the turbulent velocity along the axes of W, m/s."""
    u, v, w = turbulent_velocity(state, sampled.deviation)
    cos_heading, sin_heading = sampled.cos_heading, sampled.sin_heading
    return Wind(u * cos_heading - v * sin_heading, u * sin_heading + v * cos_heading, w)


@fleet_system(float, AutoDiffXd)
class DrydenTurbulence(FleetSystem):
    """Dryden's turbulence as a frozen field that moves past the vehicle.

    .. pydrake_system::

        name: DrydenTurbulence
        input_ports:
        - turbulence_noise
        output_ports:
        - wind

    `turbulence_noise` is a random input with new standard normal samples at every sampling instant. `wind` has Dryden's
    spectra along the heading, across the heading and upwards. An initialization event draws the first sample from the
    stationary distribution. A simulator that continues a flight must suppress initialization events.

    The states are `wind` and `filter`. The only parameter of the context is `turbulence`.

    Args:
        num_vehicles: number N of vehicles. The turbulence of each vehicle is independent of the others.
        period: sampling interval, s; equal to the vehicle's time step.
        parameters: parameters of the turbulence.
    """

    def declare(self, *, period: float = 0.01, parameters: TurbulenceParameters) -> None:
        """Declare the ports, states and parameters of this system."""
        turbulence = self.parameter("turbulence", lambda parameters: SampledTurbulence.of(parameters, period))
        noise = self.random_input("turbulence_noise", FilterState, RandomDistribution.kGaussian, period=period)
        wind = self.state("wind", lambda _: Wind(0.0, 0.0, 0.0))
        filters = self.state("filter", lambda _: FilterState(0.0, 0.0, 0.0, 0.0, 0.0))
        self.initialize(first_sample, noise, turbulence, writes=[wind, filters])
        # The initialization event already uses the random samples of time zero, so updates begin one period later.
        self.update(period, next_sample, filters, noise, turbulence, writes=[wind, filters], at_start=False)
        self.state_output(wind)
