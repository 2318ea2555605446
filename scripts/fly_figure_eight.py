"""Fly the figure eight in Drake's Simulator, print its errors, and write a recording for the browser.

The closed loop of a scenario is a Drake diagram. This script adds it to a larger diagram with a visualizer and a log.
"""

from pathlib import Path

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput

from drake_quad import build_tracking_diagram, load_scenario, plan_route
from drake_quad.visualization.replay.scene import local_meshcat
from drake_quad.visualization.replay.visualizer import QuadrotorVisualizer

scenario = load_scenario("figure_eight", ["vehicle.mass=0.7"])  # kg; the controller assumes 0.68 kg
plan = plan_route(scenario)

builder = DiagramBuilder()
loop = builder.AddNamedSystem("loop", build_tracking_diagram(scenario, plan=plan))
meshcat = local_meshcat()
QuadrotorVisualizer.add_to_builder(builder, meshcat, scenario, loop, plan=plan)
logger = LogVectorOutput(loop.GetOutputPort("state"), builder, publish_period=0.02)

simulator = Simulator(builder.Build())
meshcat.StartRecording()
simulator.AdvanceTo(plan.duration)
meshcat.PublishRecording()

log = logger.FindLog(simulator.get_context())
# Drake logs before it updates discrete states, so each logged state belongs to the previous time step.
planned = plan.derivative(0).vector_values(log.sample_times() - scenario.vehicle.time_step)
error = np.linalg.norm(log.data()[:3] - planned, axis=0)
print(f"RMSE {100.0 * np.sqrt(np.mean(error**2)):.2f} cm, largest error {100.0 * error.max():.2f} cm")
page = Path("out/figure_eight.html")
page.parent.mkdir(exist_ok=True)
page.write_text(meshcat.StaticHtml(), encoding="utf-8")
print(f"open {page} in a browser")
