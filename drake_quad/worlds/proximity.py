"""Distances between the vehicles of a world."""

from functools import reduce
from typing import Annotated, NamedTuple

import numpy as np
from pydrake.systems.framework import Context

from drake_quad.framework.elementary import minimum, sqrt, where
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.framework.records import layout_of
from drake_quad.laboratory.flight_monitor import Clearance
from drake_quad.signals import Crashed, Quantity, Row, State
from drake_quad.worlds.vehicles import states_and_crashed, vehicle_inputs

# Distance if there is no other flying vehicle, m. Recorded signals must be finite.
_FAR = 1e9


class Radii(NamedTuple):
    """Radii of the spheres around the vehicles of a world.

    Attributes:
        values: radius of each sphere.
    """

    values: tuple[Annotated[Row, Quantity("m", sign="nonnegative")], ...]


def clearance(index: int, radii: Radii, *vehicles: State | Crashed) -> Clearance:
    """Return the distance between the spheres around a vehicle and around the nearest other vehicle that flies.

    Args:
        index: index of the vehicle.
        radii: radii of the spheres.
        vehicles: values of the inputs that `vehicle_inputs` declared.
    """
    states, crashed = states_and_crashed(vehicles)
    own = states[index]
    nearest: Row = _FAR
    for other, state in enumerate(states):
        if other != index:
            x, y, z = state.x - own.x, state.y - own.y, state.z - own.z
            distance = sqrt(x * x + y * y + z * z) - (radii.values[index] + radii.values[other])
            # A comparison with NaN is false, so a vehicle whose state is NaN does not affect the others.
            nearest = where((crashed[other] < 1.0) & (distance < nearest), distance, nearest)
    return Clearance(nearest)


class Clearances(NamedTuple):
    """Smallest clearances of the vehicles of a world.

    Attributes:
        values: clearance of each vehicle, m.
    """

    values: tuple[Row, ...]


def smallest_clearances(before: Clearances, radii: Radii, *vehicles: State | Crashed) -> Clearances:
    """Return the smallest clearance of each vehicle so far. A vehicle that has crashed keeps its value.

    Args:
        before: smallest clearances before this tick.
        radii: radii of the spheres.
        vehicles: values of the inputs that `vehicle_inputs` declared.
    """
    _, crashed = states_and_crashed(vehicles)
    values = [
        where(crashed[k] >= 1.0, value, minimum(value, clearance(k, radii, *vehicles).distance))
        for k, value in enumerate(before.values)
    ]
    return Clearances(tuple(values))


@fleet_system(float, AutoDiffXd)
class Proximity(FleetSystem):
    """Distance of each vehicle of a world from the nearest other vehicle, and whether all vehicles have crashed.

    .. pydrake_system::

        name: Proximity
        input_ports:
        - state_1
        - state_2
        - crashed_1
        - crashed_2
        output_ports:
        - clearance_1
        - clearance_2
        - crashed

    The diagram shows the ports for two vehicles in a world. `crashed` is 1 if all vehicles have crashed. At every tick,
    the state `smallest` is updated, the smallest clearance of each vehicle so far.

    Args:
        num_vehicles: number N of worlds.
        count: number of vehicles in a world.
        period: tick period, s.
        parameters: radii of the spheres around the vehicles.
    """

    def declare(self, *, count: int = 2, period: float = 0.02, parameters: Radii) -> None:
        """Declare the ports, states and parameters of this system."""
        radii = self.parameter("radii", lambda parameters: parameters)
        vehicles = vehicle_inputs(self, count)
        for k in range(count):
            self.output(f"clearance_{k + 1}", clearance, k, radii, *vehicles, layout=layout_of(Clearance))
        self.output("crashed", _all_crashed, *vehicles)
        smallest = self.state("smallest", lambda _: Clearances((_FAR,) * count))
        self.update(period, smallest_clearances, smallest, radii, *vehicles, writes=[smallest])

    def smallest_clearances(self, context: Context) -> np.ndarray:
        """Return the (count, N) smallest clearances of the vehicles up to the current time, m."""
        vector = self.states["smallest"].vector(self, context).CopyToVector()
        result: np.ndarray = vector.reshape(-1, self.num_vehicles)
        return result


def _all_crashed(*vehicles: State | Crashed) -> Crashed:
    _, crashed = states_and_crashed(vehicles)
    return Crashed(reduce(minimum, crashed))
