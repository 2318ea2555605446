"""Industrial fans as free jets in a room.

A round jet of exit speed U₀ = 4 Q / (π D²) keeps it on its centreline as far as its core reaches, 5.9 D, and beyond
decays as 5.9 U₀ D / x. Across, its profile is Gaussian, with half the speed of the centreline at 0.094 x from it (round
free jets are measured with 5.8 to 6.1 and 0.094 to 0.102: S. B. Pope, "Turbulent Flows", 2000, table 5.1). The core is
a cone of uniform speed on the outlet, with the flank of the same Gaussian around it.

Behind the outlet the air is at rest, and what the jet draws in from the sides is left out.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from pydrake.common import RandomDistribution

from drake_quad.compiled import formula
from drake_quad.elementary import Row, Rows, exp, maximum, sqrt, where
from drake_quad.fleet import AutoDiffXd, FleetSystem, fleet_system

CORE_LENGTH, SPREAD = 5.9, 0.094
_LN_2 = math.log(2.0)
# Keeps 0 / 0 away at the outlet (m), and infinite derivatives of square roots on the centreline and in calm air.
_LEAST_LENGTH, _TINY = 1e-9, 1e-200


class Jet(NamedTuple):
    """The free jet of a fan.

    Attributes:
        position: of the middle of its outlet, 3 rows in W, m.
        direction: in which it blows, a unit vector, 3 rows in W.
        exit_speed: U₀, m/s.
        diameter: D of the outlet, m.
        turbulence: standard deviation of the air's velocity over its mean, on each axis, 1.
    """

    position: Rows
    direction: Rows
    exit_speed: Row
    diameter: Row
    turbulence: Row = 0.0

    @classmethod
    def of_fan(cls, *, position: Rows, direction: Rows, flow: Row, diameter: Row, turbulence: Row) -> "Jet":
        """The jet of a fan, of numbers or arrays.

        Args:
            position: of the middle of its outlet, 3 rows in W, m.
            direction: 3 rows of any length.
            flow: Q, m³/s.
            diameter: D, m.
            turbulence: share, 1.
        """
        length = np.sqrt(sum(part * part for part in direction))
        unit = [part / length for part in direction]
        return cls(position, unit, 4.0 * flow / (math.pi * diameter * diameter), diameter, turbulence)

    def to_rows(self) -> list[Row]:
        """The jet as 9 rows, in the order above."""
        position, direction, *rest = self
        return [*position, *direction, *rest]

    def speed(self, place: Rows) -> tuple[Row, Row]:
        """See `jet_speed`."""
        return jet_speed(place, self.to_rows())


@formula
def jet_speed(place: Rows, jet: Rows) -> tuple[Row, Row]:
    """The mean speed of a jet at a place (m/s) and the half-width there (m).

    Args:
        place: in W, in the first 3 rows, m.
        jet: the 9 rows of a `Jet`.
    """
    x_0, y_0, z_0, d_x, d_y, d_z, exit_speed, diameter, _ = jet
    x, y, z = place[0] - x_0, place[1] - y_0, place[2] - z_0
    along = x * d_x + y * d_y + z * d_z
    across = sqrt(maximum(x * x + y * y + z * z - along * along, _TINY))
    reach = CORE_LENGTH * diameter
    core = 0.5 * diameter * maximum(1.0 - along / reach, 0.0)
    half_width = SPREAD * maximum(along, _LEAST_LENGTH)
    flank = maximum(across - core, 0.0) / half_width
    centreline = exit_speed * reach / maximum(along, reach)
    return where(along > 0.0, centreline * exp(-_LN_2 * flank * flank), 0.0), half_width


@formula
def air(place: Rows, jets: Rows) -> tuple[Row, Row, Row, Row, Row]:
    """What the jets do at a place, summed: mean wind in W (m/s), variance (m²/s²) and rate (1/s) of its turbulence.

    Args:
        place: in W, in the first 3 rows, m.
        jets: the 9 rows of each `Jet`.
    """
    if len(jets) == 0:
        return 0.0, 0.0, 0.0, 0.0, 0.0
    x, y, z, variance, rate = air(place, jets[9:])
    speed, half_width = jet_speed(place, jets[0:9])
    swing = jets[8] * speed
    return (
        x + speed * jets[3],
        y + speed * jets[4],
        z + speed * jets[5],
        variance + swing * swing,
        rate + speed / half_width,
    )


@formula
def first_sample(state: Rows, noise: Rows, jets: Rows) -> tuple[Rows, Rows]:
    """The turbulence over its deviation and the wind in W (m/s) at the beginning.

    Args:
        state: of the vehicle, 12 rows.
        noise: three normal numbers.
        jets: the 9 rows of each `Jet`.
    """
    x, y, z, variance, _ = air(state, jets)
    return noise, _gusty((x, y, z), variance, noise)


@formula
def next_sample(state: Rows, eddies: Rows, noise: Rows, jets: Rows, period: float) -> tuple[Rows, Rows]:
    """The same a period (s) later, with the turbulence of before."""
    x, y, z, variance, rate = air(state, jets)
    decay = exp(-period * rate)
    fresh = sqrt(maximum(1.0 - decay * decay, _TINY))
    later = (
        decay * eddies[0] + fresh * noise[0],
        decay * eddies[1] + fresh * noise[1],
        decay * eddies[2] + fresh * noise[2],
    )
    return later, _gusty((x, y, z), variance, later)


@formula
def _gusty(mean: Rows, variance: Row, eddies: Rows) -> tuple[Row, Row, Row]:
    deviation = sqrt(maximum(variance, _TINY))
    return mean[0] + deviation * eddies[0], mean[1] + deviation * eddies[1], mean[2] + deviation * eddies[2]


@fleet_system(float, AutoDiffXd)
class Fans(FleetSystem):
    """Several fans that blow through a room.

    .. pydrake_system::

        name: Fans
        input_ports:
        - state
        - jet_noise
        output_ports:
        - wind

    `wind` (3 rows, m/s in W) is the sum of the jets at the position in the vehicle's `state` (12 rows), and their
    turbulence: alike in all directions, a first-order Gauss–Markov process in time, with the root of the jets' summed
    variances for deviation and a half-width over the speed of the air, which is about what an eddy takes to go by, for
    time scale. `jet_noise` (3 rows) is random: normal numbers, new ones at every sample. A simulator that goes on with
    a flight must suppress initialization events, which begin the turbulence anew.

    Discrete-state groups: 0 what is held, 1 the turbulence over its deviation, 3 rows. One numeric parameter of the
    context: the 9 rows of each `Jet`.

    Args:
        num_vehicles: N; each in turbulence of its own.
        period: of the samples, s; the vehicle's time step.
        jets: each entry a number or an (N,) array.
    """

    def declare(self, *, num_vehicles: int = 1, period: float = 0.01, jets: Sequence[Jet]) -> None:
        """Declares the system; see the class for the arguments."""
        self.period = period
        self._jets = self.numeric_parameter([row for jet in jets for row in jet.to_rows()])
        self._vehicle = self.input("state", 12)
        self._noise = self.random_input("jet_noise", 3, RandomDistribution.kGaussian)
        self._wind = self.discrete_state("wind", [0.0] * 3)
        self._eddies = self.discrete_state("eddies", [0.0] * 3)
        self._first = self.interpreted(first_sample, inputs=(12, 3, 9 * len(jets)))
        self._next = self.mapped(next_sample, inputs=(12, 3, 3, 9 * len(jets)), outputs=(3, 3))
        self.DeclareInitializationDiscreteUpdateEvent(self._start)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._sample)
        self.state_output(3, self._wind)

    def _start(self, context: Any, discrete_state: Any) -> None:
        vehicle, noise = self.inputs(context, self._vehicle, self._noise)
        self._first(self._groups(discrete_state), [vehicle, noise, self.parameter(context, self._jets)])

    def _sample(self, context: Any, discrete_state: Any) -> None:
        if context.get_time() == 0.0:
            return  # the start has used up the numbers of this instant
        vehicle, noise = self.inputs(context, self._vehicle, self._noise)
        eddies, jets = context.get_discrete_state(self._eddies), self.parameter(context, self._jets)
        self._next(self._groups(discrete_state), [vehicle, eddies, noise, jets], self.period)

    def _groups(self, discrete_state: Any) -> list[Any]:
        return [discrete_state.get_mutable_vector(self._eddies), discrete_state.get_mutable_vector(self._wind)]
