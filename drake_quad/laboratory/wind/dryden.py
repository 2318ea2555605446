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
from typing import Any, NamedTuple

import numpy as np
from pydrake.common import RandomDistribution
from scipy.special import gammainc

from drake_quad.compiled import formula
from drake_quad.elementary import Row, Rows
from drake_quad.fleet import AutoDiffXd, FleetSystem, fleet_system

FOOT, KNOT = 0.3048, 1852.0 / 3600.0
# The specification's wind at 20 feet, m/s.
WIND_AT_20_FEET = {"light": 15.0 * KNOT, "moderate": 30.0 * KNOT, "severe": 45.0 * KNOT}
# Below 10 feet scales and deviations are those at 10 feet; slower than this the air does not go by, m/s.
LEAST_HEIGHT, LEAST_AIRSPEED = 10.0 * FOOT, 1.0
# σ / √2 (√3 f + (1 - √3) g), without σ.
_OF_F, _OF_G = math.sqrt(1.5), math.sqrt(0.5) - math.sqrt(1.5)


class Turbulence(NamedTuple):
    """Dryden's turbulence along (u) and across (v, w) the mean wind.

    Attributes:
        deviation: σ_u, σ_v, σ_w, 3 rows, m/s.
        length: L_u, L_v, L_w, 3 rows, m.
        airspeed: V with which it goes by, m/s.
    """

    deviation: Rows
    length: Rows
    airspeed: Row

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
        return cls((level, level, vertical), (long, long, feet * FOOT), np.maximum(airspeed, LEAST_AIRSPEED))


class SampledFilter(NamedTuple):
    """Dryden's filters from one sample to the next, of u, v, w for f and of v, w for g.

    Attributes:
        p_u: decay p; `p_v` and `p_w` likewise.
        t_v: transfer η p from f to g; `t_w` likewise.
        b_u: standard deviation of the noise of f; `b_v` and `b_w` likewise.
        c_v: what the noise of g has of the same normal number; `c_w` likewise.
        d_v: what it has of one of its own; `d_w` likewise.
    """

    p_u: Row
    p_v: Row
    p_w: Row
    t_v: Row
    t_w: Row
    b_u: Row
    b_v: Row
    b_w: Row
    c_v: Row
    c_w: Row
    d_v: Row
    d_w: Row

    @classmethod
    def of(cls, turbulence: Turbulence, period: float) -> "SampledFilter":
        """The exact sampled filter of numbers or arrays.

        Args:
            turbulence: its lengths and airspeed.
            period: h, s.
        """
        eta = [period * turbulence.airspeed / length for length in turbulence.length]
        noise_f = [np.sqrt(gammainc(1.0, 2.0 * x)) for x in eta]
        noise_shared = [0.5 * gammainc(2.0, 2.0 * x) / own for x, own in zip(eta[1:], noise_f[1:], strict=True)]
        noise_g = [
            np.sqrt(0.5 * gammainc(3.0, 2.0 * x) - shared * shared)
            for x, shared in zip(eta[1:], noise_shared, strict=True)
        ]
        transfer = [x * np.exp(-x) for x in eta[1:]]
        return cls(*(np.exp(-x) for x in eta), *transfer, *noise_f, *noise_shared, *noise_g)


@formula
def filtered(state: Rows, noise: Rows, sampled: Rows) -> tuple[Row, Row, Row, Row, Row]:
    """The state of the filter a period later.

    Args:
        state: f_u, f_v, f_w, g_v, g_w.
        noise: five normal numbers.
        sampled: the 12 rows of a `SampledFilter`.
    """
    f_u, f_v, f_w, g_v, g_w = state
    n_1, n_2, n_3, n_4, n_5 = noise
    p_u, p_v, p_w, t_v, t_w, b_u, b_v, b_w, c_v, c_w, d_v, d_w = sampled
    return (
        p_u * f_u + b_u * n_1,
        p_v * f_v + b_v * n_2,
        p_w * f_w + b_w * n_3,
        t_v * f_v + p_v * g_v + c_v * n_2 + d_v * n_4,
        t_w * f_w + p_w * g_w + c_w * n_3 + d_w * n_5,
    )


