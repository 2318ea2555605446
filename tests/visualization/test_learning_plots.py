"""Tests that plots of a network show its commands, its weights and its correction of the command."""

import itertools

import numpy as np
import pytest
from matplotlib.colors import to_hex

from drake_quad import load_scenario, simulate
from drake_quad.control.fuzzy.inference import Antecedents
from drake_quad.visualization import learning_plots as plots


@pytest.fixture(scope="module")
def flight():
    return simulate(load_scenario("paper:low_wind_pd_t2fnn", ["duration=3"]))


def elliptic(u, a):
    """Return the membership function of a set with centre 0 and width 1 (Kayacan and Maslim 2016, eq. 16)."""
    return np.where(np.abs(u) < 1.0, np.maximum(1.0 - np.abs(u) ** a, 0.0) ** (1.0 / a), 0.0)


def test_memberships_match_the_formula():
    figure = plots.plot_memberships([(1.0, 1.0), (1.6, 0.4)])
    for axes, (a1, a2) in zip(figure.axes, ((1.0, 1.0), (1.6, 0.4)), strict=True):
        upper, lower = axes.lines
        u = upper.get_xdata()
        assert (u[0], u[-1]) == (-1.2, 1.2)
        np.testing.assert_allclose(upper.get_ydata(), elliptic(u, a1), atol=1e-12)
        np.testing.assert_allclose(lower.get_ydata(), elliptic(u, a2), atol=1e-12)
        assert axes.get_title() == f"a1 = {a1:g}, a2 = {a2:g}"
        assert len(axes.collections) == 1
    assert [text.get_text() for text in figure.axes[-1].get_legend().get_texts()] == ["upper", "lower"]
    assert len(plots.plot_memberships().axes) == 4


@pytest.mark.slow
def test_the_exponents_of_the_network_have_a_panel(flight):
    sets = flight.scenario.control.network.antecedents()
    titles = [axes.get_title() for axes in plots.plot_network_memberships(flight).axes]
    label_of_network = f"a1 = {sets.a1:g}, a2 = {sets.a2:g}"
    assert label_of_network in titles
    assert len(titles) == len(set(titles)) == (4 if (sets.a1, sets.a2) in plots.PAPER_EXPONENTS else 5)
    assert titles[0] == "a1 = 1, a2 = 1"


def test_learning_is_shown_for_each_axis(flight):
    figure = plots.plot_learning(flight)
    network = flight.scenario.control.network
    names = sorted(network.axes)
    rows = np.array(figure.axes).reshape(-1, len(names))
    weights = flight["weights"].reshape(len(flight.time), len(names), -1)
    for column, axis in enumerate(names):
        commanded, learned = rows[0, column], rows[1, column]
        assert commanded.get_title(loc="left") == f"on {axis.upper()}"
        pd, correction = commanded.lines
        np.testing.assert_array_equal(pd.get_xydata().T, [flight.time, getattr(flight.record("pd"), axis)])
        np.testing.assert_array_equal(correction.get_ydata(), -getattr(flight.record("correction"), axis))
        assert len(learned.lines) == weights.shape[2] == 9
        for line in learned.lines:
            (rule,) = [i for i in range(9) if np.array_equal(weights[:, column, i], line.get_ydata())]
            # Rule 3 i + j combines fuzzy set i of the error with fuzzy set j of the error rate.
            error, rate = divmod(rule, 3)
            assert line.get_label() == f"{(-1, 0, 1)[error]:g}, {(-1, 0, 1)[rate]:g}"
            assert to_hex(line.get_color()) == plots._COLORS[error].lower()
        if len(rows) > 2:
            trace = np.reshape(flight["covariance_trace"], (len(flight.time), -1))[:, column]
            np.testing.assert_array_equal(rows[2, column].lines[0].get_ydata(), trace)
            assert rows[2, column].get_ylim()[0] == 0.0
    assert rows[-1, 0].get_xlabel() == "time (s)"
    assert [text.get_text() for text in rows[0, 0].get_legend().get_texts()] == ["PD, τ_c", "network, -τ_f"]
    assert rows[1, -1].get_legend() is not None


@pytest.mark.long
def test_an_adaptation_law_without_a_covariance_has_no_trace_panel():
    for law, rows in (("{kind: gradient, slope: 2.1, rate: 1.0}", 2), ("{kind: covariance, slope: 2.1}", 3)):
        flight = simulate(load_scenario("paper:low_wind_pd_t2fnn", ["duration=0.1", f"control.network.learning={law}"]))
        assert len(plots.plot_learning(flight).axes) == rows * len(flight.scenario.control.network.axes)


