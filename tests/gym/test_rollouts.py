"""Tests of replayed episodes and of rendered frames."""

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from mpl_toolkits.mplot3d import proj3d

from drake_quad import load_scenario
from drake_quad.flight.mission import plan_route
from drake_quad.gym import QuadrotorEnv, QuadrotorVectorEnv
from drake_quad.signals import Reference, State
from drake_quad.visualization.frames import Camera
from drake_quad.visualization.replay.page import save_replay


@pytest.mark.long
def test_the_last_episode_is_replayed_with_all_signals(tmp_path):
    env = QuadrotorEnv("laboratory:low_wind", {"crash.position_error": 0.3}, action="attitude")
    for seed in (4, 5):
        env.reset(seed=seed)
        terminated, observations, random = False, [], np.random.default_rng(seed)
        while not terminated:
            observation, _, terminated, _, info = env.step(random.uniform(-0.3, 0.3, 4))
            observations.append(observation)
    flight = env.flight()
    assert env.episode() == (5, 0)
    assert flight.metrics.rmse == info["flight"]["rmse"]
    assert flight.metrics.crash_time == info["flight"]["crash_time"] == pytest.approx(0.02 * len(observations))
    np.testing.assert_allclose(flight["observation"][1:], observations, rtol=1e-6, atol=1e-6)
    page = save_replay({"a rollout": flight}, tmp_path / "replay.html")
    assert "a rollout" in page.read_text(encoding="utf-8")
    # After its first tick, the current episode is replayed instead of the last one.
    env.reset()
    assert env.flight().metrics.rmse == flight.metrics.rmse
    env.step(np.zeros(4))
    assert len(env.flight().time) == 2


def test_a_reset_ends_an_episode():
    envs = QuadrotorVectorEnv("hover", {"duration": 0.2}, num_envs=2, record=True)
    envs.reset(seed=0)
    for _ in range(3):
        envs.step(np.zeros((2, 3)))
    envs.reset(options={"reset_mask": np.array([False, True])})
    envs.step(np.zeros((2, 3)))
    assert [len(envs.flight(i).time) for i in range(2)] == [5, 4]
    for _ in range(8):
        envs.step(np.zeros((2, 3)))
    # The first vehicle has completed its episode of ten ticks, and the second one has not flown since its reset.
    assert [len(envs.flight(i).time) for i in range(2)] == [11, 4]
    assert [envs.episode(i).sample for i in range(2)] == [1, 1]


def test_the_current_episode_is_replayed_up_to_its_current_tick():
    envs = QuadrotorVectorEnv("hover", num_envs=3, record=True)
    envs.reset(seed=0)
    for _ in range(10):
        envs.step(np.full((3, 3), 0.2))
    flight = envs.flight(2)
    assert flight.time[-1] == pytest.approx(0.2)
    assert flight.scenario.seed == 2
    np.testing.assert_allclose(flight["state"][-1], envs._fleet.outputs("state")[2], atol=1e-12)


def test_a_complete_episode_is_replayed_to_its_last_tick():
    states = []
    env = QuadrotorEnv("hover", {"duration": 0.2}, reward=lambda step: states.append(step.state) or step.time)
    env.reset(seed=0)
    for k in range(10):
        *_, truncated, _ = env.step(np.array([0.1, -0.1, 0.05 * k]))
    assert truncated
    state = env.flight()["state"]
    np.testing.assert_allclose(state[1:], np.squeeze(states), atol=1e-12)
    np.testing.assert_allclose(env.flight()["action"][:10, 2], 0.05 * np.arange(10))


@pytest.mark.long
def test_rendered_frames_show_the_vehicle_at_its_position():
    overrides = {"space.obstacles.pillar": {"kind": "cylinder", "centre": [1.5, 0, 1], "radius": 0.2, "height": 2}}
    envs = QuadrotorVectorEnv("figure_eight", overrides, num_envs=2, render_mode="rgb_array")
    assert QuadrotorVectorEnv("hover").render() is None
    envs.reset(seed=0)
    first = envs.render()
    assert [frame.shape for frame in first] == [(360, 480, 3)] * 2
    assert first[0].dtype == np.uint8
    for _ in range(40):
        envs.step(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))
    hanging, climbing = envs.render()
    changed = (hanging != climbing).any(axis=2)
    assert 50 < changed.sum() < 5000
    # The blue pixels of a frame show the vehicle. On average, they are at least 10 pixels higher if the vehicle climbs.
    blue = [frame[..., 2].astype(int) - frame[..., 0] > 60 for frame in (hanging, climbing)]
    low, high = (np.argwhere(where)[:, 0].mean() for where in blue)
    assert high < low - 10
    np.testing.assert_array_equal(envs.render()[0], hanging)


@pytest.mark.parametrize("vehicle", ["racer", "crazyflie"])
def test_the_front_rotor_is_red_and_small_vehicles_are_drawn_larger(vehicle):
    scenario = load_scenario("figure_eight", layers=[f"vehicles/{vehicle}"])
    camera = Camera(scenario, plan_route(scenario))
    position, yaw = np.array([0.5, -0.3, 1.2]), 2.0
    rows = np.array([*position, 0.0, 0.0, yaw, *[0.0] * 6])[:, np.newaxis]
    (frame,) = camera.frames(State(*rows), Reference(*np.full((11, 1), 99.0)))

    def pixels(color):
        """Return the positions of the pixels of a colour, from the left and from the bottom."""
        rgb = 255.0 * np.array(to_rgb(color))
        up, across = np.nonzero(np.abs(frame - rgb).max(axis=2) < 30.0)
        return across, len(frame) - up

    def projected(point):
        across, up, _ = proj3d.proj_transform(*point, camera._projection)
        return camera._axes.transData.transform((across, up))

    middle, ahead = projected(position), projected(position + 0.1 * np.array([np.cos(yaw), np.sin(yaw), 0.0]))
    towards = np.mean(pixels("tab:red"), axis=1) - middle
    assert towards @ (ahead - middle) / np.linalg.norm(towards) / np.linalg.norm(ahead - middle) > 0.8
    # The blue rotors of each vehicle are more than 20 pixels apart, although the Crazyflie is much smaller.
    across, _ = pixels("tab:blue")
    assert np.ptp(across) > 20


def test_a_rendered_scene_fills_its_frame():
    """The scene with its labels fills the frame, and is centred within a tenth of the size of the frame."""
    scenario = load_scenario("figure_eight")
    camera = Camera(scenario, plan_route(scenario))
    (frame,) = camera.frames(State(*np.full((12, 1), np.nan)), Reference(*np.full((11, 1), 99.0)))
    up, across = np.nonzero((frame < 255).any(axis=2))
    height, width = frame.shape[:2]
    margins = [across.min(), width - 1 - across.max(), up.min(), height - 1 - up.max()]
    assert min(margins[:2]) < 0.06 * width or min(margins[2:]) < 0.06 * height
    assert abs(margins[0] - margins[1]) < 0.1 * width
    assert abs(margins[2] - margins[3]) < 0.1 * height
