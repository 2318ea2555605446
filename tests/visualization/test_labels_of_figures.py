"""Tests of labels, legends and heights of figures.

Every axis of a figure has a label with a unit, every legend identifies the curves, and every row of panels is legible.
"""

import pytest
from figure_content import legends
from test_study_plots import DELAY_PATH, MASS_PATH, no_crash, study

from drake_quad import load_scenario, simulate
from drake_quad.design.cascade import design_cascade
from drake_quad.planning.nominal import planned_parameters
from drake_quad.visualization import design_plots, learning_plots, plots, study_plots
from drake_quad.visualization.comparison_plots import plot_comparison
from drake_quad.visualization.overview import plot_flight, plot_study
from drake_quad.visualization.plan_plots import plot_plan
from drake_quad.visualization.wind_plots import plot_wind

ROTOR_LABELS = ["rotor 1", "rotor 2", "rotor 3", "rotor 4"]
LEG_LABELS = ["rise", "climb", "circle", "straight", "descent", "turn", "curve", "return"]
SET_LABELS = [f"{name} at {centre}" for name in ("error", "rate") for centre in ("−1", "0", "+1")]
# For each figure of a flight: the function that draws it, the labels (x, y) of its axes, and its legend entries.
FLIGHT_FIGURES = {
    "path": (plots.plot_path, [("X (m)", "Y (m)"), ("X (m)", "Y (m)")], ["flown", "reference", "start", *LEG_LABELS]),
    "errors": (plots.plot_errors, [("", "error (cm)"), ("time (s)", "Euclidean error (cm)")], ["X", "Y", "Z"]),
    "attitude": (
        plots.plot_attitude,
        [("", "roll (°)"), ("", "pitch (°)"), ("time (s)", "yaw (°)")],
        ["commanded", "flown"],
    ),
    "rotors": (
        plots.plot_rotors,
        [
            ("", "rotor 1 (rad/s)"),
            ("", "rotor 2 (rad/s)"),
            ("", "rotor 3 (rad/s)"),
            ("time (s)", "rotor 4 (rad/s)"),
            ("time (s)", "rotor speed (rad/s)"),
        ],
        [],
    ),
    "wind": (
        plot_wind,
        [("X (m)", "Y (m)"), ("Y (m)", "Z (m)"), ("time (s)", "wind (m/s)"), ("mean wind speed (m/s)", "")],
        ["reference", "flown", "X", "Y", "Z"],
    ),
    "overview": (
        lambda flight: plot_flight(flight)[0],
        [
            ("X (m)", "Y (m)"),
            ("", "Euclidean error (cm)"),
            ("", "acceleration\ncommand (m/s²)"),
            ("time (s)", "rotor speed (rad/s)"),
        ],
        ["flown", "reference", "start", "X", "Y", "Z", *ROTOR_LABELS],
    ),
    "memberships": (
        learning_plots.plot_network_memberships,
        [("(x - c) / d", "membership"), *[("(x - c) / d", "")] * 3],
        ["upper", "lower"],
    ),
    "learning": (
        learning_plots.plot_learning,
        [
            ("", "command (m/s²)"),
            ("", ""),
            ("", "weights F (m/s²)"),
            ("", ""),
            ("time (s)", "trace of P (1/s)"),
            ("time (s)", ""),
        ],
        ["PD, τ_c", "network, -τ_f", *SET_LABELS],
    ),
    "surfaces": (
        learning_plots.plot_surfaces,
        [
            ("", "error rate (m/s)"),
            ("", ""),
            ("error (m)", "error rate (m/s)"),
            ("error (m)", ""),
            ("", "command of the network, -τ_f (m/s²)"),
        ],
        [],
    ),
    "secant gains": (
        learning_plots.plot_secant_gains,
        [("error (m)", "secant gain of -τ_f (1/s²)"), ("error (m)", "")],
        ["network of the flight", "same network with triangular sets"],
    ),
    "plan": (
        lambda flight: plot_plan(flight.plan, planned_parameters(flight.scenario)),
        [
            ("X (m)", "Y (m)"),
            ("X (m)", "Z (m)"),
            ("Y (m)", "Z (m)"),
            ("", "speed (m/s)"),
            ("", "acceleration (m/s²)"),
            ("", "snap (m/s⁴)"),
            ("", "yaw (°)"),
            ("time (s)", "rotor speed (rad/s)"),
        ],
        ROTOR_LABELS,
    ),
}
# Titles of the panels of each figure.
TITLES = {
    "path": ["Path", "From above"],
    "errors": ["Position error, reference minus flown"],
    "attitude": ["Attitude"],
    "rotors": ["Rotor speeds; black: mean of all rotors", "With the limits"],
    "wind": ["From above: wind at Z = 1.5 m", "From the side: wind at X = −1.2 m", "At the vehicle"],
    "overview": ["From above"],
    "memberships": [
        "Membership functions of type-2 fuzzy sets with centre c and width d",
        *(f"a1 = {a1}, a2 = {a2}" for a1, a2 in ((1, 1), (1.2, 0.8), (1.4, 0.6), (1.6, 0.4))),
    ],
    "learning": [
        "Learning of the fuzzy network: commands, weights of the rules, and covariance P of the weights",
        *("on X", "on Y"),
    ],
    "surfaces": [
        "Command of the fuzzy network for each error and error rate; dots: ticks of the flight",
        *(f"on {axis}, {when} the flight" for axis in "XY" for when in ("before", "after")),
    ],
    "secant gains": [
        "Command of the fuzzy network per error, at the end of the flight",
        *("on X, at rest", "on Y, at rest"),
    ],
    "plan": ["Path, from above and from two sides", "Dotted lines: limits; vertical lines: times of the waypoints"],
}
FRACTION_LABEL = "cumulative share of samples"
SAMPLES_LABEL = "number of samples; bands: 95 % confidence"
# For each figure of studies: the function that draws it, and the labels (x, y) of its axes.
STUDY_FIGURES = {
    "distribution": (lambda: study_plots.plot_distribution({"a": study()}), [("RMSE (cm)", FRACTION_LABEL)]),
    "convergence": (
        lambda: study_plots.plot_convergence({"a": study()}, "peak_error"),
        [(SAMPLES_LABEL, "peak error (cm)"), (SAMPLES_LABEL, "crashed samples")],
    ),
    "quantile": (
        lambda: study_plots.plot_convergence({"a": no_crash()}),
        [(SAMPLES_LABEL, "RMSE (cm)"), (SAMPLES_LABEL, "RMSE (cm)")],
    ),
    "influences": (lambda: study_plots.plot_influences(study(), "crashed"), [("crashed samples", "")]),
    "crashes": (
        lambda: study_plots.plot_crash_probability(study(), MASS_PATH),
        [("vehicle mass (kg)", "crash probability")],
    ),
    "crashes by delay": (
        lambda: study_plots.plot_crash_probability(study(), DELAY_PATH),
        [("latency frames", "crash probability")],
    ),
    "overview": (
        lambda: plot_study({"a": study()})[0],
        [("RMSE (cm)", FRACTION_LABEL), ("mean RMSE (cm)", ""), ("crashed samples", "")],
    ),
    "comparison": (
        lambda: plot_comparison({"calm": {"a": study().metrics}, "gale": {"a": study().metrics}}),
        [("RMSE (cm)", ""), ("RMSE (cm)", "")],
    ),
}


