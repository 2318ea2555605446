"""Tests of the back end for Crazyswarm2 with a stand-in for Crazyswarm2's classes."""

import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drake_quad import InputError
from drake_quad.worlds.crazyswarm2 import Backend

# Speed of the four motors, 1/min, at which the Crazyflie of the data sheet hovers: sqrt(weight / (4 b)) with the mass
# 31.9 g and the thrust factor b = 1.983e-8 N s².
HOVER_RPM = 60.0 / (2.0 * np.pi) * np.sqrt(0.0319 * 9.81 / (4.0 * 1.983e-8))


class State:
    """State with the interface of `crazyflie_sim.sim_data_types.State`."""

    def __init__(self, pos=(0.0, 0.0, 0.0), vel=(0.0, 0.0, 0.0), quat=(1.0, 0.0, 0.0, 0.0), omega=(0.0, 0.0, 0.0)):
        self.pos, self.vel, self.quat, self.omega = (np.array(each, dtype=float) for each in (pos, vel, quat, omega))


def actions(*speeds):
    return [SimpleNamespace(rpm=np.broadcast_to(each, 4)) for each in speeds]


def fly(backend, commands, seconds):
    states = [State()] * len(commands)
    for _ in range(round(seconds / backend.dt)):
        states = backend.step(states, commands)
    return states


def without_downwash(states):
    backend = type("Alone", (Backend,), {"downwash": None})
    return backend(None, [f"cf{k}" for k in range(len(states))], states)


def test_vehicles_hover_rise_and_fall():
    backend = without_downwash([State(pos=(float(k), 0.0, 1.0)) for k in range(3)])
    fly(backend, actions(HOVER_RPM, HOVER_RPM, HOVER_RPM), 0.5)  # the rotors accelerate from rest
    before = fly(backend, actions(HOVER_RPM, 1.1 * HOVER_RPM, 0.0), 0.5)
    after = fly(backend, actions(HOVER_RPM, 1.1 * HOVER_RPM, 0.0), 0.2)
    changes = [(second.vel[2] - first.vel[2]) / 0.2 for first, second in zip(before, after, strict=True)]
    assert changes[0] == pytest.approx(0.0, abs=0.15)
    assert changes[1] == pytest.approx(0.21 * 9.81, rel=0.15)
    assert changes[2] == pytest.approx(-9.81, rel=0.1) or after[2].pos[2] == 0.0
    assert backend.time() == pytest.approx(1.2)
    assert [state.pos[0] for state in after] == pytest.approx([0.0, 1.0, 2.0], abs=0.01)


@pytest.mark.parametrize(
    ("motors", "axis", "sign"), [((0, 1), 0, -1), ((2, 3), 0, 1), ((0, 3), 1, -1), ((1, 2), 1, 1), ((1, 3), 2, 1)]
)
def test_motors_have_the_places_and_directions_of_the_crazyflie(motors, axis, sign):
    """Motors 1 to 4 are front right, rear right, rear left and front left. Motor 1 turns anticlockwise."""
    backend = without_downwash([State(pos=(0.0, 0.0, 1.0))])
    speeds = np.full(4, HOVER_RPM)
    speeds[[*motors]] *= 1.05
    (state,) = fly(backend, actions(speeds), 0.05)
    assert np.argmax(abs(state.omega)) == axis
    assert np.sign(state.omega[axis]) == sign


def test_attitudes_are_quaternions_and_velocities_are_in_the_world():
    x, y, z, w = Rotation.from_euler("ZYX", [0.7, 0.2, -0.1]).as_quat()
    start = State(pos=(0.0, 0.0, 2.0), vel=(1.0, 0.0, 0.0), quat=(w, x, y, z))
    (state,) = fly(without_downwash([start]), actions(0.0), 0.01)
    np.testing.assert_allclose(state.quat, start.quat, atol=1e-3)
    np.testing.assert_allclose(state.vel, [1.0, 0.0, -0.098], atol=0.01)
    assert state.pos[0] == pytest.approx(0.01, rel=0.01)


def test_a_vehicle_rests_on_the_ground_and_takes_off():
    backend = without_downwash([State(quat=(np.cos(0.2), 0.0, 0.0, np.sin(0.2)))])
    (state,) = fly(backend, actions(0.0), 0.1)
    assert (state.pos[2], abs(state.vel).max(), abs(state.omega).max()) == (0.0, 0.0, 0.0)
    np.testing.assert_allclose(state.quat, [np.cos(0.2), 0.0, 0.0, np.sin(0.2)], atol=1e-12)
    (state,) = fly(backend, actions(1.2 * HOVER_RPM), 0.6)
    assert state.pos[2] > 0.05


def test_a_vehicle_below_another_one_is_pushed_down():
    starts = [State(pos=(0.0, 0.0, 2.0)), State(pos=(0.0, 0.0, 1.5))]
    pushed = Backend(None, ["upper", "lower"], starts)
    alone = without_downwash(starts)
    lower = [fly(each, actions(HOVER_RPM, HOVER_RPM), 0.02)[1].vel[2] for each in (pushed, alone)]
    # The published force at a distance of 0.5 m is 0.303 N.
    assert lower[0] - lower[1] == pytest.approx(-0.303 / 0.0319 * 0.02, rel=0.03)


def test_the_time_is_published_as_a_clock(monkeypatch):
    clock = ModuleType("rosgraph_msgs.msg")
    clock.Clock = SimpleNamespace
    times = ModuleType("rclpy.time")
    times.Time = lambda seconds: SimpleNamespace(to_msg=lambda: seconds)
    modules = {"rclpy": ModuleType("rclpy"), "rclpy.time": times, "rosgraph_msgs": ModuleType("rosgraph_msgs")}
    for name, module in {**modules, "rosgraph_msgs.msg": clock}.items():
        monkeypatch.setitem(sys.modules, name, module)
    published = []
    publisher = SimpleNamespace(publish=lambda message: published.append(message.clock))
    node = SimpleNamespace(create_publisher=lambda kind, topic, depth: publisher)
    backend = Backend(node, ["cf"], [State(pos=(0.0, 0.0, 1.0))])
    fly(backend, actions(0.0), 0.0015)
    backend.shutdown()
    assert published == pytest.approx([0.0005, 0.001, 0.0015])


def test_input_that_does_not_fit_is_refused():
    for vehicle, words in (("vehicles/paper", "choose a layout of kind x"), ("nanobench", "has motors with throttles")):
        backend = type("Other", (Backend,), {"vehicle": vehicle})
        with pytest.raises(InputError, match=words):
            backend(None, ["cf"], [State()])
    for names in ([], ["a", "b"]):
        with pytest.raises(InputError, match="give a state for each vehicle"):
            Backend(None, names, [State()])
    backend = Backend(None, ["cf"], [State()])
    for given in ([], actions(np.nan), [SimpleNamespace(rpm=[1.0, 2.0, 3.0])]):
        with pytest.raises(InputError, match="each vehicle needs an action with four finite motor speeds"):
            backend.step([State()], given)


def test_a_vehicle_with_distributions_has_their_medians():
    backend = type("Identified", (Backend,), {"vehicle": "crazyswarm2:log08"})
    (state,) = fly(backend(None, ["cf"], [State(pos=(0.0, 0.0, 1.0))]), actions(HOVER_RPM), 0.01)
    assert np.isfinite(state.pos).all()
