"""What the numbers of a scenario become in the systems of its laboratory, one after another."""

import math

import numpy as np
import pytest

from drake_quad import InputError
from drake_quad.laboratory.flight_monitor import CrashLimits
from drake_quad.laboratory.motion_capture import CameraErrors
from drake_quad.laboratory.wind.dryden import WIND_AT_20_FEET, Turbulence
from drake_quad.assembly.laboratory import laboratory_parts, monitor_part, vehicle_parameters
from drake_quad.assembly.planning import plan_route
from drake_quad.scenario import draw_sample

DURATION = 16.0


@pytest.fixture(scope="module")
def parts(asymmetric):
    scenario = asymmetric("pid")
    return laboratory_parts(scenario, scenario, plan_route(scenario), DURATION, 1)


def test_the_vehicle_is_as_the_scenario_has_it(asymmetric):
    scenario = asymmetric("pid")
    found = vehicle_parameters(scenario.vehicle)
    np.testing.assert_allclose(found.thrust_factor, [4.1492e-5, 4.018e-5, 4.1656e-5, 4.1205e-5], rtol=1e-12)
    assert found.centre_of_mass == (-0.0003, 0.0008)
    for name in found._fields:
        if name != "thrust_factor":
            assert getattr(found, name) == getattr(scenario.vehicle, name)


def test_the_battery_sags_over_the_whole_flight(parts):
    faults = parts["vehicle"].options["faults"]
    assert faults.battery_sag == pytest.approx(0.02 / DURATION, rel=1e-15)
    assert (faults.failure_time, tuple(faults.failure_factor)) == (6.003, (1.0, 0.993, 1.0, 1.0))


@pytest.mark.parametrize("rotor", [1, 2, 3, 4])
def test_the_rotor_that_fails_is_the_one_of_that_number(asymmetric, rotor):
    scenario = asymmetric("pid", f"vehicle.rotor_failure.rotor={rotor}")
    options = laboratory_parts(scenario, scenario, plan_route(scenario), DURATION, 1)["vehicle"].options
    expected = np.ones(4)
    expected[rotor - 1] = 0.993
    np.testing.assert_array_equal(options["faults"].failure_factor, expected)


def test_the_vehicle_starts_where_the_plan_does(parts):
    options = parts["vehicle"].options
    np.testing.assert_allclose(
        [*options["initial_position"], options["initial_yaw"]], [0.3, -0.2, 1.0, 0.4], atol=1e-12
    )


def test_on_board_and_on_the_link_the_nominal_numbers_hold(parts):
    rotors = parts["allocation"].options["rotors"]
    assert tuple(rotors) == pytest.approx((4.0e-5, 1.1e-6, 0.16, 194.0, 223.0), rel=1e-12)
    radio = parts["command_link"].options
    assert radio["initial"] == pytest.approx((0.7 * 9.79, 0.0, 0.0, 0.0))
    assert (radio["delay_ticks"], radio["loss_rate"], radio["period"]) == (1, 0.03, 0.02)


def test_the_cameras_have_the_errors_of_the_scenario(parts):
    options = parts["motion_capture"].options
    assert options["errors"] == CameraErrors(0.0012, 0.003, 0.03, (0.006, -0.009, 0.04))
    assert (options["derivative_bandwidth"], options["latency_frames"], options["longest_latency"]) == (70.0, 2, 2)


