"""Industrial fans, modelled as free jets in a room.

The exit speed of a round jet is U₀ = 4 Q / (π D²), for a flow Q and an outlet of diameter D. On the centreline, the
speed is U₀ up to the end of the core at x = 5.9 D, and 5.9 U₀ D / x beyond. The profile across the jet is Gaussian,
with half the centreline speed at a distance of 0.094 x. Measured values for round free jets are 5.8 to 6.1 and 0.094 to
0.102 (S. B. Pope, "Turbulent Flows", 2000, table 5.1). The core is a cone of uniform speed, whose base is the outlet.
Outside the core, the speed falls like the flank of the same Gaussian.

The air behind the outlet is at rest. The model neglects the air that the jet entrains from the sides.
"""

import math
from typing import Annotated, NamedTuple

import numpy as np
from pydrake.common import RandomDistribution

from drake_quad.framework.elementary import exp, maximum, sqrt, where
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.signals import Number, PositionW, Quantity, Row, State, VelocityW, Wind

CORE_LENGTH = 5.9  # length of the core, relative to the diameter of the outlet
SPREAD = 0.094  # half-width of the jet, relative to the distance from the outlet
_LN_2 = math.log(2.0)
# Lower limit on the distance from the outlet, m, which avoids 0 / 0 there.
_MIN_DISTANCE = 1e-9
# Lower limit on the arguments of square roots, whose derivatives are infinite at zero.
_MIN_SQUARE = 1e-200


class Outlet(NamedTuple):
    """Centre of a fan's outlet."""

    x: PositionW
    y: PositionW
    z: PositionW


class Direction(NamedTuple):
    """Unit vector in W."""

    x: Number
    y: Number
    z: Number


class Jet(NamedTuple):
    """Free jet of a fan.

    Attributes:
        outlet: centre of the outlet.
        direction: direction of the jet.
        exit_speed: exit speed U₀.
        diameter: diameter D of the outlet.
        turbulence: turbulence intensity, which is the standard deviation of the velocity on each axis, divided by the
            mean speed.
    """

    outlet: Outlet
    direction: Direction
    exit_speed: VelocityW
    diameter: Annotated[Row, Quantity("m")]
    turbulence: Number = 0.0

    @classmethod
    def of_fan(cls, *, outlet: Outlet, direction: Direction, flow: Row, diameter: Row, turbulence: Row) -> "Jet":
        """Return the jet of a fan; arguments are numbers or arrays.

        Args:
            outlet: centre of the outlet.
            direction: direction of the jet, a vector of any length.
            flow: volume flow Q, m³/s.
            diameter: diameter D of the outlet, m.
            turbulence: turbulence intensity, which is the standard deviation of the velocity on each axis, divided by
                the mean speed.
        """
        length = np.sqrt(sum(part * part for part in direction))
        unit = Direction._make(part / length for part in direction)
        return cls(outlet, unit, 4.0 * flow / (math.pi * diameter * diameter), diameter, turbulence)


class LocalAir(NamedTuple):
    """Sum of all jets at the position of a vehicle.

    Attributes:
        mean: mean velocity of the air.
        variance: variance of the turbulence on each axis, m²/s².
        rate: inverse of the correlation time of the turbulence, 1/s.
    """

    mean: Wind
    variance: Row
    rate: Row


class Eddies(NamedTuple):
    """Turbulent velocity divided by its standard deviation on each axis, or a normal sample for each."""

    x: Number
    y: Number
    z: Number


class FansState(NamedTuple):
    """States of `Fans`."""

    wind: Wind
    eddies: Eddies


def jet_speed(state: State, jet: Jet) -> tuple[Row, Row]:
    """Return the mean speed of a jet at the position of a vehicle (m/s), and the half-width of the jet there (m)."""
    x, y, z = state.x - jet.outlet.x, state.y - jet.outlet.y, state.z - jet.outlet.z
    along = x * jet.direction.x + y * jet.direction.y + z * jet.direction.z
    across = sqrt(maximum(x * x + y * y + z * z - along * along, _MIN_SQUARE))
    core_length = CORE_LENGTH * jet.diameter
    core = 0.5 * jet.diameter * maximum(1.0 - along / core_length, 0.0)
    half_width = SPREAD * maximum(along, _MIN_DISTANCE)
    flank = maximum(across - core, 0.0) / half_width
    centreline = jet.exit_speed * core_length / maximum(along, core_length)
    return where(along > 0.0, centreline * exp(-_LN_2 * flank * flank), 0.0), half_width


