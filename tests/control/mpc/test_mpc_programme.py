"""Tests of the programmes of model predictive control, against problems that simulate the states tick by tick."""

import numpy as np
import pytest
import scipy
from pydrake.autodiffutils import InitializeAutoDiff

from drake_quad.control.lqg.chains import (
    ChainNoise,
    Disturbances,
    SecondOrderResponse,
    attitude_model,
    discretise,
    torque_model,
    vertical_model,
)
from drake_quad.control.lqg.design import Timing, augment_with_delay, axis_loop, design_regulator
from drake_quad.control.lqg.laws import LqgParameters, TargetParameters, ThrustParameters, TorqueParameters
from drake_quad.control.mpc.constraints import (
    Corridor,
    Horizon,
    Preview,
    horizontal_constraints,
    vertical_constraints,
)
from drake_quad.control.mpc.prediction import Prediction
from drake_quad.control.mpc.programme import Programme
from drake_quad.geometry.per_axis import PerAxis
from drake_quad.signals import Jerk, Reference, Snap

TIMING = Timing(frame=0.01, tick=0.02, delay_ticks=2)  # periods of camera frames and ticks in s
NUM_TICKS = 7  # ticks of the horizon
NUM_INSTANTS = 12  # times in the preview
HORIZON_START = 3  # index of the preview time at which the horizon begins
COMMAND_WEIGHTS = {"lateral": 2e-6, "vertical": 3e-4}  # weights of the squared commands
AUTOPILOT_COMMAND_WEIGHT = 2e-3  # weight of the squared attitude command
THRUST_PARAMETERS = ThrustParameters(
    mass=0.7, gravity=9.8, tan_max_tilt=np.tan(0.1), min_thrust=4.0, max_thrust=7.2, lead=0.07
)
TORQUE_PARAMETERS = TorqueParameters(
    i_xx=0.0065, i_yy=0.0085, i_zz=0.0126, yaw_k_p=5.0, yaw_k_d=3.1, max_snap=40.0, lead=0.05
)
TARGET_PARAMETERS = TargetParameters(0.2, 0.03)
MODELLED_DISTURBANCES = Disturbances(
    first=ChainNoise(deviation=0.5, time=20.0),
    second=ChainNoise(deviation=1.2, time=0.7),
    bias=ChainNoise(deviation=1.0, time=20.0),
    command_noise=2.0,
)
MODELS = {
    "torques": torque_model(0.045, MODELLED_DISTURBANCES),
    "attitude": attitude_model(SecondOrderResponse(natural_frequency=8.5, damping=0.7), MODELLED_DISTURBANCES),
    "height": vertical_model(0.04, MODELLED_DISTURBANCES._replace(bias=None)),
}
CORRIDOR = Corridor(PerAxis(-0.2, -0.31, 0.9), PerAxis(0.21, 0.3, 1.2), follows_reference=False, weight=25.0)
TILT_WEIGHT = 8.0  # weight of the squared tilt slack
CORRECTION = np.array([0.1, -0.2, 0.15])  # m/s²


def horizon_of(kind, corridor=CORRIDOR):
    """Return a horizon whose preview has different values in every component."""
    rng = np.random.default_rng(4)
    sizes = [0.15, 0.2, 0.1, *[0.5] * 3, 0.6, 0.5, 0.8, 0.1, 0.1], [1.0] * 3, [25.0] * 4, [25.0] * 4
    parts = [rng.normal(size=(len(size), NUM_INSTANTS)) * np.array(size)[:, None] for size in sizes]
    parts[0][2] += 1.0
    preview = Preview(*(record(*rows) for record, rows in zip((Reference, Jerk, Snap, Snap), parts, strict=True)))
    lateral = axis_loop(MODELS[kind], TIMING, noise=np.array([0.001, 0.02]), command_weight=lateral_weight(kind))
    vertical = axis_loop(MODELS["height"], TIMING, noise=np.array([0.001]), command_weight=COMMAND_WEIGHTS["vertical"])
    parts = (TORQUE_PARAMETERS, None) if kind == "torques" else (None, TARGET_PARAMETERS)
    return Horizon(
        LqgParameters(lateral, vertical, THRUST_PARAMETERS, *parts), preview, corridor, TILT_WEIGHT, NUM_TICKS, 0.02
    )


