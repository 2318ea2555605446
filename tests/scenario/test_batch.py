"""Tests that samples of a study have the given distributions and do not depend on other samples or fields."""

import numpy as np
import pytest
import scipy

from drake_quad import InputError
from drake_quad.randomness.streams import parameter_numbers
from drake_quad.scenario.batch import Batch, draw_sample, median_scenario
from drake_quad.scenario.files.loading import load_scenario
from drake_quad.scenario.files.saving import save_scenario
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.paths import distributions_in, value_at

# For each distribution in the scenario language, the name and the arguments of the equivalent SciPy distribution.
SCIPY_DISTRIBUTIONS = {
    "{uniform: {min: 0.6, max: 0.8}}": ("uniform", (0.6, 0.2)),
    "{log_uniform: {min: 0.1, max: 10}}": ("loguniform", (0.1, 10.0)),
    "{normal: {mean: 0.7, standard_deviation: 0.02, min: 0.66}}": ("truncnorm", (-2.0, np.inf, 0.7, 0.02)),
    "{normal: {mean: 0.7, standard_deviation: 0.02, min: 0.69, max: 0.73}}": ("truncnorm", (-0.5, 1.5, 0.7, 0.02)),
}


@pytest.fixture
def study(diagrams):
    return lambda *overrides: load_scenario(diagrams / "figure_eight.yaml", overrides)


@pytest.mark.parametrize("text", SCIPY_DISTRIBUTIONS)
def test_drawn_values_have_the_given_distribution(study, text):
    masses = Batch.draw(study(f"vehicle.mass={text}"), range(4000)).varying["vehicle.mass"]
    assert scipy.stats.kstest(masses, *SCIPY_DISTRIBUTIONS[text]).pvalue > 1e-3


def test_choices_are_equally_likely(study):
    batch = Batch.draw(study("vehicle.rotor_failure={rotor: {choice: [1, 2, 4]}, time: 3}"), range(3000))
    values, counts = np.unique(batch.varying["vehicle.rotor_failure.rotor"], return_counts=True)
    assert values.tolist() == [1.0, 2.0, 4.0]
    assert scipy.stats.chisquare(counts).pvalue > 1e-3


def test_a_sample_does_not_depend_on_the_other_samples(study):
    scenario = study(
        "vehicle.mass={uniform: {min: 0.6, max: 0.8}}",
        "control.position.k_p=[{uniform: {min: 0.5, max: 1}}, 0.8, {normal: {mean: 4, standard_deviation: 1, min: 1}}]",
        "laboratory.wind=[{kind: steady, velocity: [{normal: {mean: 0, standard_deviation: 2}}, 0, 0]}]",
    )
    many = Batch.draw(scenario, range(20), seed=9)
    random_paths = ["vehicle.mass", "control.position.k_p.0", "control.position.k_p.2", "laboratory.wind.0.velocity.0"]
    assert sorted(many.varying) == sorted(random_paths)
    for i in (0, 13):
        sample_scenario = draw_sample(scenario, i, seed=9)
        assert distributions_in(sample_scenario) == {}
        assert (sample_scenario.seed, sample_scenario.sample) == (9, i)
        assert [value_at(sample_scenario, path) for path in random_paths] == [
            many.varying[path][i] for path in random_paths
        ]
        assert sample_scenario.control.position.k_p[1] == 0.8
        assert sample_scenario == many.vehicle_scenario(i)
    assert sample_scenario.vehicle.mass != draw_sample(scenario, 13, seed=8).vehicle.mass


def test_names_of_random_streams_count_rotors_from_0_although_paths_count_from_1(study):
    scenario = study("vehicle.thrust_factor_error=[0, {uniform: {min: 0, max: 1}}, 0, 0]")
    errors = Batch.draw(scenario, range(5), seed=4).varying["vehicle.thrust_factor_error.rotor_2"]
    np.testing.assert_array_equal(errors, parameter_numbers(4, range(5), "vehicle.thrust_factor_error[1]"))


def test_the_draw_of_a_field_does_not_depend_on_other_fields(study):
    mass, drag = "vehicle.mass={uniform: {min: 0.6, max: 0.8}}", "vehicle.linear_drag={uniform: {min: 0, max: 0.3}}"
    with_drag, without_drag = (Batch.draw(scenario, range(50)).varying for scenario in (study(mass, drag), study(mass)))
    np.testing.assert_array_equal(with_drag["vehicle.mass"], without_drag["vehicle.mass"])
    assert abs(np.corrcoef(with_drag["vehicle.mass"], with_drag["vehicle.linear_drag"])[0, 1]) < 0.5


