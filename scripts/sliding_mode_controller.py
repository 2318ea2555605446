"""Write a sliding-mode position controller as a Drake system, and compare it with the PD of scenario figure_eight."""

from typing import Any

import numpy as np
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from drake_quad import load_scenario, simulate
from drake_quad.signals import Acceleration, Reference, State


class SlidingMode(LeafSystem):
    """Sliding-mode controller u = a_r + η tanh(s / w) + λ ė with s = ė + λ e.

    The function tanh approximates the sign function without chattering.
    """

    def __init__(self, num_vehicles: int = 1) -> None:
        super().__init__()
        sizes = [num_vehicles * len(record._fields) for record in (State, Reference, Acceleration)]
        self.measurement = self.DeclareVectorInputPort("measurement", sizes[0])
        self.reference = self.DeclareVectorInputPort("reference", sizes[1])
        self.DeclareVectorOutputPort("acceleration_command", sizes[2], self.command)

    def command(self, context: Context, output: BasicVector) -> None:
        """Compute the commanded acceleration of each vehicle."""
        state = State(*self.measurement.Eval(context).reshape(len(State._fields), -1))
        reference = Reference(*self.reference.Eval(context).reshape(len(Reference._fields), -1))
        command = Acceleration(
            x=reference.a_x + sliding_mode(reference.x - state.x, reference.v_x - state.v_x),
            y=reference.a_y + sliding_mode(reference.y - state.y, reference.v_y - state.v_y),
            z=reference.a_z + sliding_mode(reference.z - state.z, reference.v_z - state.v_z),
        )
        output.SetFromVector(np.ravel(command))


def sliding_mode(error: Any, error_rate: Any) -> Any:
    """Return η tanh(s / w) + λ ė for one axis, with η = 0.4 m/s², w = 0.4 m/s and λ = 0.8 1/s."""
    surface = error_rate + 0.8 * error
    return 0.8 * error_rate + 0.4 * np.tanh(surface / 0.4)


if __name__ == "__main__":
    scenario = load_scenario("figure_eight")
    for name, controller in {scenario.cascade.position.kind: None, "sliding mode": SlidingMode()}.items():
        flight = simulate(scenario, position_controller=controller)
        print(f"RMSE, {name}: {100.0 * flight.metrics.rmse:.2f} cm")
