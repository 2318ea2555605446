import numpy as np
import pytest

from drake_quad import load_scenario
from drake_quad.linear.closed_loop import decoupled_loop
from drake_quad.linear.hover_fleet import HoverFleet
from drake_quad.scenario.hovering import at_rest, symmetric_hover
from drake_quad.scenario.paths import map_leaves

FIELDS = ("vehicle.mass", "vehicle.rotor_time_constant", "laboratory.command_link.delay_ticks")
# Values of `FIELDS` for three vehicles.
VALUES = np.array([[0.68, 0.05, 1.0], [0.75, 0.04, 2.0], [0.61, 0.08, 0.0]])


@pytest.fixture(scope="module")
def hover_at_rest():
    return symmetric_hover(at_rest(load_scenario("hover")))


@pytest.mark.slow
def test_the_loops_of_a_fleet_equal_those_of_single_scenarios(hover_at_rest):
    fleet = HoverFleet(hover_at_rest, FIELDS)
    loops = fleet(VALUES)
    for row, loop in zip(VALUES, loops, strict=True):
        numbers = dict(zip(FIELDS, row.tolist(), strict=True))
        scenario = map_leaves(hover_at_rest, lambda path, value, numbers=numbers: numbers.get(path, value))
        exact = decoupled_loop(scenario)
        # A delay line is as long as the longest delay in the fleet, so only the poles are compared.
        poles = [np.sort(np.abs(np.linalg.eigvals(A)))[::-1][:20] for A in (loop, exact.A)]
        assert poles[0] == pytest.approx(poles[1], abs=1e-5)
    assert len(fleet.states) == loops.shape[1]


@pytest.mark.slow
def test_chosen_states_have_the_rows_and_columns_of_the_whole_loop(hover_at_rest):
    fleet = HoverFleet(hover_at_rest, FIELDS)
    full_loop = fleet(VALUES)
    rotors = [i for i, name in enumerate(fleet.states) if "rotor_speed" in name]
    for states in (np.array([0, rotors[1]]), np.array([1, 4])):
        np.testing.assert_allclose(fleet(VALUES, states), full_loop[:, states][:, :, states], rtol=0.0, atol=1e-12)


@pytest.mark.long
def test_a_vehicle_that_is_too_heavy_to_hover_has_no_loop(hover_at_rest):
    loops = HoverFleet(hover_at_rest, ["vehicle.mass"])(np.array([[0.68], [50.0]]))
    assert np.isfinite(loops[0]).all()
    assert np.isnan(loops[1]).all()


@pytest.mark.long
def test_a_loop_has_an_equilibrium_if_and_only_if_the_thrust_limits_allow_hover(hover_at_rest):
    # The commanded thrust is 0.3 to 1.8 times the nominal weight, so a mass of 0.204 kg to 1.224 kg can hover.
    mass = np.array([0.203, 0.205, 0.2465, 1.223, 1.225])
    loops = HoverFleet(hover_at_rest, ["vehicle.mass", "vehicle.rotor_time_constant"])(
        np.stack([mass, np.full(5, 0.0819)], axis=1)
    )
    assert np.isfinite(loops).all(axis=(1, 2)).tolist() == [False, True, True, True, False]


@pytest.mark.slow
def test_a_light_vehicle_with_slow_rotors_has_its_exact_poles(hover_at_rest):
    numbers = {"vehicle.mass": 0.2465, "vehicle.rotor_time_constant": 0.0819}
    exact = decoupled_loop(map_leaves(hover_at_rest, lambda path, value: numbers.get(path, value)))
    (loop,) = HoverFleet(hover_at_rest, [*numbers])(np.array([[*numbers.values()]]))
    radius = np.abs(np.linalg.eigvals(loop)).max()
    assert radius == pytest.approx(np.abs(exact.poles()).max(), abs=1e-7)
    assert radius < 0.995
