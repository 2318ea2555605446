"""Linearise a vehicle around hover, choose PD gains by the poles, and compare a step of 0.5 m with the linear model.

The script chooses the fastest attitude loop that the rotor lag allows. The position loop is six times slower.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import scipy.linalg
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import AffineSystem, Linearize, LogVectorOutput

from drake_quad import build_vehicle, load_scenario
from drake_quad.signals import State, Wrench

scenario = load_scenario("hover", ["vehicle.time_step=0"])
nominal, damping = scenario.nominal, 0.8
vehicle = build_vehicle(scenario)
context, command = vehicle.CreateDefaultContext(), vehicle.GetInputPort("rotor_speed_command")
hover, speeds = (vehicle.GetOutputPort(name).Eval(context) for name in ("state", "rotor_speed"))
command.FixValue(context, speeds)
model = Linearize(vehicle, context, command.get_index(), vehicle.GetOutputPort("state").get_index())
b, d, arm = nominal.thrust_factor, nominal.drag_factor, nominal.arm_length * nominal.thrust_factor
wrench_of_speeds = 2.0 * speeds * np.array([[b, b, b, b], [0, -arm, 0, arm], [-arm, 0, arm, 0], [d, -d, d, -d]])


def pd(e: State, fast: float) -> Wrench:
    """Return the wrench for a deviation e from hover. The attitude loop has the natural frequency `fast` (rad/s)."""
    slow, g = fast / 6.0, nominal.gravity
    a_x, a_y, a_z = (-slow * (slow * p + 2.0 * damping * v) for p, v in ((e.x, e.v_x), (e.y, e.v_y), (e.z, e.v_z)))
    angles = np.array([-a_y / g - e.roll, a_x / g - e.pitch, -e.yaw])
    turns = fast * (fast * angles - 2.0 * damping * np.array([e.p, e.q, e.r]))
    return Wrench(nominal.mass * a_z, *(nominal.inertia * turns))


for fast in np.arange(15.0, 1.0, -0.1):
    K = np.linalg.solve(wrench_of_speeds, np.column_stack([pd(State(*unit), fast) for unit in np.eye(12)]))
    loop = model.A() + model.B() @ K @ model.C()
    poles = np.linalg.eigvals(loop)
    if np.all(-poles.real > 0.5 * np.abs(poles)):  # the damping ratio of all poles exceeds 0.5
        break
for name, rate in (("attitude", fast), ("position", fast / 6.0)):
    print(f"{name}: k_p {rate**2:.2f} 1/s², k_d {2.0 * damping * rate:.2f} 1/s")
builder = DiagramBuilder()
builder.AddSystem(vehicle)
law = builder.AddSystem(AffineSystem(D=K, y0=speeds - K @ hover))
builder.Connect(vehicle.GetOutputPort("state"), law.get_input_port())
builder.Connect(law.get_output_port(), command)
logger = LogVectorOutput(vehicle.GetOutputPort("state"), builder, publish_period=0.05)
simulator = Simulator(builder.Build())
simulator.get_mutable_context().get_mutable_continuous_state_vector()[0] -= 0.5
simulator.AdvanceTo(6.0)
log = logger.FindLog(simulator.get_context())
linear = [-0.5 * scipy.linalg.expm(time * loop)[0, 0] for time in log.sample_times()]
plt.plot(log.sample_times(), log.data()[0], log.sample_times(), linear, "--")
plt.gca().set(xlabel="time (s)", ylabel="x (m)", title="flown, and linear model (dashed)")
Path("out").mkdir(exist_ok=True)
plt.savefig("out/step_along_x.png")
