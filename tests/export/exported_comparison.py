"""Comparison of exported C code with the diagram from which it was exported, on random inputs."""

import numpy as np
from pydrake.systems.analysis import Simulator

from drake_quad.assembly.control import build_control, control_recipes
from drake_quad.export.controller import export_controller
from drake_quad.exported.description import read_description
from drake_quad.exported.machines import MACHINES, HostMachine
from drake_quad.flight.mission import plan_route
from drake_quad.scenario.batch import Batch

# Standard deviation of each input, large enough to reach limits.
SCALES = {"measurement": 0.5, "state": 0.5, "reference": 0.5, "reference_jerk": 2.0, "reference_snap": 5.0}


def commands(scenario, folder, *, precision="double", machine="host", num_steps=40, seed=0):
    """Return the (ticks, components) commands of a controller, and those of its exported code, for random inputs."""
    export_controller(scenario, folder, precision=precision)
    description = read_description(folder)
    batch, plan = Batch.draw(scenario, [0]), plan_route(scenario)
    diagram = build_control(batch.scenario, control_recipes(batch, plan), 1)
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    (name,) = description.outputs
    running = MACHINES[machine](folder)
    state = HostMachine.initial_state(folder, description)
    rng, expected, actual = np.random.default_rng(seed), [], []
    simulator.Initialize()
    for step in range(num_steps):
        values = {
            port: rng.normal(scale=SCALES[port], size=rows).astype(description.number_type).astype(float)
            for port, rows in description.inputs.items()
        }
        for port, value in values.items():
            diagram.GetInputPort(port).FixValue(context, value)
        inputs = np.concatenate(list(values.values())).astype(description.number_type)
        expected_now = diagram.GetOutputPort(name).Eval(context).copy()
        state, outputs = running.step(state, inputs.tobytes())
        if step % description.output_divisor == 0:
            expected.append(expected_now)
            actual.append(np.frombuffer(outputs, description.number_type).astype(float))
        # Drake updates the state at the beginning of a step, with the inputs that were just fixed.
        simulator.AdvanceTo((step + 1) * description.period)
    return np.array(expected), np.array(actual)