def test_wind_is_made_of_its_sources(parts):
    winds = {path.removeprefix("wind."): part.options for path, part in parts.items() if path.startswith("wind.")}
    assert list(winds) == ["steady", "gust_0", "gust_1", "dryden_0", "dryden_1", "fans"]
    np.testing.assert_array_equal(winds["steady"]["source_value"], [0.7, -0.5, 0.3])
    assert tuple(winds["gust_0"]["gust"]) == ((-1.5, 1.2, -0.6), 3.0, 0.8, 1.3)
    (x, y, z), *times = winds["gust_1"]["gust"]
    assert (x, y, z) == pytest.approx((1.4 * math.cos(0.9), 1.4 * math.sin(0.9), 0.0))
    assert times == [9.0, 1.1, math.inf]
    # The first goes by with the steady wind, which is slower than 1 m/s.
    for name, level, share, height, airspeed, heading in (
        ("dryden_0", "light", 0.5, 4.0, 1.0, 0.7),
        ("dryden_1", "moderate", 0.1, 3.5, 3.0, -1.9),
    ):
        turbulence = Turbulence.at_low_altitude(
            height=height, wind_at_20_feet=share * WIND_AT_20_FEET[level], airspeed=airspeed
        )
        assert (winds[name]["turbulence"], winds[name]["heading"]) == (turbulence, heading)
    first, second = winds["fans"]["jets"]
    assert (first.position, second.position) == ((-2.5, -1.0, 0.9), (2.5, 1.5, 1.8))
    assert (first.turbulence, second.turbulence) == (0.2, 0.25)
    np.testing.assert_allclose(np.cross(second.direction, (-2.0, -1.5, -0.3)), 0.0, atol=1e-15)
    assert second.exit_speed == pytest.approx(4.0 * 1.9 / (math.pi * 0.6**2))
    assert all(options["period"] == 0.01 for name, options in winds.items() if name != "steady")


def test_a_step_is_too_long_for_drag_that_stops_a_vehicle_within_two_fifths_of_it(asymmetric):
    """(c₁ + 2 c₂ |v|) / m times the step, in all the wind that there can be, is at most 2.5."""
    fans = sum(4.0 * flow / (math.pi * diameter**2) for flow, diameter in ((2.3, 0.8), (1.9, 0.6)))
    gusts = math.hypot(1.5, 1.2, 0.6) + 1.4
    airspeed = math.hypot(0.7, 0.5, 0.3) + gusts + fans
    most = 2.5 * 0.74 / 0.01 - 2.0 * 0.02 * airspeed
    for share, fits in ((1.0 - 1e-9, True), (1.0 + 1e-9, False)):
        scenario = asymmetric("pid", f"vehicle.linear_drag={share * most!r}")
        plan = plan_route(scenario)
        if fits:
            laboratory_parts(scenario, scenario, plan, DURATION, 1)
        else:
            with pytest.raises(InputError, match="vehicle.time_step is 0.01 s, too long for this much drag"):
                laboratory_parts(scenario, scenario, plan, DURATION, 1)


def test_there_is_room_for_the_longest_delay_that_can_be_drawn(asymmetric):
    delays = ["laboratory.motion_capture.latency_frames={choice: [3, 1, 2]}"]
    scenario = asymmetric("pid", *delays, "laboratory.command_link.delay_ticks={choice: [0, 4, 1]}")
    found = laboratory_parts(scenario, draw_sample(scenario, 0), plan_route(scenario), DURATION, 1)
    assert found["motion_capture"].options["longest_latency"] == 3
    assert found["command_link"].options["longest_delay"] == 4


def test_turbulence_goes_by_with_the_steady_wind_and_along_it_where_it_does_not_say(asymmetric):
    sources = "[{kind: steady, velocity: [1, 2, 3]}, {kind: steady, velocity: [1, -6, -2]}, {kind: dryden}]"
    scenario = asymmetric("pid", f"laboratory.wind={sources}")
    options = laboratory_parts(scenario, scenario, plan_route(scenario), DURATION, 1)["wind.dryden_0"].options
    assert options["turbulence"].airspeed == pytest.approx(math.sqrt(21.0))
    assert options["heading"] == pytest.approx(math.atan2(-4.0, 2.0))


def test_the_referee_has_the_limits_and_the_window_of_the_scenario(asymmetric):
    options = monitor_part(asymmetric("pid", "crash={tilt: 1.1, position_error: 3.0, height: -0.2}"), 1).options
    assert options["limits"] == CrashLimits(1.1, 3.0, -0.2)
    assert (options["window"], options["period"]) == ((1.0, 13.0), 0.02)
    assert monitor_part(asymmetric("pid", "metrics.end=null"), 1).options["window"] == (1.0, math.inf)