def network_output(sets, weights, error, rate):
    """Return the output of a network: the mean of the outputs with the upper and with the lower memberships."""
    strengths_by_exponent = []
    for a in (sets.a1, sets.a2):
        strengths = []
        for e, r in itertools.product(range(3), range(3)):
            first, second = sets.inputs
            u = (first.scale * error - first.centres[e]) / first.widths[e]
            v = (second.scale * rate - second.centres[r]) / second.widths[r]
            strengths.append(elliptic(u, a) * elliptic(v, a))
        strengths_by_exponent.append(np.array(strengths))
    upper, lower = strengths_by_exponent
    return 0.5 * (
        np.tensordot(weights, upper, 1) / np.maximum(upper.sum(axis=0), 1e-300)
        + np.tensordot(weights, lower, 1) / np.maximum(lower.sum(axis=0), 1e-300)
    )


def test_surfaces_show_the_correction_before_and_after_the_flight(flight):
    figure = plots.plot_surfaces(flight)
    sets = flight.scenario.control.network.antecedents()
    names = sorted(flight.scenario.control.network.axes)
    weights = flight["weights"].reshape(len(flight.time), len(names), -1)
    panels = np.array(figure.axes[: 2 * len(names)]).reshape(len(names), 2)
    top = max(float(np.abs(axes.collections[0].get_array()).max()) for axes in panels.ravel())
    for row, axis in zip(panels, names, strict=True):
        for axes, tick, when in zip(row, (0, -1), ("before", "after"), strict=True):
            mesh = axes.collections[0]
            corners = mesh.get_coordinates()
            cell_centres = 0.5 * (corners[:-1, :-1] + corners[1:, 1:])
            error, rate = cell_centres[..., 0], cell_centres[..., 1]
            assert error.min() == pytest.approx(-1.05 / sets.inputs[0].scale)
            assert rate.max() == pytest.approx(1.05 / sets.inputs[1].scale)
            inside = (np.abs(error * sets.inputs[0].scale) < 0.95) & (np.abs(rate * sets.inputs[1].scale) < 0.95)
            expected = -network_output(sets, weights[tick, names.index(axis)], error, rate)
            drawn_values = np.asarray(mesh.get_array()).reshape(error.shape)
            np.testing.assert_allclose(drawn_values[inside], expected[inside], atol=1e-6 + 1e-3 * top)
            assert (mesh.norm.vmin, mesh.norm.vmax) == pytest.approx((-max(top, 1e-9), max(top, 1e-9)))
            assert axes.get_title() == f"on {axis.upper()}, {when} the flight"
            flown_inputs = axes.lines[0].get_xydata().T
            np.testing.assert_array_equal(flown_inputs[0], getattr(flight.record("error"), axis))
            np.testing.assert_array_equal(flown_inputs[1], getattr(flight.record("error_rate"), axis))


def test_a_secant_gain_is_the_change_of_the_output_divided_by_the_error(flight):
    sets: Antecedents = flight.scenario.control.network.antecedents()
    weights = np.random.default_rng(2).normal(size=9)
    errors = (0.002, 0.03)
    own_gains, triangular_gains = plots.secant_gains(sets, weights, errors)
    for result, each in ((own_gains, sets), (triangular_gains, sets._replace(a1=1.0, a2=1.0))):
        at_rest = network_output(each, weights, np.zeros(1), np.zeros(1))
        expected = [(network_output(each, weights, np.array([e]), np.zeros(1)) - at_rest)[0] / e for e in errors]
        np.testing.assert_allclose(result, expected, rtol=1e-6)
    figure = plots.plot_secant_gains(flight)
    assert [text.get_text() for text in figure.legends[0].get_texts()] == [
        "network of the flight",
        "same network with triangular sets",
    ]
    axes = figure.axes[0]
    learned = flight["weights"][-1, :9]
    curve, counterpart = axes.lines[:2]
    max_error = 1.0 / sets.inputs[0].scale
    assert (curve.get_xdata()[0], curve.get_xdata()[-1]) == pytest.approx((5e-4, max_error))
    expected = [-each for each in plots.secant_gains(sets, learned, tuple(curve.get_xdata()))]
    np.testing.assert_allclose([curve.get_ydata(), counterpart.get_ydata()], expected)
    marks = [line.get_xydata()[0] for line in axes.lines[2:]]
    assert [mark[0] for mark in marks] == [0.001, 0.01, 0.05]
    for (error, gain), text in zip(marks, axes.texts, strict=True):
        assert gain == pytest.approx(-plots.secant_gains(sets, learned, (error,))[0][0], rel=0.02)
        assert text.get_text() == f"{gain:.2f}"
        assert text.xy == (error, gain)