def lateral_weight(kind):
    return COMMAND_WEIGHTS["lateral"] if kind == "torques" else AUTOPILOT_COMMAND_WEIGHT


class ExplicitAxis:
    """Model of one axis that is simulated tick by tick, with the cost-to-go after the horizon."""

    def __init__(self, model, command_weight):
        self.A, B = augment_with_delay(*discretise(model.A, model.B, TIMING.tick), TIMING.delay_ticks)
        self.b, self.rho = B[:, 0], command_weight
        Q = np.zeros_like(self.A)
        Q[0, 0] = 1.0
        self.S = scipy.linalg.solve_discrete_are(self.A, B, Q, np.eye(1) * command_weight)

    def roll_out(self, x, commands):
        """Return the states (ticks + 1, n), and the cost."""
        states = [x]
        for u in commands:
            states.append(self.A @ states[-1] + self.b * u)
        states = np.array(states)
        cost = (states[:-1, 0] ** 2).sum() + self.rho * (commands**2).sum() + states[-1] @ self.S @ states[-1]
        return states, cost


def minimised(cost, margins, size, scale):
    """Minimise a convex cost by sequential least squares programming, and return the solution."""
    result = scipy.optimize.minimize(
        lambda v: cost(scale * v),
        np.zeros(size),
        constraints={"type": "ineq", "fun": lambda v: margins(scale * v)},
        method="SLSQP",
        options={"ftol": 1e-14, "maxiter": 500},
    )
    assert result.success
    return scale * result.x


def excess(values):
    return np.maximum(values, 0.0)


