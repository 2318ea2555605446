"""Flies the figure eight under a position controller of your own, beside the scenario's PD."""

from command_line import parser, print_table, run, scenario_of

import numpy as np
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from drake_quad import simulate


class SlidingMode(LeafSystem):
    """u = a_r + η tanh(s / w) + λ ė with s = ė + λ e: a boundary layer in place of the sign."""

    def __init__(self) -> None:
        super().__init__()
        self.measurement = self.DeclareVectorInputPort("measurement", BasicVector(12))
        self.reference = self.DeclareVectorInputPort("reference", BasicVector(11))
        self.DeclareVectorOutputPort("acceleration_command", BasicVector(3), self.command)

    def command(self, context: Context, output: BasicVector) -> None:
        measurement, reference = self.measurement.Eval(context), self.reference.Eval(context)
        error, error_rate = reference[0:3] - measurement[0:3], reference[3:6] - measurement[6:9]
        surface = error_rate + 0.8 * error
        output.SetFromVector(reference[6:9] + 0.8 * error_rate + 0.4 * np.tanh(surface / 0.4))


def main() -> None:
    arguments = parser(
        description=__doc__,
        example="python scripts/bring_your_own_controller.py diagrams/figure_eight.yaml",
        output=None,
        scenario="figure_eight.yaml",
    ).parse_args()
    scenario = scenario_of(arguments)
    flights = {
        f"RMSE, {scenario.control.position.kind} of the scenario": simulate(scenario),
        "RMSE, sliding mode": simulate(scenario, position_controller=SlidingMode()),
    }
    print_table([(name, f"{100.0 * flight.metrics.rmse:.2f}", "cm") for name, flight in flights.items()])


if __name__ == "__main__":
    run(main)
