"""Tests of machine code that simulates events, generated from handwritten listings."""

import itertools

import numpy as np
import pytest

from drake_quad.compilation import parts
from drake_quad.compilation.loop import EventCode, Loop
from drake_quad.compilation.parts import PartSizes
from drake_quad.compilation.trace import INPUTS, PARAMETERS, STATE
from drake_quad.framework import elementary, scheduling
from drake_quad.framework.machine_code import LANES
from drake_quad.framework.symbols import Listing

# A vector register of the processor holds LANES vehicles.
NUM_VEHICLES = [1, 3, LANES, LANES + 3]


def run(listing, changes, logged, *, state, parameters=(), inputs=(), shared, width=None, single_vehicle=False):
    """Simulate events, and return the final state and the log.

    Args:
        listing: listing of the operations of an event.
        changes: next values of state components, by their index.
        logged: rows that are logged at each event.
        state: (rows, N) state of N vehicles.
        parameters: (rows, N) parameters.
        inputs: (rows, N) inputs.
        shared: (events, width) values that all vehicles share in each event.
        width: width of `shared`, if it has no events.
        single_vehicle: True to compile the code for a single vehicle.
    """
    state = np.array(state, dtype=float)
    n = state.shape[1]
    parameters, inputs = (np.array(rows, dtype=float).reshape(-1, n) for rows in (parameters, inputs))
    shared = np.array(shared, dtype=float)
    sizes = PartSizes(len(state), len(parameters), len(inputs))
    loop = Loop(
        [EventCode(listing, changes, logged)],
        sizes=sizes,
        width=shared.shape[1] if width is None else width,
        single_vehicle=single_vehicle,
    )
    flat, log = state.ravel(), np.full((len(shared), loop.num_logged, loop.padded_num_vehicles(n)), np.nan)
    loop.run(flat, parameters.ravel(), inputs.ravel(), shared, log, n)
    return flat.reshape(-1, n), log[:, :, :n]


def rows_of(listing, group, count):
    return [listing.row(group, index) for index in range(count)]


@pytest.mark.parametrize(("n", "single_vehicle"), [(1, True), *((n, False) for n in NUM_VEHICLES)])
def test_consecutive_events_are_simulated_for_every_vehicle(n, single_vehicle):
    """Each event reads the state after the previous event and its shared values, and logs the previous state."""
    listing = Listing()
    x, v = rows_of(listing, STATE, 2)
    ((stiffness,), (force,), step) = rows_of(listing, PARAMETERS, 1), rows_of(listing, INPUTS, 1), listing.shared(1)
    changes = {0: x + step * v, 1: v + step * (force - elementary.exp(stiffness) * x)}
    rng = np.random.default_rng(n)
    state, parameters, inputs = rng.normal(size=(2, n)), rng.normal(size=(1, n)), rng.normal(size=(1, n))
    shared = rng.uniform(0.1, 0.2, (5, 2))
    actual, log = run(
        listing,
        changes,
        [x * v, 7.0, x],
        state=state,
        parameters=parameters,
        inputs=inputs,
        shared=shared,
        single_vehicle=single_vehicle,
    )
    for event, (_, h) in enumerate(shared):
        a, b = state
        np.testing.assert_allclose(log[event], [a * b, np.full(n, 7.0), a], rtol=1e-13, atol=1e-15)
        state = np.array([a + h * b, b + h * (inputs[0] - np.exp(parameters[0]) * a)])
    np.testing.assert_allclose(actual, state, rtol=1e-13)


@pytest.mark.parametrize(("n", "single_vehicle"), [(1, True), *((n, False) for n in NUM_VEHICLES)])
def test_events_of_several_kinds_occur_in_the_given_order(n, single_vehicle):
    """One kind adds the exponential of a parameter to the state, and the other multiplies it by a shared value."""
    growth, product = Listing(), Listing()
    x, rate = growth.row(STATE, 0), growth.row(PARAMETERS, 0)
    y, factor = product.row(STATE, 0), product.shared(1)
    kinds = [EventCode(growth, {0: x + elementary.exp(rate)}, []), EventCode(product, {0: y * factor}, [y, factor])]
    loop = Loop(kinds, sizes=PartSizes(1, 1, 0), width=2, single_vehicle=single_vehicle)
    assert loop.num_logged == 2
    rng = np.random.default_rng(n)
    state, rates, shared = rng.normal(size=n), rng.normal(size=n), rng.uniform(0.5, 2.0, (5, 2))
    expected, expected_log, order = state.copy(), {}, np.array([1, 0, 0, 1, 0])
    log = np.full((5, 2, loop.padded_num_vehicles(n)), np.nan)
    loop.run(state, rates, np.empty(0), shared, log, n, order=order)
    for event, kind in enumerate(order):
        if kind == 1:
            expected_log[event] = [expected, np.full(n, shared[event, 1])]
        expected = expected * shared[event, 1] if kind else expected + np.exp(rates)
    np.testing.assert_allclose(state, expected, rtol=1e-13)
    for event, rows in expected_log.items():
        np.testing.assert_allclose(log[event, :, :n], rows, rtol=1e-13)


