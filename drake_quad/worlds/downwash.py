"""Drake system of the downwash between the vehicles of a world."""

from drake_quad.framework.elementary import where
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.framework.records import layout_of
from drake_quad.signals import Crashed, Row, State
from drake_quad.vehicle.downwash import CRAZYFLIE_DOWNWASH, DownwashParameters, downwash_force
from drake_quad.vehicle.external_load import ExternalLoad
from drake_quad.worlds.vehicles import states_and_crashed, vehicle_inputs


def downwash_load(index: int, parameters: DownwashParameters, *vehicles: State | Crashed) -> ExternalLoad:
    """Return the load on a vehicle from all other vehicles that fly.

    Args:
        index: index of the vehicle.
        parameters: coefficients of the downwash.
        vehicles: values of the inputs that `vehicle_inputs` declared.
    """
    states, crashed = states_and_crashed(vehicles)
    force: Row = 0.0
    for other in range(len(states)):
        if other != index:
            force = force + where(crashed[other] >= 1.0, 0.0, downwash_force(states[index], states[other], parameters))
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
        vehicles = vehicle_inputs(self, count)
        for k in range(count):
            self.output(f"external_load_{k + 1}", downwash_load, k, given, *vehicles, layout=layout_of(ExternalLoad))