def test_fields_without_distributions_are_not_changed(study):
    scenario = study("vehicle.mass={uniform: {min: 0.6, max: 0.8}}")
    drawn_scenario = Batch.draw(scenario, range(3)).vehicle_scenario(2)
    assert drawn_scenario.control is scenario.control
    assert drawn_scenario.vehicle.model_copy(update={"mass": 0.0}) == scenario.vehicle.model_copy(update={"mass": 0.0})


@pytest.mark.parametrize(
    ("sample", "seed", "words"), [(-1, 0, "sample is -1"), (2**31, 0, "sample is"), (0, -3, "seed is -3")]
)
def test_a_seed_or_sample_index_out_of_range_is_refused(study, sample, seed, words):
    with pytest.raises(InputError, match=words):
        draw_sample(study(), sample, seed=seed)


def test_single_samples_may_have_a_random_route(study):
    """A random route is for single flights. Fleets refuse it, since all their vehicles fly the same route."""
    scenario = study("route.radius={uniform: {min: 1.2, max: 1.4}}")
    batch = Batch.draw(scenario, range(2))
    radii = [draw_sample(scenario, sample).route.radius for sample in range(2)]
    assert radii == batch.varying["route.radius"].tolist()
    assert 1.2 < min(radii) < max(radii) < 1.4


NORMAL_INERTIA = "{normal: {mean: 0.007, standard_deviation: 0.002, min: 0.001}}"


def test_drawn_moments_of_inertia_are_possible_for_a_rigid_body(study):
    """Impossible moments are replaced by the nearest possible ones, and possible moments are kept."""
    scenario = study(f"vehicle.inertia=[{NORMAL_INERTIA}, {NORMAL_INERTIA}, {{uniform: {{min: 0.008, max: 0.016}}}}]")
    batch = Batch.draw(scenario, range(2000))
    fields = [f"vehicle.inertia.{axis}" for axis in range(3)]
    moments = np.array([batch.varying[field] for field in fields])
    distributions = distributions_in(scenario)
    drawn_moments = np.array(
        [distributions[field].quantile(parameter_numbers(0, range(2000), f"vehicle.inertia[{axis}]"))
         for axis, field in enumerate(fields)]
    )  # fmt: skip
    rigid = 2.0 * drawn_moments.max(axis=0) <= drawn_moments.sum(axis=0)
    assert 0.1 < rigid.mean() < 0.9
    np.testing.assert_array_equal(moments[:, rigid], drawn_moments[:, rigid])
    np.testing.assert_allclose(2.0 * moments.max(axis=0)[~rigid], moments.sum(axis=0)[~rigid], rtol=1e-12)
    for sample in np.flatnonzero(~rigid)[:3].tolist():
        sample_scenario = draw_sample(scenario, sample)
        assert sample_scenario.vehicle.inertia == tuple(moments[:, sample].tolist())
        Scenario.model_validate(sample_scenario.model_dump(mode="json"))


def test_only_random_moments_of_inertia_are_adjusted(study):
    """Payload moments, and the medians of all distributions, are adjusted in the same way."""
    scenario = study(f"vehicle.inertia=[{NORMAL_INERTIA}, 0.007, 0.012]")
    varying = Batch.draw(scenario, range(500)).varying
    assert [*varying] == ["vehicle.inertia.0"]
    assert varying["vehicle.inertia.0"].min() == pytest.approx(0.005)
    small_moment = "{uniform: {min: 0.0, max: 0.001}}"
    load = study(f"vehicle.payload={{mass: 0.1, inertia: [{small_moment}, 0.0, 0.0004], time: 1, event: dropped}}")
    moments = Batch.draw(load, range(100)).varying["vehicle.payload.inertia.0"]
    np.testing.assert_allclose(moments, 0.0004)
    assert median_scenario(
        study("vehicle.inertia=[{uniform: {min: 0.001, max: 0.006}}, 0.007, 0.012]")
    ).vehicle.inertia == (
        pytest.approx(0.005),
        0.007,
        0.012,
    )


