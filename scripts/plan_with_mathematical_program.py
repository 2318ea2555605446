"""Plan a path through three gates with a MathematicalProgram, and fly it.

The path is a B-spline of degree 7 that minimises the sum of the squared snap at 200 instants. The speed along each axis
is limited by limits on the control points of the derivative, since a spline lies in the convex hull of these points.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from pydrake.math import BsplineBasis, KnotVectorType
from pydrake.solvers import MathematicalProgram, Solve
from pydrake.trajectories import BsplineTrajectory

from drake_quad import load_scenario, simulate
from drake_quad.reference.plan import Plan
from drake_quad.reference.polynomial_path import hermite_path

DURATION = 10.0  # s
MAX_SPEED = 1.2  # m/s, along each axis
NUM_POINTS = 24  # control points
START, END = np.array([0.0, 0.0, 1.0]), np.array([5.0, 0.0, 1.0])
GATES = {2.5: [1.0, 1.5, 1.5], 5.0: [2.5, -1.0, 2.0], 7.5: [4.0, 1.0, 1.2]}  # centre (m) by time of passage (s)
TOLERANCE = np.array([0.02, 0.3, 0.3])  # m, largest distance from the centre of a gate along x, y and z

basis = BsplineBasis(8, NUM_POINTS, KnotVectorType.kClampedUniform, 0.0, DURATION)
spline = BsplineTrajectory(basis, np.zeros((NUM_POINTS, 3, 1)))
program = MathematicalProgram()
points = program.NewContinuousVariables(NUM_POINTS, 3)
end_rows = [spline.EvaluateLinearInControlPoints(time, order) for time in (0.0, DURATION) for order in range(4)]
gate_rows = [spline.EvaluateLinearInControlPoints(time, 0) for time in GATES]
snap_rows = np.array([spline.EvaluateLinearInControlPoints(time, 4) for time in np.linspace(0.0, DURATION, 200)])
speed_rows = spline.AsLinearInControlPoints(1).toarray().T
still, centres = np.zeros((3, 3)), np.array([*GATES.values()])
for axis in range(3):
    at_rest = np.vstack([START, still, END, still])[:, axis]
    program.AddLinearEqualityConstraint(np.array(end_rows), at_rest, points[:, axis])
    low, high = centres[:, axis] - TOLERANCE[axis], centres[:, axis] + TOLERANCE[axis]
    program.AddLinearConstraint(np.array(gate_rows), low, high, points[:, axis])
    limit = np.full(len(speed_rows), MAX_SPEED)
    program.AddLinearConstraint(speed_rows, -limit, limit, points[:, axis])
    program.AddQuadraticCost(snap_rows.T @ snap_rows, np.zeros(NUM_POINTS), points[:, axis])
result = Solve(program)
assert result.is_success()
spline = BsplineTrajectory(basis, result.GetSolution(points)[:, :, np.newaxis])

# The spline is a polynomial of degree 7 between two knots. Position, velocity, acceleration and jerk at both knots
# determine this polynomial.
times = np.unique(basis.knots())
knots = np.array([[spline.EvalDerivative(time, order).ravel() for order in range(4)] for time in times])
plan = Plan.with_constant_yaw(hermite_path(times, knots))
flight = simulate(load_scenario("figure_eight", ["metrics.start=0"]), plan=plan)
planned, simulated = flight.record("reference"), flight.record("state")
print(f"maximum speed {np.linalg.norm([planned.v_x, planned.v_y, planned.v_z], axis=0).max():.2f} m/s")
print(f"RMSE of the flight {100.0 * flight.metrics.rmse:.2f} cm")
plt.plot(planned.x, planned.y, "--", simulated.x, simulated.y)
plt.errorbar(centres[:, 0], centres[:, 1], TOLERANCE[1], fmt="none", linewidth=3, color="0.5")
plt.gca().set(xlabel="x (m)", ylabel="y (m)", aspect="equal", title="plan (dashed) and flight through three gates")
Path("out").mkdir(exist_ok=True)
plt.savefig("out/plan_with_mathematical_program.png")
