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
        self._num_jets = len(jets)
        self._jets = self.numeric_parameter([row for jet in jets for row in jet.to_rows()])
        self._vehicle = self.input("state", 12)
        self._noise = self.random_input("jet_noise", 3, RandomDistribution.kGaussian)
        self._wind = self.discrete_state("wind", [0.0] * 3)
        self._eddies = self.discrete_state("eddies", [0.0] * 3)
        self.DeclareInitializationDiscreteUpdateEvent(self._start)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._sample)
        self.state_output(3, self._wind)

    def _start(self, context: Any, discrete_state: Any) -> None:
        mean, deviation, _ = self._air(context)
        self._hold(discrete_state, mean, deviation, self.input_rows(context, self._noise))

    def _sample(self, context: Any, discrete_state: Any) -> None:
        if context.get_time() == 0.0:
            return  # the start has used up the numbers of this instant
        mean, deviation, rate = self._air(context)
        decay = exp(-self.period * rate)
        fresh = sqrt(maximum(1.0 - decay * decay, _TINY))
        e_x, e_y, e_z = self.state_rows(context, self._eddies)
        n_x, n_y, n_z = self.input_rows(context, self._noise)
        eddies = decay * e_x + fresh * n_x, decay * e_y + fresh * n_y, decay * e_z + fresh * n_z
        self._hold(discrete_state, mean, deviation, eddies)

    def _air(self, context: Any) -> tuple[Rows, Row, Row]:
        """The mean wind at the vehicle, 3 rows (m/s), the deviation (m/s) and the rate (1/s) of its turbulence."""
        place = self.input_rows(context, self._vehicle)
        rows = self.parameter_rows(context, self._jets)
        x, y, z, variance, rate = 0.0, 0.0, 0.0, 0.0, 0.0
        for first in range(0, 9 * self._num_jets, 9):
            jet = rows[first : first + 9]
            _, _, _, d_x, d_y, d_z, _, _, turbulence = jet
            speed, half_width = jet_speed(place, jet)
            x, y, z = x + speed * d_x, y + speed * d_y, z + speed * d_z
            swing = turbulence * speed
            variance, rate = variance + swing * swing, rate + speed / half_width
        return (x, y, z), sqrt(maximum(variance, _TINY)), rate

    def _hold(self, discrete_state: Any, mean: Rows, deviation: Row, eddies: Rows) -> None:
        (x, y, z), (e_x, e_y, e_z) = mean, eddies
        self.write(discrete_state.get_mutable_vector(self._eddies), eddies)
        wind = x + deviation * e_x, y + deviation * e_y, z + deviation * e_z
        self.write(discrete_state.get_mutable_vector(self._wind), wind)
