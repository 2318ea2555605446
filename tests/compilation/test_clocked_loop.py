"""Tests of machine code that simulates vehicles with individual clocks, generated from handwritten listings."""

import numpy as np
import pytest

from drake_quad.compilation.clocked_loop import ClockedLoop
from drake_quad.compilation.parts import PartSizes
from drake_quad.compilation.trace import INPUTS, PARAMETERS, STATE
from drake_quad.framework import elementary
from drake_quad.framework.machine_code import LANES
from drake_quad.framework.symbols import Listing


def loop_of(n):
    """Return a loop that computes x⁺ = x + h (exp(p) x + u), and logs x plus a value in the table."""
    listing = Listing()
    x, p, u = listing.row(STATE, 1), listing.row(PARAMETERS, 0), listing.row(INPUTS, 0)
    step, table_value = listing.shared(2), listing.shared(0)
    changes = {1: x + step * (elementary.exp(p) * x + u)}
    return ClockedLoop(listing, changes, [x + table_value], sizes=PartSizes(2, 1, 1), width=3, num_vehicles=n)


def by_vehicle(rows, n):
    return rows.transpose(0, 2, 1).reshape(-1, rows.shape[1])[:n]


def fill(rows, values):
    """Write values (N, rows) to rows; the unused lanes get the values of the last vehicle."""
    vectors, _, lanes = rows.shape
    padded = np.concatenate([values, np.tile(values[-1:], (vectors * lanes - len(values), 1))])
    rows[...] = padded.reshape(vectors, lanes, -1).transpose(0, 2, 1)


@pytest.mark.parametrize("n", [1, 3, LANES, 2 * LANES + 3])
def test_each_vehicle_uses_the_table_row_that_its_clock_selects(n):
    rng = np.random.default_rng(n)
    state, parameters, inputs = rng.normal(size=(n, 2)), rng.normal(size=(n, 1)), rng.normal(size=(n, 1))
    table, clocks = rng.uniform(0.1, 0.5, (9, 3)), rng.integers(0, 6, n)
    loop = loop_of(n)
    vectors = -(-n // loop.lanes)
    assert loop.clocks.shape == (vectors, loop.lanes)
    shapes = [rows.shape for rows in (loop.state, loop.parameters, loop.inputs, loop.log)]
    assert shapes == [(vectors, count, loop.lanes) for count in (2, 1, 1, 1)]
    for rows, values in ((loop.state, state), (loop.parameters, parameters), (loop.inputs, inputs)):
        fill(rows, values)
    loop.prepare(range(len(loop.state)))
    for tick in range(3):
        loop.clocks.reshape(-1)[:n] = clocks + tick
        loop.advance(table)
        table_value = table[clocks + tick, 0]
        np.testing.assert_allclose(by_vehicle(loop.log, n)[:, 0], state[:, 1] + table_value, rtol=1e-14)
        step = table[clocks + tick, 2]
        state[:, 1] += step * (np.exp(parameters[:, 0]) * state[:, 1] + inputs[:, 0])
        np.testing.assert_allclose(by_vehicle(loop.state, n), state, rtol=1e-13)


def test_results_that_depend_only_on_parameters_are_updated_only_by_prepare():
    n = 2 * LANES
    loop = loop_of(n)
    fill(loop.state, np.ones((n, 2)))
    fill(loop.parameters, np.zeros((n, 1)))
    loop.prepare([0, 1])
    fill(loop.parameters, np.full((n, 1), np.log(3.0)))
    loop.prepare([1])
    loop.advance(np.array([[0.0, 0.0, 1.0]]))
    np.testing.assert_allclose(by_vehicle(loop.state, n)[:, 1], np.repeat([2.0, 4.0], LANES), rtol=1e-14)