def test_samples_agree_with_earlier_releases(study):
    """Earlier releases wrote list indices in brackets. The names of random streams still have this form."""
    inertia = "vehicle.inertia=[0.007, {uniform: {min: 0.006, max: 0.008}}, 0.012]"
    varying = Batch.draw(study("vehicle.mass={uniform: {min: 0.6, max: 0.8}}", inertia), [0, 1, 41], seed=7).varying
    mass = [0.6051061415534328, 0.675789840234045, 0.7823762288316]
    np.testing.assert_allclose(varying["vehicle.mass"], mass, rtol=1e-15)
    i_yy = [0.006546025953714323, 0.007672538768473312, 0.006975803251878302]
    np.testing.assert_allclose(varying["vehicle.inertia.1"], i_yy, rtol=1e-15)


def test_scenarios_of_a_batch_can_be_written_and_read(study, tmp_path):
    """The study's scenario is written with its distributions, and each vehicle's scenario with its drawn values."""
    scenario = study("vehicle.mass={uniform: {min: 0.6, max: 0.8}}", "laboratory.command_link.delay_ticks=2")
    batch = Batch.draw(scenario, [3, 8], seed=5)
    assert [*distributions_in(batch.scenario)] == ["vehicle.mass"]
    for i, each in enumerate((batch.scenario, batch.vehicle_scenario(0), batch.vehicle_scenario(1))):
        path = tmp_path / f"{i}.yaml"
        save_scenario(each, path)
        assert load_scenario(path) == each


def test_fields_without_distributions_can_vary_in_a_batch(study):
    """The test varies a gain, which is a list item, and a whole number of ticks."""
    batch = Batch.draw(study("vehicle.mass={uniform: {min: 0.6, max: 0.8}}"), [4, 1, 7])
    varying = {
        "control.position.k_p.1": np.array([1.0, 2.0, 3.0]),
        "laboratory.command_link.delay_ticks": np.array([0.0, 2.0, 1.0]),
    }
    changed_batch = batch.with_varying(varying)
    assert (len(changed_batch), changed_batch.samples, changed_batch.scenario) == (3, (4, 1, 7), batch.scenario)
    for i in range(3):
        changed_scenario, original_scenario = changed_batch.vehicle_scenario(i), batch.vehicle_scenario(i)
        assert changed_scenario.control.position.k_p[1] == i + 1.0
        assert changed_scenario.laboratory.command_link.delay_ticks == varying["laboratory.command_link.delay_ticks"][i]
        assert (changed_scenario.vehicle, changed_scenario.control.position.k_d) == (
            original_scenario.vehicle,
            original_scenario.control.position.k_d,
        )
    assert [*batch.varying] == ["vehicle.mass"]


def test_a_padded_batch_repeats_its_last_vehicle(study):
    batch = Batch.draw(study("vehicle.mass={uniform: {min: 0.6, max: 0.8}}"), [4, 1]).padded(5)
    assert (len(batch), batch.samples) == (5, (4, 1, 1, 1, 1))
    masses = batch.varying["vehicle.mass"]
    assert masses[0] != masses[1]
    np.testing.assert_array_equal(masses[2:], masses[1])


def test_fields_of_a_fleet_scenario_are_arrays_only_if_their_values_vary(asymmetric):
    """Varying values may be items of lists, or fields of mappings in lists."""
    scenario = asymmetric("pid", "vehicle.mass={uniform: {min: 0.6, max: 0.8}}")
    varying = {"laboratory.wind.1.velocity.2": np.array([1.0, 2.0]), "vehicle.inertia.1": np.array([3.0, 4.0])}
    batch = Batch.draw(scenario, [7, 2]).with_varying(varying)
    fleet = batch.fleet_scenario
    np.testing.assert_array_equal(fleet.vehicle.mass, batch.varying["vehicle.mass"])
    assert fleet.vehicle.inertia == (0.0071, pytest.approx([3.0, 4.0]), 0.0131)
    assert fleet.laboratory.wind[1].velocity == (-1.5, 1.2, pytest.approx([1.0, 2.0]))
    assert fleet.laboratory.wind[0].velocity == scenario.laboratory.wind[0].velocity
    assert fleet.laboratory.wind[1].kind == "gust"
    assert fleet.control.position.k_p == scenario.control.position.k_p
    with pytest.raises(AttributeError):
        _ = fleet.vehicle.wings
