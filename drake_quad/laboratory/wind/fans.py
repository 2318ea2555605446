"""Industrial fans as free jets in a room.

A round jet of exit speed U₀ = 4 Q / (π D²) keeps it on its centreline as far as its core reaches, 5.9 D, and beyond
decays as 5.9 U₀ D / x. Across, its profile is Gaussian, with half the speed of the centreline at 0.094 x from it (round
free jets are measured with 5.8 to 6.1 and 0.094 to 0.102: S. B. Pope, "Turbulent Flows", 2000, table 5.1). The core is
a cone of uniform speed on the outlet, with the flank of the same Gaussian around it.

Behind the outlet the air is at rest, and what the jet draws in from the sides is left out.
"""

import math
from typing import Annotated, NamedTuple

import numpy as np
from pydrake.common import RandomDistribution

from drake_quad.framework.elementary import exp, maximum, sqrt, where
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.signals import Number, PositionW, Quantity, Row, State, VelocityW, Wind

CORE_LENGTH, SPREAD = 5.9, 0.094
_LN_2 = math.log(2.0)
# Keeps 0 / 0 away at the outlet (m), and infinite derivatives of square roots on the centreline and in calm air.
_LEAST_LENGTH, _TINY = 1e-9, 1e-200


class Outlet(NamedTuple):
    """The middle of a fan's outlet."""

    x: PositionW
    y: PositionW
    z: PositionW


class Direction(NamedTuple):
    """A unit vector in W."""

    x: Number
    y: Number
    z: Number


class Jet(NamedTuple):
    """The free jet of a fan.

    Attributes:
        outlet: where it begins.
        direction: in which it blows.
        exit_speed: U₀.
        diameter: D of the outlet.
        turbulence: standard deviation of the air's velocity over its mean, on each axis.
    """

    outlet: Outlet
    direction: Direction
    exit_speed: VelocityW
    diameter: Annotated[Row, Quantity("m")]
    turbulence: Number = 0.0

    @classmethod
    def of_fan(cls, *, outlet: Outlet, direction: Direction, flow: Row, diameter: Row, turbulence: Row) -> "Jet":
        """The jet of a fan, of numbers or arrays.

        Args:
            outlet: where it begins.
            direction: of any length.
            flow: Q, m³/s.
            diameter: D, m.
            turbulence: share.
        """
        length = np.sqrt(sum(part * part for part in direction))
        unit = Direction._make(part / length for part in direction)
        return cls(outlet, unit, 4.0 * flow / (math.pi * diameter * diameter), diameter, turbulence)


class Air(NamedTuple):
    """What jets do at a place, summed.

    Attributes:
        mean: wind.
        variance: of the turbulence on each axis, m²/s².
        rate: of the turbulence, 1/s.
    """

    mean: Wind
    variance: Row
    rate: Row


class Eddies(NamedTuple):
    """Turbulence over its standard deviation on each axis; or a normal number for each."""

    x: Number
    y: Number
    z: Number


class Blown(NamedTuple):
    """The states of `Fans`."""

    wind: Wind
    eddies: Eddies


def jet_speed(state: State, jet: Jet) -> tuple[Row, Row]:
    """The mean speed of a jet at a vehicle (m/s) and the half-width there (m)."""
    x, y, z = state.x - jet.outlet.x, state.y - jet.outlet.y, state.z - jet.outlet.z
    along = x * jet.direction.x + y * jet.direction.y + z * jet.direction.z
    across = sqrt(maximum(x * x + y * y + z * z - along * along, _TINY))
    reach = CORE_LENGTH * jet.diameter
    core = 0.5 * jet.diameter * maximum(1.0 - along / reach, 0.0)
    half_width = SPREAD * maximum(along, _LEAST_LENGTH)
    flank = maximum(across - core, 0.0) / half_width
    centreline = jet.exit_speed * reach / maximum(along, reach)
    return where(along > 0.0, centreline * exp(-_LN_2 * flank * flank), 0.0), half_width


def air(state: State, jets: tuple[Jet, ...]) -> Air:
    """What jets do at a vehicle."""
    x = y = z = variance = rate = 0.0
    # The first jet comes last in the sum.
    for jet in reversed(jets):
        speed, half_width = jet_speed(state, jet)
        swing = jet.turbulence * speed
        x, y, z = x + speed * jet.direction.x, y + speed * jet.direction.y, z + speed * jet.direction.z
        variance, rate = variance + swing * swing, rate + speed / half_width
    return Air(Wind(x, y, z), variance, rate)


def first_sample(state: State, noise: Eddies, jets: tuple[Jet, ...]) -> Blown:
    """Wind and turbulence at the beginning, given normal numbers."""
    here = air(state, jets)
    return Blown(_gusty(here, noise), noise)


def next_sample(state: State, eddies: Eddies, noise: Eddies, jets: tuple[Jet, ...], period: float) -> Blown:
    """The same a period (s) later, with the turbulence of before."""
    here = air(state, jets)
    decay = exp(-period * here.rate)
    fresh = sqrt(maximum(1.0 - decay * decay, _TINY))
    later = Eddies._make(decay * eddy + fresh * number for eddy, number in zip(eddies, noise, strict=True))
    return Blown(_gusty(here, later), later)


def _gusty(here: Air, eddies: Eddies) -> Wind:
    deviation = sqrt(maximum(here.variance, _TINY))
    return Wind._make(mean + deviation * eddy for mean, eddy in zip(here.mean, eddies, strict=True))


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

    `wind` is the sum of the jets at the vehicle's position and of their turbulence. The turbulence is alike in all
    directions, a first-order Gauss–Markov process in time; its standard deviation is the root of the jets' summed
    variances, its time scale a half-width of the jet over the speed of the air, about what an eddy takes to go by.
    `jet_noise` is random: normal numbers, new ones at every sample. A simulator that goes on with a flight must
    suppress initialization events, which begin the turbulence anew.

    The states are `wind` and `eddies`, the only parameter of the context is `jets`.

    Args:
        num_vehicles: N; each in turbulence of its own.
        period: of the samples, s; the vehicle's time step.
        numbers: the jets.
    """

    def declare(self, *, period: float = 0.01, numbers: tuple[Jet, ...]) -> None:
        """Declares the system."""
        jets, state = self.parameter("jets", lambda jets: jets), self.input("state")
        noise = self.random_input("jet_noise", Eddies, RandomDistribution.kGaussian, period=period)
        wind = self.state("wind", lambda _: Wind(0.0, 0.0, 0.0))
        eddies = self.state("eddies", lambda _: Eddies(0.0, 0.0, 0.0))
        self.initialize(first_sample, state, noise, jets, writes=[wind, eddies])
        # The first sample has used up the numbers of time zero.
        self.update(period, next_sample, state, eddies, noise, jets, period, writes=[wind, eddies], at_start=False)
        self.state_output(wind)
