"""Model predictive control as a Drake system."""

from types import MethodType

import numpy as np
from pydrake.systems.framework import BasicVector, Context

from drake_quad.control.lqg.design import Regulator
from drake_quad.control.lqg.laws import ChainCommands, LqgParameters
from drake_quad.control.lqg.system import deviation_layout
from drake_quad.control.mpc.constraints import Corridor, Horizon, Preview, horizontal_constraints, vertical_constraints
from drake_quad.control.mpc.programme import Programme
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.framework.records import layout_of
from drake_quad.geometry.per_axis import PerAxis

NO_WALLS = Corridor(
    PerAxis(-np.inf, -np.inf, -np.inf), PerAxis(np.inf, np.inf, np.inf), follows_reference=True, weight=1.0
)
"""Corridor without walls."""


@fleet_system(float, AutoDiffXd)
class PredictiveProgramme(FleetSystem):
    """Perturbations of a regulator's commands that satisfy limits over a horizon.

    .. pydrake_system::

        name: PredictiveProgramme
        input_ports:
        - deviation
        output_ports:
        - perturbation

    The ports are connected to the ports of the same names of a `LinearQuadraticGaussian`. The system contains two
    quadratic programmes, one for X and Y and one for Z (`drake_quad.control.mpc.programme`). They are built once. At
    each tick, they are solved for those vehicles for which the unperturbed regulator would violate a limit; for other
    vehicles the perturbation is zero. The system has no state. With AutoDiffXd the derivatives are computed for fixed
    active constraints.

    Args:
        num_vehicles: number of vehicles N.
        tick: control period, s.
        num_ticks: length of the horizon in ticks.
        nominal: parameters of the regulator, the same for all vehicles.
        lateral: regulator along X and along Y.
        vertical: regulator along Z.
        preview: reference at each tick; the last one is repeated.
        corridor: corridor for the vehicle.
        tilt_weight: weight ζ of the squared excess over the tilt limit at a tick, in units of g.
    """

    def declare(
        self,
        *,
        tick: float = 0.02,
        num_ticks: int = 30,
        nominal: LqgParameters,
        lateral: Regulator,
        vertical: Regulator,
        preview: tuple[Preview, ...],
        corridor: Corridor = NO_WALLS,
        tilt_weight: float = 10.0,
    ) -> None:
        """Declare the ports, states and parameters of this system."""
        layout = layout_of(Preview)
        columns = np.transpose([layout.flatten(each) for each in preview])
        horizon = Horizon(nominal, layout.build(list(columns)), corridor, tilt_weight, num_ticks, tick)
        horizontal_programme = Programme(list(horizontal_constraints(lateral, horizon)), lateral.weight)
        vertical_programme = Programme(list(vertical_constraints(vertical, horizon)), vertical.weight)
        deviation = self.input("deviation", layout=deviation_layout(nominal))

        def calc(system: FleetSystem, context: Context, output: BasicVector) -> None:
            time = context.get_time() if system.scalar is float else context.get_time().value()
            rows = deviation.vector(system, context).CopyToVector().reshape(-1, system.num_vehicles)
            x, y, z, correction = deviation.layout.build(rows)
            tick_number = round(time / tick)
            perturbations = [
                *horizontal_programme.perturbations(tick_number, np.array([*x, *y]), np.array(correction)),
                *vertical_programme.perturbations(tick_number, np.array(z), np.array(correction)),
            ]
            output.SetFromVector(np.ravel(perturbations).astype(system.scalar))

        model, dependencies = self._model(layout_of(ChainCommands)), {deviation.ticket(self), self.time_ticket()}
        self.DeclareVectorOutputPort("perturbation", model, MethodType(calc, self), dependencies)
