"""Model predictive control as a system."""

from types import MethodType

import numpy as np
from pydrake.systems.framework import BasicVector, Context

from drake_quad.control.lqg.design import Regulator
from drake_quad.control.lqg.laws import ChainCommands, LqgNumbers
from drake_quad.control.lqg.system import deviations_of
from drake_quad.control.mpc.constraints import Corridor, Horizon, Preview, horizontal_constraints, vertical_constraints
from drake_quad.control.mpc.programme import Programme
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.framework.records import layout_of
from drake_quad.geometry.per_axis import PerAxis

OPEN = Corridor(PerAxis(-np.inf, -np.inf, -np.inf), PerAxis(np.inf, np.inf, np.inf), moves=True, weight=1.0)
"""A corridor without walls."""


@fleet_system(float, AutoDiffXd)
class PredictiveProgramme(FleetSystem):
    """What is added to a regulator's commands so that limits are kept over a horizon.

    .. pydrake_system::

        name: PredictiveProgramme
        input_ports:
        - deviation
        output_ports:
        - perturbation

    It stands beside a `LinearQuadraticGaussian` with the same ports. Two quadratic programmes, of X and Y and of Z, are
    built once and solved at a tick at which the regulator alone would break a limit, for each vehicle by itself: see
    `drake_quad.control.mpc.programme`. It remembers nothing. With AutoDiffXd the derivatives are those of the law
    around what binds: where nothing does, it adds nothing, and the law is the regulator's.

    Args:
        num_vehicles: N.
        tick: of the control, s.
        num_ticks: of the horizon.
        believed: numbers of the regulator, the same for all vehicles.
        lateral: along X, and along Y.
        vertical: along Z.
        preview: of the plan, from tick to tick; the last stays.
        corridor: to fly in.
        tilt_weight: what it costs to be beyond the tilt by g at a tick.
    """

    def declare(
        self,
        *,
        tick: float = 0.02,
        num_ticks: int = 30,
        believed: LqgNumbers,
        lateral: Regulator,
        vertical: Regulator,
        preview: tuple[Preview, ...],
        corridor: Corridor = OPEN,
        tilt_weight: float = 10.0,
    ) -> None:
        """Declares the system."""
        layout = layout_of(Preview)
        columns = np.transpose([layout.flatten(each) for each in preview])
        horizon = Horizon(believed, layout.build(list(columns)), corridor, tilt_weight, num_ticks, tick)
        level = Programme(list(horizontal_constraints(lateral, horizon)), lateral.weight)
        upright = Programme(list(vertical_constraints(vertical, horizon)), vertical.weight)
        deviation = self.input("deviation", layout=deviations_of(believed))

        def calc(system: FleetSystem, context: Context, output: BasicVector) -> None:
            time = context.get_time() if system.scalar is float else context.get_time().value()
            rows = deviation.vector(system, context).CopyToVector().reshape(-1, system.num_vehicles)
            x, y, z, correction = deviation.layout.build(rows)
            now = round(time / tick)
            added = [
                *level.added(now, np.array([*x, *y]), np.array(correction)),
                *upright.added(now, np.array(z), np.array(correction)),
            ]
            output.SetFromVector(np.ravel(added).astype(system.scalar))

        model, seen = self._model(layout_of(ChainCommands)), {deviation.ticket(self), self.time_ticket()}
        self.DeclareVectorOutputPort("perturbation", model, MethodType(calc, self), seen)
