"""Track the figure eight with Drake's time-varying linear-quadratic regulator for the nonlinear vehicle.

The regulator receives the true state and commands the rotors. The vehicle starts 0.5 m away from the reference.
"""

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.controllers import (
    FiniteHorizonLinearQuadraticRegulatorOptions,
    MakeFiniteHorizonLinearQuadraticRegulator,
)
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput, Multiplexer
from pydrake.trajectories import PiecewisePolynomial

from drake_quad import build_vehicle, load_scenario, plan_route
from drake_quad.planning.nominal import nominal_parameters
from drake_quad.signals import Jerk, Reference, Snap, State
from drake_quad.vehicle.inverse_dynamics import rotor_demand

HORIZON = 6.0  # s, duration of the flight
# The LQR assigns the same cost to each of these errors (m, rad, m/s, rad/s) and commands (rad/s).
ERROR_SCALES = np.array([*State(0.05, 0.05, 0.05, 0.2, 0.2, 0.2, 0.5, 0.5, 0.5, 2.0, 2.0, 2.0), *4 * [100.0]])
COMMAND_SCALES = np.array(4 * [30.0])

# States and rotor speeds along the plan follow from differential flatness. Commands compensate for the rotor lag.
scenario = load_scenario("figure_eight", ["vehicle.time_step=0"])
plan = plan_route(scenario)
times = np.linspace(0.0, HORIZON, 300)
rows = plan.reference().vector_values(times)
demand = rotor_demand(Reference(*rows[:11]), Jerk(*rows[11:14]), Snap(*rows[14:]), nominal_parameters(scenario))
speeds = np.array(demand.rotor_speed)
states = np.vstack([rows[:3], demand.attitude, rows[3:6], demand.body_rates, speeds])
commands = speeds + scenario.vehicle.rotor_time_constant * np.gradient(speeds, times, axis=1)

builder = DiagramBuilder()
vehicle = builder.AddSystem(build_vehicle(scenario))
options = FiniteHorizonLinearQuadraticRegulatorOptions()
options.x0 = PiecewisePolynomial.CubicShapePreserving(times, states)
options.u0 = PiecewisePolynomial.CubicShapePreserving(times, commands)
options.input_port_index = vehicle.GetInputPort("rotor_speed_command").get_index()
options.Qf = np.diag(ERROR_SCALES**-2)
cost = np.diag(ERROR_SCALES**-2), np.diag(COMMAND_SCALES**-2)
regulator = builder.AddSystem(
    MakeFiniteHorizonLinearQuadraticRegulator(vehicle, vehicle.CreateDefaultContext(), 0.0, HORIZON, *cost, options)
)
state = builder.AddSystem(Multiplexer([12, 4]))
builder.Connect(vehicle.GetOutputPort("state"), state.get_input_port(0))
builder.Connect(vehicle.GetOutputPort("rotor_speed"), state.get_input_port(1))
builder.Connect(state.get_output_port(), regulator.get_input_port())
builder.Connect(regulator.get_output_port(), vehicle.GetInputPort("rotor_speed_command"))
log = LogVectorOutput(vehicle.GetOutputPort("state"), builder, publish_period=0.01)
simulator = Simulator(builder.Build())
simulator.get_mutable_context().SetContinuousState(states[:, 0] + [0.0, 0.5, *14 * [0.0]])
simulator.AdvanceTo(HORIZON)
state_log = log.FindLog(simulator.get_context())
errors = state_log.data()[:3] - plan.reference().vector_values(state_log.sample_times())[:3]
for time, distance in zip(state_log.sample_times()[::100], np.linalg.norm(errors, axis=0)[::100], strict=True):
    print(f"{time:.0f} s: {100.0 * distance:.3f} cm from the reference")