def row_height(figure):
    """Return the height of a figure divided by its number of rows of panels, inches."""
    places = [axes.get_subplotspec() for axes in figure.axes]
    return figure.get_size_inches()[1] / max(place.get_gridspec().nrows for place in places if place is not None)


def labels(figure):
    return [(axes.get_xlabel(), axes.get_ylabel()) for axes in figure.axes]


@pytest.fixture(scope="module")
def flight():
    return simulate(load_scenario("paper:low_wind_pd_t2fnn", ["duration=0.5"]))


@pytest.mark.slow
@pytest.mark.parametrize("name", FLIGHT_FIGURES)
def test_panels_of_a_flight_have_labels_titles_legends_and_a_legible_height(name, flight):
    draw, expected, words = FLIGHT_FIGURES[name]
    figure = draw(flight)
    assert labels(figure) == expected
    assert row_height(figure) >= 1.5
    assert sorted(legends(figure)) == sorted(words)
    titles = [figure.get_suptitle(), *(axes.get_title(loc) for axes in figure.axes for loc in ("center", "left"))]
    assert [title for title in titles if title] == TITLES[name]
    if name == "plan":
        # The three views and the profiles form two columns, each as high as the figure.
        figure.draw_without_rendering()
        for part in (figure.axes[:3], figure.axes[3:]):
            ends = [end for axes in part for end in axes.get_position().intervaly]
            assert min(ends) < 0.1
            assert max(ends) > 0.9
    if name == "path":
        assert figure.axes[0].get_zlabel() == "Z (m)"


@pytest.mark.parametrize("name", STUDY_FIGURES)
def test_panels_of_studies_have_labels_and_a_legible_height(name):
    draw, expected = STUDY_FIGURES[name]
    figure = draw()
    assert labels(figure) == expected
    assert row_height(figure) >= 1.5


@pytest.mark.long
def test_axes_of_designs_have_labels_and_legends():
    design = design_cascade(load_scenario("laboratory:nominal"))
    bode, nyquist, locus = (draw(design) for draw in design_plots.DESIGN_PLOTS.values())
    gain, phase = ("", "Magnitude [dB]"), ("Frequency [rad/s]", "Phase [deg]")
    assert labels(bode) == [gain, gain, phase, phase]
    assert labels(nyquist) == [("Re L", "Im L")] * 2
    assert [text.partition(" margin")[0] for text in legends(nyquist)] == ["L", "|L| = 1", "disk"] * 2
    assert labels(locus) == [("Re s (1/s)", "Im s (1/s)")]
    assert [text.partition(",")[0] for text in legends(locus)] == ["open loop", "as designed", "limit of stability"]
