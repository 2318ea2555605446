"""Downwash of other vehicles.

The model is that of gym-pybullet-drones (J. Panerati et al., "Learning to fly", IROS 2021; function `_downwash`). A
vehicle at the height Δz below another one, and at the horizontal distance d, is pushed along -z_B by the force

    F = α exp(-½ (d / β)²),   α = c₁ (r / (4 Δz))²,   β = c₂ Δz + c₃

with the radius r of the other vehicle's propellers. The forces of several vehicles are added.

α is infinite at Δz = 0, where the vehicles are side by side and the formula is not meant to hold. Below a smallest
height, the force is therefore that at this height, multiplied by the ratio of the heights.
"""

from typing import Annotated, NamedTuple

from drake_quad.framework.elementary import exp, maximum, minimum, where
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.framework.records import layout_of
from drake_quad.signals import Crashed, Number, Quantity, Row, State
from drake_quad.vehicle.external_load import ExternalLoad

_MAX_DISTANCE = 10.0  # m; vehicles at a larger horizontal distance have no downwash


class DownwashParameters(NamedTuple):
    """Coefficients of the downwash; the defaults are those of the Crazyflie 2 in gym-pybullet-drones (`cf2x.urdf`).

    Attributes:
        force: factor c₁ of the force.
        spread: increase c₂ of the radius with the height.
        offset: radius c₃ at the height 0.
        propeller_radius: radius r of a propeller.
        min_height: height below which the force is proportional to the height; the default is an assumption.
    """

    force: Annotated[Row, Quantity("N", sign="nonnegative")] = 2267.18
    spread: Number = 0.16
    offset: Annotated[Row, Quantity("m")] = -0.11
    propeller_radius: Annotated[Row, Quantity("m", sign="nonnegative")] = 2.31348e-2
    min_height: Annotated[Row, Quantity("m", sign="positive")] = 0.2


CRAZYFLIE_DOWNWASH = DownwashParameters()


def downwash_force(lower: State, upper: State, parameters: DownwashParameters) -> Row:
    """Return the force with which a vehicle pushes another one down, N; 0 if it does not fly above it."""
    x, y, z = upper.x - lower.x, upper.y - lower.y, upper.z - lower.z
    squared_distance = x * x + y * y
    is_pushed = (z > 0.0) & (squared_distance < _MAX_DISTANCE * _MAX_DISTANCE)
    height = maximum(z, parameters.min_height)
    ratio = parameters.propeller_radius / (4.0 * height)
    radius = parameters.spread * height + parameters.offset
    force = parameters.force * ratio * ratio * exp(-0.5 * squared_distance / (radius * radius))
    return where(is_pushed, minimum(z / parameters.min_height, 1.0) * force, 0.0)


def downwash_load(index: int, count: int, parameters: DownwashParameters, *inputs: State | Crashed) -> ExternalLoad:
    """Return the load on a vehicle from all other vehicles that fly.

    Args:
        index: index of the vehicle.
        count: number of vehicles.
        parameters: coefficients of the downwash.
        inputs: states of all vehicles, and then whether each of them has crashed.
    """
    states, crashed = inputs[:count], inputs[count:]
    force: Row = 0.0
    for other in range(count):
        if other != index:
            pushes = downwash_force(states[index], states[other], parameters)  # type: ignore[arg-type]
            force = force + where(crashed[other].crashed >= 1.0, 0.0, pushes)  # type: ignore[union-attr]
    return ExternalLoad(f_z=-force)


@fleet_system(float, AutoDiffXd)
class Downwash(FleetSystem):
    """Downwash between the vehicles of a world.

    .. pydrake_system::

        name: Downwash
        input_ports:
        - state_1
        - state_2
        - crashed_1
        - crashed_2
        output_ports:
        - external_load_1
        - external_load_2

    The diagram shows the ports for two vehicles in a world. Vehicles that have crashed cause no downwash. The only
    parameter of the context is `parameters`.

    Args:
        num_vehicles: number N of worlds.
        count: number of vehicles in a world.
        parameters: coefficients of the downwash.
    """

    def declare(self, *, count: int = 2, parameters: DownwashParameters = CRAZYFLIE_DOWNWASH) -> None:
        """Declare the ports and parameters of this system."""
        given = self.parameter("parameters", lambda parameters: parameters)
        states = [self.input(f"state_{k}", layout=layout_of(State)) for k in range(1, count + 1)]
        crashed = [self.input(f"crashed_{k}", layout=layout_of(Crashed)) for k in range(1, count + 1)]
        for k in range(count):
            load = layout_of(ExternalLoad)
            self.output(f"external_load_{k + 1}", downwash_load, k, count, given, *states, *crashed, layout=load)