@pytest.mark.parametrize("n", NUM_VEHICLES)
def test_only_state_components_that_change_are_written(n):
    """Memory outside the fleet does not change. Nothing changes if there are no events."""
    listing = Listing()
    (x, *_) = rows_of(listing, STATE, 3)
    loop = Loop([EventCode(listing, {1: x + 1.0}, [])], sizes=PartSizes(3, 0, 0), width=0, single_vehicle=False)
    for events in (0, 1):
        state = np.arange(3.0 * n + 5.0)
        none = np.empty(0)
        loop.run(
            state[: 3 * n], none, none, np.empty((events, 1)), np.empty((events, 0, loop.padded_num_vehicles(n))), n
        )
        expected = np.arange(3.0 * n + 5.0)
        if events:
            expected[n : 2 * n] = expected[:n] + 1.0
        np.testing.assert_array_equal(state, expected)


def test_aligned_arrays_begin_at_a_cache_line():
    """The test checks many arrays, because some are aligned by chance."""
    for size in range(1, 40):
        array = parts.aligned(size)
        assert array.size == size
        assert array.ctypes.data % parts.CACHE_LINE == 0


def test_the_number_of_log_columns_is_rounded_up_to_whole_vectors_of_vehicles():
    listing = Listing()
    loops = [
        Loop(
            [EventCode(listing, {}, [listing.row(STATE, 0)])],
            sizes=PartSizes(1, 0, 0),
            width=0,
            single_vehicle=one,
        )
        for one in (True, False)
    ]
    assert loops[0].padded_num_vehicles(1) == 1
    assert [loops[1].padded_num_vehicles(n) for n in (1, LANES, LANES + 1)] == [LANES, LANES, 2 * LANES]
    assert [loop.num_logged for loop in loops] == [1, 1]


def listing_with_late_uses():
    """Return a listing in which numbers, booleans, 64-bit words and parameters are used again much later."""
    listing = Listing()
    state, parameters = rows_of(listing, STATE, 6), rows_of(listing, PARAMETERS, 3)
    (force,) = rows_of(listing, INPUTS, 1)
    masks = [a > b for a, b in itertools.pairwise(state)]
    words = [elementary.to_uint64(abs(x)) for x in state]
    values = list(state)
    for turn in range(4):
        for i in range(6):
            fixed = parameters[i % 3] * (parameters[(i + 1) % 3] + float(turn))
            where_fixed = elementary.where(parameters[0] < parameters[1], fixed, -fixed)
            values[i] = 0.5 * values[i] + 0.25 * values[(i + turn) % 6] + where_fixed * force + listing.shared(0)
    for i, mask in enumerate(masks):
        values[i] = elementary.where(mask & masks[0] | (values[5] > 0.0), values[i], state[i])
        values[i] = values[i] + elementary.from_uint64(words[i] + words[5])
    return listing, {i: values[i] for i in (3, 0, 5, 1, 4)}, [state[3], values[2], values[5], parameters[1]]


@pytest.mark.parametrize("n", [1, LANES + 1])
@pytest.mark.parametrize("window", [2, 7, 40, 10_000])
def test_the_order_of_operations_does_not_change_the_results(monkeypatch, window, n):
    rng = np.random.default_rng(3)
    numbers = {
        "state": rng.uniform(-9.0, 9.0, (6, n)),
        "parameters": rng.normal(size=(3, n)),
        "inputs": rng.normal(size=(1, n)),
        "shared": rng.normal(size=(3, 1)),
    }
    monkeypatch.setattr(scheduling, "_WINDOW", 1)
    expected, expected_log = run(*listing_with_late_uses(), **numbers)
    monkeypatch.setattr(scheduling, "_WINDOW", window)
    actual, log = run(*listing_with_late_uses(), **numbers)
    np.testing.assert_array_equal(actual, expected)
    np.testing.assert_array_equal(log, expected_log)
    assert not np.array_equal(actual, numbers["state"])


@pytest.mark.parametrize("order", list(itertools.permutations(range(4)))[::3], ids=str)
def test_shifted_state_components_are_read_before_they_are_overwritten(order):
    """The example is a delay line. Its first component is computed late, and the others are shifted in any order."""
    listing = Listing()
    rows = rows_of(listing, STATE, 4)
    new_value = rows[0]
    for number in range(7):
        new_value = new_value * 0.5 + float(number)
    next_values = {0: new_value, 1: rows[0], 2: rows[1], 3: rows[2]}
    logged = [rows[3], rows[order[0]] + new_value]
    actual, log = run(
        listing,
        {row: next_values[row] for row in order},
        logged,
        state=[[1.0], [2.0], [3.0], [4.0]],
        shared=[[0.0]] * 3,
    )
    state, expected_log = [1.0, 2.0, 3.0, 4.0], []
    for _ in range(3):
        new = state[0]
        for number in range(7):
            new = new * 0.5 + number
        expected_log.append([state[3], state[order[0]] + new])
        state = [new, *state[:3]]
    np.testing.assert_array_equal(actual[:, 0], state)
    np.testing.assert_array_equal(log[:, :, 0], expected_log)