@pytest.mark.long
@pytest.mark.parametrize("kind", ["torques", "attitude"])
def test_horizontal_commands_agree_with_an_optimisation_over_simulated_states(kind):
    """Each limit applies at its tick, and the slack variables add their cost."""
    horizon = horizon_of(kind)
    axis, r = ExplicitAxis(MODELS[kind], lateral_weight(kind)), horizon.preview.reference
    n = len(axis.A)
    rng = np.random.default_rng(1)
    x, y = 0.1 * rng.normal(size=n), 0.1 * rng.normal(size=n)
    now, later = (
        slice(HORIZON_START, HORIZON_START + NUM_TICKS),
        slice(HORIZON_START + 1, HORIZON_START + 1 + NUM_TICKS),
    )
    _, jerk, snap, before = horizon.preview
    if kind == "torques":
        ahead = [s + 0.05 / 0.02 * (s - b) for s, b in ((snap.x, before.x), (snap.y, before.y))]
    else:
        ahead = [
            a - tau + 0.2 * j + 0.03 * s
            for a, tau, j, s in zip((r.a_x, r.a_y), CORRECTION, (jerk.x, jerk.y), (snap.x, snap.y), strict=False)
        ]
    max_force = 9.8 * np.tan(0.1) * np.cos(np.pi / 16)
    normals = [(np.cos(a), np.sin(a)) for a in 2.0 * np.pi * np.arange(16) / 16]

    def parts(v):
        u_x, u_y, over = v[:NUM_TICKS], v[NUM_TICKS : 2 * NUM_TICKS], v[2 * NUM_TICKS :].reshape(3, NUM_TICKS)
        return u_x, u_y, axis.roll_out(x, u_x), axis.roll_out(y, u_y), over

    def cost(v):
        _, _, (_, of_x), (_, of_y), (over_x, over_y, over_tilt) = parts(v)
        return of_x + of_y + 25.0 * (over_x @ over_x + over_y @ over_y) + 8.0 * over_tilt @ over_tilt

    def margins(v):
        u_x, u_y, (x_k, _), (y_k, _), (over_x, over_y, over_tilt) = parts(v)
        rows = []
        for p, p_r, over, low, high in (
            (x_k, r.x, over_x, -0.2, 0.21),
            (y_k, r.y, over_y, -0.31, 0.3),
        ):
            position = p_r[later] + p[1:, 0]
            rows += [high + over - position, position - low + over]
        if kind == "torques":
            for u, forward in ((u_x, ahead[0]), (u_y, ahead[1])):
                rows += [(40.0 - (forward[now] + u)) / 40.0, (40.0 + forward[now] + u) / 40.0]
            s_x, s_y = r.a_x[later] - 0.1 + x_k[1:, 2], r.a_y[later] + 0.2 + y_k[1:, 2]
            rows += [(max_force - c * s_x - s * s_y) / 9.8 + over_tilt for c, s in normals]
        else:
            w_x, w_y = ahead[0][now] + u_x, ahead[1][now] + u_y
            rows += [(max_force - c * w_x - s * w_y) / 9.8 for c, s in normals]
        return np.concatenate(rows)

    scale = np.repeat([20.0 if kind == "torques" else 0.5, 0.05], [2 * NUM_TICKS, 3 * NUM_TICKS])
    solution = minimised(cost, margins, 5 * NUM_TICKS, scale)
    assert np.abs(margins(solution)).min() < 1e-7
    regulator = design_regulator(MODELS[kind], TIMING, lateral_weight(kind))
    programme = Programme(list(horizontal_constraints(regulator, horizon)), regulator.weight)
    added = programme.perturbations(HORIZON_START, np.concatenate([x, y])[:, None], CORRECTION[:, None])[:, 0]
    K = np.array(regulator.K)
    assert np.abs(added).max() > 1e-3 * scale[0]
    expected = [solution[0] + K @ x, solution[NUM_TICKS] + K @ y]
    np.testing.assert_allclose(added, expected, atol=2e-4 * scale[0])


@pytest.mark.parametrize("follows_reference", [False, True])
def test_a_corridor_bounds_the_distance_beyond_a_wall(follows_reference):
    """Distances are in metres along each axis of W. A corridor that follows the reference is centred on it."""
    horizon = horizon_of("torques", CORRIDOR._replace(follows_reference=follows_reference))
    rng = np.random.default_rng(6)
    later = slice(HORIZON_START + 1, HORIZON_START + 1 + NUM_TICKS)
    walls = {name: (getattr(CORRIDOR.lower, name), getattr(CORRIDOR.upper, name)) for name in "xyz"}
    for names, model, weight, constraints in (
        ("xy", "torques", COMMAND_WEIGHTS["lateral"], horizontal_constraints),
        ("z", "height", COMMAND_WEIGHTS["vertical"], vertical_constraints),
    ):
        regulator, axis = design_regulator(MODELS[model], TIMING, weight), ExplicitAxis(MODELS[model], weight)
        starts, added = (rng.normal(size=(len(names), size)) for size in (len(axis.A), NUM_TICKS))
        expected = {}
        for name, x, c in zip(names, starts, added, strict=True):
            states = [x]
            for perturbation in c:
                states.append((axis.A - np.outer(axis.b, regulator.K)) @ states[-1] + axis.b * perturbation)
            position = np.array(states)[1:, 0] + (
                0.0 if follows_reference else getattr(horizon.preview.reference, name)[later]
            )
            low, high = walls[name]
            expected[f"corridor along {name}"] = {tuple((position - high).round(9)), tuple((low - position).round(9))}
        distances = {name: set() for name in expected}
        for each in constraints(regulator, horizon):
            if each.slack is not None and each.slack.name in distances:
                assert each.starts_next_tick
                room = np.broadcast_to(each.bound, NUM_INSTANTS)[later]
                beyond = each.free @ starts.ravel() + each.forced @ added.ravel() - room
                distances[each.slack.name].add(tuple(beyond.round(9)))
        assert distances == expected


