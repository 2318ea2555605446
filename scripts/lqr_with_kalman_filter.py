"""Design an LQR with a Kalman filter on the linear plant of a laboratory, and compare it with the built-in controller.

The plant is the discrete linear model from the commanded wrench to the measurement. It includes the link, the rotors,
the body and the cameras. It is linearised at zero yaw, so the yaw of the reference must be zero.
"""

import numpy as np
from pydrake.systems.controllers import DiscreteTimeLinearQuadraticRegulator
from pydrake.systems.estimators import DiscreteTimeSteadyStateKalmanFilter
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from drake_quad import compare_studies, laboratory_plant, load_scenario, mean_interval, run_monte_carlo
from drake_quad.signals import Reference, State, Wrench

LABORATORY, UNCERTAIN_MASS = "laboratory:low_wind", "vehicle.mass={uniform: {min: 0.66, max: 0.70}}"
NOMINAL = load_scenario(LABORATORY)
MASS, GRAVITY = NOMINAL.nominal.mass, NOMINAL.nominal.gravity
PLANT = laboratory_plant(NOMINAL).system
# The LQR assigns the same cost to each of these errors (m, rad, m/s, rad/s) and commands (N, N m).
ERROR_SCALES = np.array([*State(0.05, 0.05, 0.05, 0.5, 0.5, 0.2, 0.5, 0.5, 0.5, 2.0, 2.0, 2.0)])
COMMAND_SCALES = np.array([*Wrench(3.0, 0.3, 0.3, 0.1)])
# Standard deviations of the measurement noise (m, rad, m/s, rad/s) in the Kalman filter.
NOISE = np.array([*State(*3 * [0.001], *3 * [0.004], *3 * [0.01], *3 * [0.04])])
WEIGHT, DISTURBANCE = PLANT.C / ERROR_SCALES[:, np.newaxis], PLANT.B * 0.1 * COMMAND_SCALES
K, _ = DiscreteTimeLinearQuadraticRegulator(PLANT.A, PLANT.B, WEIGHT.T @ WEIGHT, np.diag(COMMAND_SCALES**-2))
L = DiscreteTimeSteadyStateKalmanFilter(PLANT.A, PLANT.C, DISTURBANCE @ DISTURBANCE.T, np.diag(NOISE**2))


class Lqr(LeafSystem):
    """LQR and Kalman filter for N vehicles. The state has one column for each vehicle: the plant's estimated state."""

    def __init__(self, num_vehicles: int = 1) -> None:
        super().__init__()
        self.measurement = self.DeclareVectorInputPort("measurement", BasicVector(12 * num_vehicles))
        self.reference = self.DeclareVectorInputPort("reference", BasicVector(11 * num_vehicles))
        self.DeclareDiscreteState(len(PLANT.A) * num_vehicles)
        self.DeclareVectorOutputPort("wrench", BasicVector(4 * num_vehicles), self.regulate)
        self.DeclarePeriodicDiscreteUpdateEvent(PLANT.period, 0.0, self.observe)

    def regulate(self, context: Context, output: BasicVector) -> None:
        r = Reference(*self.reference.Eval(context).reshape(11, -1))
        wrench = -K @ context.get_discrete_state_vector().value().reshape(len(PLANT.A), -1)
        wrench[0] += MASS * (GRAVITY + r.a_z)
        output.SetFromVector(wrench.ravel())

    def observe(self, context: Context, values: DiscreteValues) -> None:
        m, r = self.measurement.Eval(context), Reference(*self.reference.Eval(context).reshape(11, -1))
        target = [r.x, r.y, r.z, -r.a_y / GRAVITY, r.a_x / GRAVITY, r.yaw, r.v_x, r.v_y, r.v_z, *3 * [0.0 * r.yaw]]
        x = context.get_discrete_state_vector().value().reshape(len(PLANT.A), -1)
        error = m.reshape(12, -1) - target
        values.set_value((PLANT.A @ x - PLANT.B @ (K @ x) + L @ (error - PLANT.C @ x)).ravel())


if __name__ == "__main__":  # worker processes import this file
    uncertain = load_scenario(LABORATORY, [UNCERTAIN_MASS])
    mine, built_in = run_monte_carlo(uncertain, 200, seed=1, control=Lqr), run_monte_carlo(uncertain, 200, seed=1)
    for name, study in {"LQR": mine, NOMINAL.cascade.position.kind: built_in}.items():
        print(f"RMSE, {name}: {mean_interval(study.metrics.rmse).text(unit='cm', size=0.01)}")
    print(f"ratio of the errors: {compare_studies(mine, built_in).ratio.ratio()}")