@pytest.mark.parametrize("targets", list(itertools.permutations(range(3))), ids=str)
def test_an_event_can_permute_state_components(targets):
    """The fourth component is computed from the values that the other three have before the permutation."""
    listing = Listing()
    rows = rows_of(listing, STATE, 4)
    first_term, second_term = rows[0] * 2.0, rows[1] + rows[2]
    for _ in range(4):
        second_term = second_term * rows[2]
    changes = {**{row: rows[target] for row, target in enumerate(targets)}, 3: first_term + second_term}
    (actual, _) = run(listing, changes, [], state=[[1.0], [2.0], [3.0], [4.0]], shared=[[0.0]])
    np.testing.assert_array_equal(actual[:3, 0], 1.0 + np.array(targets))
    assert actual[3, 0] == 2.0 + 5.0 * 3.0**4


def names_of(listing):
    return [operation.name for operation in listing.operations]


def test_results_that_depend_only_on_parameters_are_computed_in_advance():
    listing = Listing()
    (x,), (k, c) = rows_of(listing, STATE, 1), rows_of(listing, PARAMETERS, 2)
    decay = elementary.sqrt(k * c + 1.0)
    results = [decay * x, elementary.where(k > c, x, -x), k]
    preparation, (event, stores) = parts.split_listing(listing, parts.Results.of(listing, {}, results))
    assert {"square_root", "multiply"} <= set(names_of(preparation.listing))
    assert "square_root" not in names_of(event)
    assert all(operation.operands[0] != PARAMETERS for operation in event.operations if operation.name == "row")
    assert len(stores) == 3
    assert all(symbol.listing is event for _, symbol in stores)
    # The results are stored in consecutive rows.
    assert [target for target, _ in preparation.stores] == [(3, row) for row in range(len(preparation.stores))]


def test_unused_operations_are_omitted():
    listing = Listing()
    x, k = listing.row(STATE, 0), listing.row(PARAMETERS, 0)
    elementary.exp(x + k)
    elementary.exp(k)
    preparation, (event, _) = parts.split_listing(listing, parts.Results.of(listing, {}, [x + 1.0]))
    assert preparation.stores == []
    assert sorted(names_of(event)) == ["add", "constant", "row"]


def test_a_long_chain_of_operations_does_not_recurse():
    """An update event has two parts, each with a chain: the part that depends only on parameters, and the rest."""
    listing = Listing()
    x, k = listing.row(STATE, 0), listing.row(PARAMETERS, 0)
    for _ in range(3000):
        x, k = x + 1.0, k + 1.0
    preparation, (event, _) = parts.split_listing(listing, parts.Results.of(listing, {}, [x + k]))
    assert (len(preparation.listing.operations), len(event.operations)) == (3002, 3004)


@pytest.mark.parametrize(("n", "single_vehicle"), [(1, True), *((n, False) for n in NUM_VEHICLES)])
def test_branches_are_evaluated_at_every_event(n, single_vehicle):
    """A branch that depends only on parameters is evaluated in advance. A branch can occur twice in an event."""

    def root(x, y):
        return elementary.sqrt(x * x + y), y

    listing = Listing()
    (x, v), (a, b) = rows_of(listing, STATE, 2), rows_of(listing, PARAMETERS, 2)
    fixed, _ = elementary.lazy_where(a > 0.0, root, (a, 2.0), (b, 0.0))
    first, _ = elementary.lazy_where(x > v, root, (x, 1.0), (v, 0.0))
    second, given = elementary.lazy_where(first > 1.0, root, (first, abs(v)), (x, -1.0))
    rng = np.random.default_rng(n)
    state, parameters = rng.normal(size=(2, n)), rng.normal(size=(2, n))
    changes = {0: 0.5 * second - listing.shared(0), 1: fixed - first}
    shared = rng.uniform(0.5, 1.0, (6, 1))
    actual, log = run(
        listing,
        changes,
        [given, fixed],
        state=state,
        parameters=parameters,
        shared=shared,
        single_vehicle=single_vehicle,
    )
    constant = np.where(parameters[0] > 0.0, np.sqrt(parameters[0] * parameters[0] + 2.0), parameters[1])
    for event, (h,) in enumerate(shared):
        x, v = state
        one = np.where(x > v, np.sqrt(x * x + 1.0), v)
        np.testing.assert_array_equal(log[event], [np.where(one > 1.0, abs(v), -1.0), constant])
        two = np.where(one > 1.0, np.sqrt(one * one + abs(v)), x)
        state = np.array([0.5 * two - h, constant - one])
    np.testing.assert_array_equal(actual, state)
