"""Tests of live flights: sliders and buttons change the simulation, which otherwise equals that of `simulate`."""

from collections import Counter

import numpy as np
import pytest

from drake_quad import load_scenario, simulate
from drake_quad.command_line import live
from drake_quad.visualization.live import LiveFlight
from drake_quad.visualization.replay.scene import local_meshcat

# Scenario, and files that are applied to it.
LIVE_SCENARIOS = [
    ("robustness", []),
    ("neural_fly:still", []),
    ("nanobench", []),
    ("laboratory:nominal", ["controllers/lqg:lqg"]),
    ("figure_eight", ["controllers/raptor:raptor"]),
]


class Page:
    """Meshcat server on whose buttons a test can click."""

    def __init__(self):
        self._meshcat, self.clicks = local_meshcat(), Counter()

    def GetButtonClicks(self, name):
        assert name in self._meshcat.GetButtonNames() or not self.clicks[name]
        return self.clicks[name]

    def __getattr__(self, name):
        return getattr(self._meshcat, name)


@pytest.fixture
def page(monkeypatch):
    result = Page()
    monkeypatch.setattr("drake_quad.visualization.live.QuadrotorVisualizer", NullVisualizer)
    return result


class NullVisualizer:
    """Stub of a visualizer that draws nothing."""

    def __init__(self, *_):
        pass

    def watch(self, simulator):
        simulator.clear_monitor()


def fly_for(flight, seconds):
    """Continue the flight for some seconds, and return the state after the update at the last time."""
    for _ in flight.fly(seconds):
        pass
    flight.simulator.AdvancePendingEvents()
    return flight.state


@pytest.mark.slow
def test_an_untouched_live_flight_equals_the_simulated_flight(page):
    scenario = load_scenario("laboratory:low_wind")
    state = fly_for(LiveFlight(scenario, page, rate=0), 2.0)
    same = simulate(scenario, until=2.0)
    np.testing.assert_allclose(state, same.signals["state"][-1], atol=1e-9)


def test_the_sliders_set_mass_and_gains(page):
    flight = LiveFlight(load_scenario("laboratory:nominal"), page, rate=0)
    page.SetSliderValue("mass (kg)", 0.8)
    page.SetSliderValue("k_p (factor)", 2.0)
    fly_for(flight, 0.5)
    original = load_scenario("laboratory:nominal")
    assert flight.scenario.vehicle.mass == 0.8
    assert flight.scenario.nominal == original.nominal
    np.testing.assert_allclose(flight.scenario.control.position.k_p, 2.0 * np.array(original.control.position.k_p))
    assert flight.scenario.control.position.k_d == original.control.position.k_d
    # A restart keeps the changed parameters, so it equals the flight of a scenario with these parameters.
    page.clicks["start again"] += 1
    state = fly_for(flight, 1.0)
    changed = load_scenario("laboratory:nominal", ["vehicle.mass=0.8", *(
        f"control.position.k_p.{i}={2.0 * original.control.position.k_p[i]}" for i in range(3)
    )])  # fmt: skip
    np.testing.assert_allclose(state, simulate(changed, until=1.0).signals["state"][-1], atol=1e-9)


def test_changed_parameters_do_not_make_the_state_jump(page):
    flight = LiveFlight(load_scenario("laboratory:nominal"), page, rate=0)
    state_before = fly_for(flight, 1.0)
    page.SetSliderValue("mass (kg)", 0.9)
    state_after = fly_for(flight, 1.0 / 32.0)
    np.testing.assert_allclose(state_after[:3], state_before[:3], atol=0.05)
    assert state_after.v_z < state_before.v_z


def test_wind_and_gust_push_the_vehicle_along_x(page):
    state_without_wind = fly_for(LiveFlight(load_scenario("laboratory:nominal"), page, rate=0), 2.0)
    for label in page.GetSliderNames():
        page.DeleteSlider(label)
    for name in page.GetButtonNames():
        page.DeleteButton(name)
    flight = LiveFlight(load_scenario("laboratory:nominal"), page, rate=0)
    page.SetSliderValue("wind X (m/s)", 5.0)
    windy = fly_for(flight, 2.0)
    assert windy.x > state_without_wind.x + 0.05
    page.SetSliderValue("wind X (m/s)", 0.0)
    page.clicks["gust"] += 1
    wind = []
    for _ in flight.fly(2.0):
        wind.append(flight.simulator.get_system().GetOutputPort("wind").Eval(flight.simulator.get_context())[0])
    assert max(wind) == pytest.approx(8.0, rel=0.05)
    assert wind[-1] == 0.0


def test_a_restart_repairs_a_failed_motor(page):
    flight = LiveFlight(load_scenario("laboratory:nominal"), page, rate=0)
    fly_for(flight, 0.5)
    page.clicks["motor fails"] += 1
    fly_for(flight, 4.0)
    assert flight.crashed
    page.clicks["start again"] += 1
    fly_for(flight, 0.5)
    assert not flight.crashed
    assert flight.time == pytest.approx(0.5)


def test_the_position_error_is_displayed_by_sliders(page):
    flight = LiveFlight(load_scenario("laboratory:low_wind"), page, rate=0)
    for _ in flight.fly(3.0):
        pass
    state = flight.state
    reference = flight.simulator.get_system().GetOutputPort("reference").Eval(flight.simulator.get_context())
    error = 100.0 * np.linalg.norm(np.array(state[:3]) - reference[:3])
    assert page.GetSliderValue("error (cm)") == pytest.approx(error, abs=0.06)  # the slider has steps of 0.1 cm
    assert 0.0 < page.GetSliderValue("RMS error, 5 s (cm)") < 200.0


def test_a_live_flight_restarts_at_its_end_and_stops_at_a_click(page):
    flight = LiveFlight(load_scenario("hover", ["duration=0.5"]), page, rate=0)
    times = [*flight.fly(1.2)]
    assert max(times) == pytest.approx(0.5)
    assert np.count_nonzero(np.diff(times) < 0.0) == 2
    page.clicks["stop"] += 1
    assert [*flight.fly()] == []


@pytest.mark.slow
@pytest.mark.parametrize(("scenario", "layers"), LIVE_SCENARIOS)
def test_every_scenario_can_be_flown_live(page, scenario, layers):
    loaded = load_scenario(scenario, layers=layers)
    flight = LiveFlight(loaded, page, rate=0)
    fly_for(flight, 0.5)
    assert flight.time == pytest.approx(0.5)
    assert ("motor fails" in page.GetButtonNames()) == (not loaded.laboratory.autopilot.models_vehicle)


def test_the_command_ends_after_its_time_or_when_it_is_interrupted(monkeypatch, capsys):
    calls = []

    class Flight:
        def __init__(self, scenario, meshcat, *, sample, rate):
            calls.append((scenario.name, meshcat, sample, rate))

        def fly(self, duration):
            calls.append(duration)
            yield 0.1
            raise KeyboardInterrupt

    monkeypatch.setattr("drake_quad.visualization.live.LiveFlight", Flight)
    monkeypatch.setattr(live, "start_meshcat", lambda: "meshcat")
    live.main(live.options().parse_args(["hover", "--time", "3", "--rate", "2"]))
    assert calls == [("hover", "meshcat", 0, 2.0), 3.0]
    printed = capsys.readouterr()
    assert printed.out.splitlines()[-1] == "the flight has ended"
    assert printed.err.startswith(
        "remark: the sliders for wind and the gust have no effect, since the vehicle has no drag"
    )
