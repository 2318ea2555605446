"""Tests that the models of linear-quadratic-Gaussian control match the equations in `controllers_lqg.md`."""

import re
from pathlib import Path

import numpy as np
import pytest
import scipy

from drake_quad.control.lqg.chains import (
    ChainNoise,
    Disturbances,
    SecondOrderResponse,
    attitude_model,
    lagging_attitude_model,
    torque_model,
    vertical_model,
)

PAGE = Path(__file__).parents[3] / "docs" / "reference" / "controllers_lqg.md"
ROTOR_LAG = 0.043  # s
AUTOPILOT_RESPONSE = SecondOrderResponse(natural_frequency=9.1, damping=0.72)
LATERAL_DISTURBANCES = Disturbances(
    first=ChainNoise(deviation=0.31, time=2.3),
    second=ChainNoise(deviation=0.27, time=0.6),
    bias=ChainNoise(deviation=4.1, time=1.7),
    command_noise=0.0,
)
VERTICAL_DISTURBANCES = LATERAL_DISTURBANCES._replace(bias=None)
MODELS = {
    "torques": torque_model(ROTOR_LAG, LATERAL_DISTURBANCES),
    "autopilot": attitude_model(AUTOPILOT_RESPONSE, LATERAL_DISTURBANCES),
    "autopilot and `lag`": lagging_attitude_model(AUTOPILOT_RESPONSE, ROTOR_LAG, LATERAL_DISTURBANCES),
    "height": vertical_model(ROTOR_LAG, VERTICAL_DISTURBANCES),
}
# Field of a chain for each symbol in the equations of `controllers_lqg.md`.
FIELD_NAMES = {
    "p": "position", "v": "velocity", "s": "thrust", "j": "jerk", "a": "snap",
    "d_1": "first", "d_2": "second", "e": "second_rate", "δ": "bias",
}  # fmt: skip
# Values of the constants in the equations of `controllers_lqg.md`: time constants in s, and ω in rad/s.
SYMBOL_VALUES = {
    "T": ROTOR_LAG, "ω": AUTOPILOT_RESPONSE.natural_frequency, "ζ": AUTOPILOT_RESPONSE.damping,
    "T_1": LATERAL_DISTURBANCES.first.time, "T_2": LATERAL_DISTURBANCES.second.time,
    "T_δ": LATERAL_DISTURBANCES.bias.time,
}  # fmt: skip


def page_equations():
    """Return the right-hand sides of the equations in `controllers_lqg.md` as Python, keyed by chain and state."""
    page = PAGE.read_text(encoding="utf-8")
    equations = {}
    for line in re.findall(r"^    (\S.*' = .*)$", page[: page.index("The attitude determines")], re.MULTILINE):
        chain, *sides = re.split(r" {3,}", line)
        equations[chain] = {}
        for state, right in (side.split("' = ") for side in sides):
            equations[chain][python_of(state)] = python_of(right)
    return equations


def python_of(text):
    """Return a formula of `controllers_lqg.md` as Python, with names for subscripts and explicit products."""
    for symbol, name in (("₁", "_1"), ("₂", "_2"), ("²", " ** 2")):
        text = text.replace(symbol, name)
    return re.sub(r"(?<=[\w)]) (?=[\w(])", " * ", text)


@pytest.mark.parametrize("chain", MODELS)
def test_chain_models_match_the_equations_on_the_documentation_page(chain):
    """A right-hand side is linear in states and command, so its value at a unit vector is an entry of A or B."""
    model = MODELS[chain]
    equations = page_equations()
    rows = equations[chain] | equations["noises"]
    fields = [name for name, field in FIELD_NAMES.items() if field in model.kind._fields]
    unknowns = [*fields, "u"]
    for state in fields:
        names = dict.fromkeys((*FIELD_NAMES, "u", "w_1", "w_2", "w_δ"), 0.0) | SYMBOL_VALUES
        coefficients = [eval(rows[state], {}, names | {unknown: 1.0}) for unknown in unknowns]
        row = model.kind._fields.index(FIELD_NAMES[state])
        order = [model.kind._fields.index(FIELD_NAMES[name]) for name in fields]
        np.testing.assert_allclose(coefficients, [*model.A[row, order], model.B[row, 0]], rtol=1e-12, err_msg=state)
        disturbed = "w" in rows[state]
        assert disturbed == (model.Q[row, row] > 0.0), state


def test_disturbances_have_the_given_deviations_and_second_order_ones_are_critically_damped():
    model = MODELS["torques"]
    indices = [model.kind._fields.index(name) for name in ("first", "second", "second_rate", "bias")]
    block = np.ix_(indices, indices)
    covariance = scipy.linalg.solve_continuous_lyapunov(model.A[block], -model.Q[block])
    deviations = np.sqrt(np.diag(covariance))[[0, 1, 3]]
    np.testing.assert_allclose(deviations, [noise.deviation for noise in LATERAL_DISTURBANCES[:3]], rtol=1e-12)
    # Both poles of the second disturbance are at -1 / T, which is critical damping.
    characteristic = np.poly(model.A[np.ix_(indices[1:3], indices[1:3])])
    np.testing.assert_allclose(characteristic, np.poly([-1.0 / 0.6] * 2), rtol=1e-12)
