"""Build the closed loop block by block with DiagramBuilder, fly it, and log and plot the path of the vehicle.

The blocks are a position PD, thrust vectoring, an attitude PD, and the laboratory.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput, Multiplexer

from drake_quad import build_laboratory_diagram, load_scenario, plan_route
from drake_quad.control.attitude import AttitudeController, AttitudeParameters
from drake_quad.control.position import PdGains, ProportionalDerivative, build_position_controller
from drake_quad.control.thrust_vectoring import ThrustLimits, ThrustVectoring, VectoringParameters
from drake_quad.framework.wiring import split_output
from drake_quad.geometry.per_axis import PerAngle, PerAxis
from drake_quad.planning.nominal import nominal_parameters
from drake_quad.reference.source import build_reference

scenario = load_scenario("laboratory:low_wind")
plan, nominal = plan_route(scenario), nominal_parameters(scenario)
gains = PdGains(k_p=PerAxis(1.0, 1.0, 6.0), k_d=PerAxis(1.5, 1.5, 3.5))
limits = ThrustLimits(tan_max_tilt=0.7, min_thrust=2.0, max_thrust=12.0)  # N; hover takes 6.7 N
angles = AttitudeParameters(PerAngle(25.0, 25.0, 5.0), PerAngle(8.0, 8.0, 3.5), *nominal.inertia)

builder = DiagramBuilder()
reference = builder.AddSystem(build_reference(plan))
position = builder.AddSystem(build_position_controller(ProportionalDerivative(feeds_forward=True, parameters=gains)))
vectoring = ThrustVectoring(parameters=VectoringParameters(nominal.mass, nominal.gravity, limits))
commands = split_output(builder, "vectoring", vectoring)  # adds the system and splits its output into signals
attitude = builder.AddSystem(AttitudeController(parameters=angles))
wrench = builder.AddSystem(Multiplexer([1, 3]))
laboratory = builder.AddSystem(build_laboratory_diagram(scenario))
for system in (position, vectoring):
    builder.Connect(reference.GetOutputPort("reference"), system.GetInputPort("reference"))
for name in ("reference_jerk", "reference_snap"):
    builder.Connect(reference.GetOutputPort(name), vectoring.GetInputPort(name))
for system in (position, vectoring, attitude):
    builder.Connect(laboratory.GetOutputPort("measurement"), system.GetInputPort("measurement"))
builder.Connect(position.GetOutputPort("acceleration_command"), vectoring.GetInputPort("acceleration_command"))
for name in ("attitude_command", "body_rate_command", "angular_acceleration_command"):
    builder.Connect(commands[name], attitude.GetInputPort(name))
builder.Connect(commands["thrust"], wrench.get_input_port(0))
builder.Connect(attitude.GetOutputPort("torque"), wrench.get_input_port(1))
builder.Connect(wrench.get_output_port(), laboratory.GetInputPort("wrench"))
logger = LogVectorOutput(laboratory.GetOutputPort("state"), builder, publish_period=0.02)

simulator = Simulator(builder.Build())
simulator.AdvanceTo(plan.duration)
log = logger.FindLog(simulator.get_context())
# Drake logs before it updates discrete states, so each logged state belongs to the previous time step.
simulated, planned = log.data()[:3], plan.derivative(0).vector_values(log.sample_times() - scenario.vehicle.time_step)
print(f"RMSE {100.0 * np.sqrt(np.mean(np.sum((simulated - planned) ** 2, axis=0))):.1f} cm in low wind")
plt.plot(*planned[:2], "--", *simulated[:2])
plt.gca().set(xlabel="x (m)", ylabel="y (m)", aspect="equal", title="planned (dashed) and flown")
Path("out").mkdir(exist_ok=True)
plt.savefig("out/path.png")
