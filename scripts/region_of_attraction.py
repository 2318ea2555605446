"""Certify a region of attraction of a planar vehicle's hover by sums of squares, and simulate from its boundary.

The loop of an LQR is polynomial in e = (x, z, s = sin θ, v_x, v_z, q) and c = 1 - cos θ. V = eᵀ S e + S_θθ c² contains
its cost-to-go S. V decreases where V < ρ if (V - ρ) (|e|² + c²) + λ V' + μ (s² + c² - 2 c) is a sum of squares.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from pydrake.solvers import ClarabelSolver, MathematicalProgram
from pydrake.symbolic import Jacobian, Polynomial, Variable, Variables, cos, sin
from pydrake.systems.analysis import Simulator
from pydrake.systems.controllers import LinearQuadraticRegulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput, SymbolicVectorSystem

from drake_quad import load_scenario

G = load_scenario("hover").nominal.gravity
# The LQR assigns the same cost to each of these errors (m, 1, m/s, rad/s) and accelerations (m/s², rad/s²).
ERROR_SCALES, COMMAND_SCALES = np.array([2.5, 2.5, 0.2, 2.5, 2.5, 4.0]), np.array([1.6, 5.5])
A = np.diag([1.0, 1.0, 1.0], 3) + G * np.outer(np.eye(6)[3], np.eye(6)[2])
K, S = LinearQuadraticRegulator(A, np.eye(6)[:, 4:], np.diag(ERROR_SCALES**-2), np.diag(COMMAND_SCALES**-2))

program = MathematicalProgram()
y, (level,) = program.NewIndeterminates(7), program.NewContinuousVariables(1)
(x, z, s, v_x, v_z, q, c), (up, turn) = y, -K @ y[:6]
rates = [v_x, v_z, (1 - c) * q, (G + up) * s, (G + up) * (1 - c) - G, turn, s * q]
V = y[:6] @ S @ y[:6] + S[2, 2] * c**2
factor, other = (program.NewFreePolynomial(Variables(y), 2).ToExpression() for _ in range(2))
decrease = (Jacobian([V], y) @ rates)[0]
program.AddSosConstraint((V - level) * (y @ y) + factor * decrease + other * (s**2 + c**2 - 2 * c))
program.AddLinearCost(-level)
result = ClarabelSolver().Solve(program)
assert result.is_success()
rho = result.GetSolution(level)
print(f"certified: {np.sqrt(rho / S[0, 0]):.2f} m, or {np.degrees(np.arccos(1 - rho / S[2, 2] / 2)):.0f} degrees")

theta, builder = Variable("theta"), DiagramBuilder()
state, (up, turn) = [x, z, theta, v_x, v_z, q], -K @ [x, z, sin(theta), v_x, v_z, q]
dynamics = [v_x, v_z, q, (G + up) * sin(theta), (G + up) * cos(theta) - G, turn]
output = [x, z, sin(theta), v_x, v_z, q, 1 - cos(theta)]
plant = builder.AddSystem(SymbolicVectorSystem(state=state, dynamics=dynamics, output=output))
logger, diagram = LogVectorOutput(plant.get_output_port(), builder, publish_period=0.1), builder.Build()
for e in np.random.default_rng(0).normal(size=(100, 6)) @ np.linalg.cholesky(np.linalg.inv(S)).T:
    # On the ray from the origin through e, V = ρ is a quadratic equation in c, since s² = 2 c - c².
    slope = e @ S @ e / e[2] ** 2
    height = rho / (slope + np.sqrt(slope**2 + rho * (S[2, 2] - slope)))
    e *= np.sqrt(2 * height - height**2) / abs(e[2])
    simulator = Simulator(diagram)
    simulator.get_mutable_context().SetContinuousState([*e[:2], np.arcsin(e[2]), *e[3:]])
    simulator.AdvanceTo(15.0)
    log = logger.FindLog(simulator.get_context())
    ratio = Polynomial(V).EvaluateIndeterminates(y, log.data()) / rho
    assert np.all(np.diff(ratio) < 0.0)
    plt.semilogy(log.sample_times(), ratio, linewidth=0.5)
plt.gca().set(xlabel="time (s)", ylabel="V / ρ", title="simulations from 100 states on the boundary")
Path("out").mkdir(exist_ok=True)
plt.savefig("out/region_of_attraction.png")
