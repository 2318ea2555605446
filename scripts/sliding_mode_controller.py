"""Fly the figure eight under a position controller of your own, a sliding mode, and under the scenario's PD."""

import math

from pydrake.systems.framework import BasicVector, Context, LeafSystem

from drake_quad import load_scenario, simulate
from drake_quad.signals import Acceleration, Reference, State


class SlidingMode(LeafSystem):
    """u = a_r + η tanh(s / w) + λ ė with s = ė + λ e: a boundary layer in place of the sign."""

    def __init__(self) -> None:
        super().__init__()
        self.measurement = self.DeclareVectorInputPort("measurement", BasicVector(len(State._fields)))
        self.reference = self.DeclareVectorInputPort("reference", BasicVector(len(Reference._fields)))
        self.DeclareVectorOutputPort("acceleration_command", BasicVector(len(Acceleration._fields)), self.command)

    def command(self, context: Context, output: BasicVector) -> None:
        """Computes the commanded acceleration."""
        state, reference = State(*self.measurement.Eval(context)), Reference(*self.reference.Eval(context))
        command = Acceleration(
            x=reference.a_x + sliding_mode(reference.x - state.x, reference.v_x - state.v_x),
            y=reference.a_y + sliding_mode(reference.y - state.y, reference.v_y - state.v_y),
            z=reference.a_z + sliding_mode(reference.z - state.z, reference.v_z - state.v_z),
        )
        output.SetFromVector(command)


def sliding_mode(error: float, error_rate: float) -> float:
    """η tanh(s / w) + λ ė with η = 0.4 m/s², w = 0.4 m/s and λ = 0.8 1/s."""
    surface = error_rate + 0.8 * error
    return 0.8 * error_rate + 0.4 * math.tanh(surface / 0.4)


if __name__ == "__main__":
    scenario = load_scenario("figure_eight")
    for name, controller in {scenario.cascade.position.kind: None, "sliding mode": SlidingMode()}.items():
        flight = simulate(scenario, position_controller=controller)
        print(f"RMSE, {name}: {100.0 * flight.metrics.rmse:.2f} cm")
