"""Drake system of the downwash between the vehicles of a world."""

from drake_quad.framework.elementary import where
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.framework.records import layout_of
from drake_quad.signals import Crashed, Row, State
from drake_quad.vehicle.downwash import CRAZYFLIE_DOWNWASH, DownwashParameters, downwash_force
from drake_quad.vehicle.external_load import ExternalLoad


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