@formula
def stationary_state(noise: Rows) -> tuple[Row, Row, Row, Row, Row]:
    """A state of the filter that is as likely as any later one, from five normal numbers."""
    f_u, f_v, f_w, n_v, n_w = noise
    return f_u, f_v, f_w, 0.5 * (f_v + n_v), 0.5 * (f_w + n_w)


@formula
def filtered_velocity(state: Rows, deviation: Rows) -> tuple[Row, Row, Row]:
    """The turbulence u, v, w (m/s) of a state of the filter."""
    f_u, f_v, f_w, g_v, g_w = state
    return deviation[0] * f_u, deviation[1] * (_OF_F * f_v + _OF_G * g_v), deviation[2] * (_OF_F * f_w + _OF_G * g_w)


@formula
def first_sample(noise: Rows, parameters: Rows) -> tuple[Rows, Rows]:
    """The state of the filter and the wind in W (m/s) at the beginning.

    Args:
        noise: five normal numbers.
        parameters: of a `DrydenTurbulence`, 17 rows.
    """
    state = stationary_state(noise)
    return state, _wind(state, parameters)


@formula
def next_sample(state: Rows, noise: Rows, parameters: Rows) -> tuple[Rows, Rows]:
    """The state of the filter and the wind in W (m/s) a period later; other arguments as for `first_sample`."""
    later = filtered(state, noise, parameters[0:12])
    return later, _wind(later, parameters)


@formula
def _wind(state: Rows, parameters: Rows) -> tuple[Row, Row, Row]:
    u, v, w = filtered_velocity(state, parameters[12:15])
    cos_heading, sin_heading = parameters[15], parameters[16]
    return u * cos_heading - v * sin_heading, u * sin_heading + v * cos_heading, w


@fleet_system(float, AutoDiffXd)
class DrydenTurbulence(FleetSystem):
    """Dryden's turbulence, frozen in the air that goes by.

    .. pydrake_system::

        name: DrydenTurbulence
        input_ports:
        - turbulence_noise
        output_ports:
        - wind

    `turbulence_noise` (5 rows) is random: normal numbers, new ones at every sample. `wind` (3 rows, m/s in W) has
    their spectra along and across the heading and upwards. It is stationary from the first sample on,
    which a simulator takes when it initializes: one that goes on with a flight must suppress initialization events.

    Discrete-state groups: 0 what is held, 1 the five rows of the filter. One numeric parameter of the context: the 12
    rows of `SampledFilter`, the three deviations, cosine and sine of the heading.

    Args:
        num_vehicles: N; each in turbulence of its own.
        period: of the samples, s; the vehicle's time step.
        turbulence: each entry a number or an (N,) array.
        heading: of the longitudinal axis, from X towards Y, rad.
    """

    def declare(
        self, *, num_vehicles: int = 1, period: float = 0.01, turbulence: Turbulence, heading: Row = 0.0
    ) -> None:
        """Declares the system; see the class for the arguments."""
        self.period = period
        axes = [*turbulence.deviation, np.cos(heading), np.sin(heading)]
        self._parameters = self.numeric_parameter([*SampledFilter.of(turbulence, period), *axes])
        self._noise = self.random_input("turbulence_noise", 5, RandomDistribution.kGaussian)
        self._wind = self.discrete_state("wind", [0.0] * 3)
        self._state = self.discrete_state("filter", [0.0] * 5)
        self._first = self.interpreted(first_sample, inputs=(5, 17))
        self._next = self.mapped(next_sample, inputs=(5, 5, 17), outputs=(5, 3))
        self.DeclareInitializationDiscreteUpdateEvent(self._start)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._sample)
        self.state_output(3, self._wind)

    def _start(self, context: Any, discrete_state: Any) -> None:
        noise, parameters = self.EvalVectorInput(context, self._noise), self.parameter(context, self._parameters)
        self._first(self._groups(discrete_state), [noise, parameters])

    def _sample(self, context: Any, discrete_state: Any) -> None:
        if context.get_time() == 0.0:
            return  # the start has used up the numbers of this instant
        noise, parameters = self.EvalVectorInput(context, self._noise), self.parameter(context, self._parameters)
        self._next(self._groups(discrete_state), [context.get_discrete_state(self._state), noise, parameters])

    def _groups(self, discrete_state: Any) -> list[Any]:
        return [discrete_state.get_mutable_vector(self._state), discrete_state.get_mutable_vector(self._wind)]