@pytest.mark.parametrize("height", [0.35, -0.3])
def test_vertical_commands_agree_with_an_optimisation_over_simulated_states(height):
    horizon = horizon_of("torques")
    axis, r = ExplicitAxis(MODELS["height"], COMMAND_WEIGHTS["vertical"]), horizon.preview.reference
    z = np.array([height, 0.3, 0.1, 0.2, -0.1, 0.1, 0.3, -0.2])
    now, later = (
        slice(HORIZON_START, HORIZON_START + NUM_TICKS),
        slice(HORIZON_START + 1, HORIZON_START + 1 + NUM_TICKS),
    )
    forward = (r.a_z - 0.15 + 0.07 * horizon.preview.jerk.z)[now]
    max_command = np.sqrt((7.2 / 0.7) ** 2 - r.a_x**2 - r.a_y**2)[now] - 9.8

    def cost(v):
        return axis.roll_out(z, v[:NUM_TICKS])[1] + 25.0 * v[NUM_TICKS:] @ v[NUM_TICKS:]

    def margins(v):
        u, over = v[:NUM_TICKS], v[NUM_TICKS:]
        position = r.z[later] + axis.roll_out(z, u)[0][1:, 0]
        return np.concatenate(
            [max_command - forward - u, forward + u - 4.0 / 0.7 + 9.8, 1.2 + over - position, position - 0.9 + over]
        )

    scale = np.repeat([1.0, 0.05], NUM_TICKS)
    solution = minimised(cost, margins, 2 * NUM_TICKS, scale)
    regulator = design_regulator(MODELS["height"], TIMING, COMMAND_WEIGHTS["vertical"])
    programme = Programme(list(vertical_constraints(regulator, horizon)), regulator.weight)
    added = programme.perturbations(HORIZON_START, z[:, None], CORRECTION[:, None]).item()
    assert abs(added) > 1e-2
    assert added == pytest.approx(solution[0] + np.array(regulator.K) @ z, abs=1e-4)


def test_a_violated_limit_beyond_the_horizon_has_no_influence():
    """The reference demands too much snap at one tick. Nothing changes until the horizon includes this tick."""
    horizon = horizon_of("torques", CORRIDOR._replace(follows_reference=True))
    calm = Preview(
        *(record(*np.zeros((len(record._fields), NUM_INSTANTS))) for record in (Reference, Jerk, Snap, Snap))
    )
    spike = np.zeros(NUM_INSTANTS)
    spike[9] = 30.0
    preview = calm._replace(snap=calm.snap._replace(x=spike), before=calm.before._replace(x=spike))
    regulator = design_regulator(MODELS["torques"], TIMING, COMMAND_WEIGHTS["lateral"])
    limited = horizon.parameters._replace(torques=TORQUE_PARAMETERS._replace(max_snap=20.0))
    programme = Programme(
        list(horizontal_constraints(regulator, horizon._replace(preview=preview, parameters=limited))), regulator.weight
    )
    n = len(regulator.K)
    perturbations = [
        programme.perturbations(tick, np.zeros((2 * n, 1)), np.zeros((3, 1)))[:, 0] for tick in range(NUM_INSTANTS)
    ]
    assert not np.array(perturbations)[:3].any()
    # The snap of 30 exceeds the limit of 20 by 10, which only the command of this tick can compensate.
    assert perturbations[9] == pytest.approx([-10.0, 0.0], abs=1e-6)
    assert not np.array(perturbations)[10:].any()