def local_air(state: State, jets: tuple[Jet, ...]) -> LocalAir:
    """Return the sum of all jets at the position of a vehicle."""
    x = y = z = variance = rate = 0.0
    # The order of the jets affects only the rounding errors of the sum. It is kept so that results do not change.
    for jet in reversed(jets):
        speed, half_width = jet_speed(state, jet)
        deviation = jet.turbulence * speed
        x, y, z = x + speed * jet.direction.x, y + speed * jet.direction.y, z + speed * jet.direction.z
        variance, rate = variance + deviation * deviation, rate + speed / half_width
    return LocalAir(Wind(x, y, z), variance, rate)


def first_sample(state: State, noise: Eddies, jets: tuple[Jet, ...]) -> FansState:
    """Return the initial wind and turbulence; `noise` contains standard normal samples."""
    local = local_air(state, jets)
    return FansState(_with_turbulence(local, noise), noise)


def next_sample(state: State, eddies: Eddies, noise: Eddies, jets: tuple[Jet, ...], period: float) -> FansState:
    """Return the wind and the turbulence one period (s) later; `noise` contains standard normal samples."""
    local = local_air(state, jets)
    decay = exp(-period * local.rate)
    noise_gain = sqrt(maximum(1.0 - decay * decay, _MIN_SQUARE))
    next_eddies = Eddies._make(decay * eddy + noise_gain * number for eddy, number in zip(eddies, noise, strict=True))
    return FansState(_with_turbulence(local, next_eddies), next_eddies)


def _with_turbulence(local: LocalAir, eddies: Eddies) -> Wind:
    """Return the mean velocity of the jets plus their turbulence, m/s."""
    deviation = sqrt(maximum(local.variance, _MIN_SQUARE))
    return Wind._make(mean + deviation * eddy for mean, eddy in zip(local.mean, eddies, strict=True))


@fleet_system(float, AutoDiffXd)
class Fans(FleetSystem):
    """Wind of several fans in a room.

    .. pydrake_system::

        name: Fans
        input_ports:
        - state
        - jet_noise
        output_ports:
        - wind

    `wind` is the sum of the mean velocities of all jets at the position of the vehicle, plus turbulence. The turbulence
    is isotropic, and a first-order Gauss–Markov process in time. Its variance is the sum of the variances of the jets.
    Its decay rate is the sum of the rates of the jets. The rate of a jet is the ratio of its speed to its half-width,
    about the inverse of the time in which an eddy passes.

    `jet_noise` is a random input with new standard normal samples at every sampling instant. A simulator that continues
    a flight must suppress initialization events, which reset the turbulence.

    The states are `wind` and `eddies`. The only parameter of the context is `jets`.

    Args:
        num_vehicles: number N of vehicles. The turbulence of each vehicle is independent of the others.
        period: sampling interval, s; equal to the vehicle's time step.
        parameters: jets of the fans.
    """

    def declare(self, *, period: float = 0.01, parameters: tuple[Jet, ...]) -> None:
        """Declare the ports, states and parameters of this system."""
        jets, state = self.parameter("jets", lambda jets: jets), self.input("state")
        noise = self.random_input("jet_noise", Eddies, RandomDistribution.kGaussian, period=period)
        wind = self.state("wind", lambda _: Wind(0.0, 0.0, 0.0))
        eddies = self.state("eddies", lambda _: Eddies(0.0, 0.0, 0.0))
        self.initialize(first_sample, state, noise, jets, writes=[wind, eddies])
        # The initialization event already uses the random samples of time zero, so updates begin one period later.
        self.update(period, next_sample, state, eddies, noise, jets, period, writes=[wind, eddies], at_start=False)
        self.state_output(wind)