def test_the_programme_has_a_solution_for_any_deviation():
    """The solution satisfies the limits on commands."""
    regulator = design_regulator(MODELS["torques"], TIMING, COMMAND_WEIGHTS["lateral"])
    horizon = horizon_of("torques")
    programme = Programme(list(horizontal_constraints(regulator, horizon)), regulator.weight)
    rng = np.random.default_rng(8)
    n = len(regulator.K)
    for size in (0.3, 3.0, 30.0):
        deviation = size * rng.normal(size=(2 * n, 1))
        added = programme.perturbations(HORIZON_START, deviation, np.zeros((3, 1)))[:, 0]
        _, _, snap, before = horizon.preview
        for axis, (s, b) in enumerate(((snap.x, before.x), (snap.y, before.y))):
            forward = (s + 2.5 * (s - b))[HORIZON_START]
            command = forward - np.array(regulator.K) @ deviation[axis * n : (axis + 1) * n, 0] + added[axis]
            assert abs(command) <= 40.0 * (1.0 + 1e-6)


def test_derivatives_are_those_for_fixed_active_constraints():
    horizon = horizon_of("torques")
    regulator = design_regulator(MODELS["height"], TIMING, COMMAND_WEIGHTS["vertical"])
    programme = Programme(list(vertical_constraints(regulator, horizon)), regulator.weight)
    z, correction, step = np.array([0.35, 0.05, 0.1, 0.02, -0.01, 0.01, 0.03, -0.02]), np.zeros((3, 1)), 1e-5
    ((perturbation,),) = programme.perturbations(HORIZON_START, InitializeAutoDiff(z), correction)
    expected = [
        np.diff(
            [
                programme.perturbations(HORIZON_START, (z + d)[:, None], correction).item()
                for d in (-direction, direction)
            ]
        )
        / (2.0 * step)
        for direction in step * np.eye(len(z))
    ]
    assert perturbation.value() == pytest.approx(programme.perturbations(HORIZON_START, z[:, None], correction).item())
    assert np.abs(expected).max() > 1.0
    np.testing.assert_allclose(perturbation.derivatives(), np.ravel(expected), atol=1e-4)


def test_predictions_match_a_simulation_of_the_axis():
    """The axis is simulated tick by tick with random perturbations of its commands."""
    regulator = design_regulator(MODELS["torques"], TIMING, COMMAND_WEIGHTS["lateral"])
    A, B, K = (np.array(part) for part in regulator[:3])
    rng = np.random.default_rng(3)
    x, c = rng.normal(size=len(A)), 100.0 * rng.normal(size=NUM_TICKS)
    predicted = Prediction(regulator, NUM_TICKS)
    commands, thrusts = [], []
    state = x
    for perturbation in c:
        commands.append(-K @ state + perturbation)
        state = A @ state + B * commands[-1]
        thrusts.append(state[2])
    for response, expected in ((predicted.command(), commands), (predicted.state(2), thrusts)):
        np.testing.assert_allclose(response.free @ x + response.forced @ c, expected, rtol=1e-10)


def test_a_perturbation_adds_its_weighted_square_to_the_cost():
    """The sum of p² + ρ u² over all time is the regulator's cost plus w Σ c² for perturbations c of its commands."""
    regulator, axis = (
        design_regulator(MODELS["torques"], TIMING, COMMAND_WEIGHTS["lateral"]),
        ExplicitAxis(MODELS["torques"], 2e-6),
    )
    K = np.array(regulator.K)
    rng = np.random.default_rng(6)
    x, c = 0.1 * rng.normal(size=len(K)), 50.0 * rng.normal(size=NUM_TICKS)
    costs = []
    for added in (np.zeros(NUM_TICKS), c):
        state, commands = x, []
        for perturbation in added:
            commands.append(-K @ state + perturbation)
            state = axis.A @ state + axis.b * commands[-1]
        costs.append(axis.roll_out(x, np.array(commands))[1])
    assert costs[0] == pytest.approx(x @ axis.S @ x, rel=1e-6)
    assert costs[1] - costs[0] == pytest.approx(regulator.weight * c @ c, rel=1e-6)
