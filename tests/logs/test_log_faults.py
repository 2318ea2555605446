"""Tests of the possible faults of logged signals and their repairs."""

import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drake_quad.logs.faults import AXES, Fault, faults

RANDOM = np.random.default_rng(5)
SIGNALS = {name: 0.4 * RANDOM.normal(size=(20, 3)) for name in AXES}  # random signals in SI units
ANGLES = ("attitude", "attitude_command")


@pytest.fixture(scope="module")
def known() -> dict[str, Fault]:
    """Return the faults of all signals, keyed by their descriptions, which are unique."""
    result = [*faults(SIGNALS)]
    assert len(result) == len({fault.text for fault in result})
    return {fault.text: fault for fault in result}


def test_the_description_of_a_wrong_sign_names_the_axes(known: dict[str, Fault]) -> None:
    for name, axes in AXES.items():
        signs = [fault for fault in known.values() if fault.text.startswith(f"the sign of {name} looks wrong")]
        assert len(signs) == 7
        for fault in signs:
            wrong = re.findall(r"\b(x|y|z|roll|pitch|yaw)\b", fault.text) or [*axes]
            factors = np.array([-1.0 if axis in wrong else 1.0 for axis in axes])
            repaired = fault.repaired({name: SIGNALS[name] * factors})
            assert [*repaired] == [name]
            np.testing.assert_array_equal(repaired[name], SIGNALS[name])
            assert fault.num_axes == len(wrong)
            assert fault.signals == (name,)
            half_turn = factors.tolist() == [1.0, -1.0, -1.0]
            body = name in ("body_rates", "specific_force", "body_rate_command")
            assert fault.text.endswith(f"as if it were in {'FRD' if body else 'NED'}") == half_turn


@pytest.mark.parametrize(
    ("names", "fault_name", "factor"),
    [
        (
            ("position", "velocity", "reference_position", "reference_velocity"),
            "millimetres were taken for metres",
            1e3,
        ),
        (
            ("position", "velocity", "reference_position", "reference_velocity"),
            "metres were taken for centimetres",
            0.01,
        ),
        (("velocity", "reference_velocity"), "km/h were taken for m/s", 3.6),
        ((*ANGLES, "body_rates", "body_rate_command"), "degrees were taken for radians", 180.0 / np.pi),
        ((*ANGLES, "body_rates", "body_rate_command"), "radians were taken for degrees", np.pi / 180.0),
        (("specific_force",), "g were taken for m/s²", 1.0 / 9.81),
        (("specific_force",), "mm/s² were taken for m/s²", 1e3),
    ],
)
def test_a_wrong_unit_scales_all_axes(
    known: dict[str, Fault], names: tuple[str, ...], fault_name: str, factor: float
) -> None:
    assert {name for name in AXES if f"{name} looks as if {fault_name}" in known} == {*names}
    for name in names:
        fault = known[f"{name} looks as if {fault_name}"]
        np.testing.assert_allclose(fault.repaired({name: factor * SIGNALS[name]})[name], SIGNALS[name])
        assert (fault.num_axes, fault.is_frame) == (3, False)


@pytest.mark.parametrize(
    ("fault_name", "axes"),
    [
        ("NED was taken for ENU, or ENU for NED", ["y", "x", "-z"]),
        # Conversions from east, north, up to north, west, up, and back.
        ("ENU was taken for NWU", ["-y", "x", "z"]),
        ("NWU was taken for ENU", ["y", "-x", "z"]),
        ("x and y were swapped", ["y", "x", "z"]),
    ],
)
def test_a_wrong_world_frame_exchanges_the_horizontal_axes(
    known: dict[str, Fault], fault_name: str, axes: list[str]
) -> None:
    """`axes` lists the components of the correct signal that the faulty signal contains as x, y and z."""
    for name in ("position", "velocity", "reference_position", "reference_velocity"):
        columns = dict(zip("xyz", SIGNALS[name].T, strict=True))
        wrong = np.column_stack([-columns[axis[1]] if axis[0] == "-" else columns[axis] for axis in axes])
        fault = known[f"{name} looks as if {fault_name}"]
        np.testing.assert_allclose(fault.repaired({name: wrong})[name], SIGNALS[name])
        assert (fault.num_axes, fault.is_frame) == (3, False)
    assert not any(f"attitude looks as if {fault_name}" in text for text in known)


def test_a_yaw_with_a_constant_offset_is_a_possible_fault(known: dict[str, Fault]) -> None:
    for offset_name, turn in (("90° too small", -90.0), ("90° too large", 90.0), ("180° off", -180.0)):
        fault = known[f"the yaw of attitude looks {offset_name}"]
        wrong = SIGNALS["attitude"] + np.radians([0.0, 0.0, turn])
        np.testing.assert_allclose(fault.repaired({"attitude": wrong})["attitude"], SIGNALS["attitude"])
        assert (fault.num_axes, fault.is_frame) == (1, False)


def test_a_wrong_frame_is_repaired_by_rotating_the_vectors_with_the_attitude(known: dict[str, Fault]) -> None:
    """No axis counts as wrong, since the frames hardly differ at small tilts."""
    to_world = Rotation.from_euler("ZYX", SIGNALS["attitude"][:, ::-1])
    frames = {"body_rates": to_world, "specific_force": to_world, "velocity": to_world.inv()}
    assert {fault.signals for fault in known.values() if fault.is_frame} == {(name,) for name in frames}
    for name, turn in frames.items():
        frame = "body" if name == "velocity" else "world"
        fault = known[f"{name} looks as if it were along {frame} axes"]
        wrong = {**SIGNALS, name: turn.apply(SIGNALS[name])}
        np.testing.assert_allclose(fault.repaired(wrong)[name], SIGNALS[name], atol=1e-12)
        assert (fault.num_axes, fault.is_frame) == (0, True)


def test_all_signals_may_be_rotated_by_half_a_turn(known: dict[str, Fault]) -> None:
    fault = known["all signals look as if NED and FRD were taken for NWU and FLU"]
    assert fault.signals == tuple(AXES)
    wrong = {name: values * [1.0, -1.0, -1.0] for name, values in SIGNALS.items()}
    repaired = fault.repaired(wrong)
    for name, values in SIGNALS.items():
        np.testing.assert_array_equal(repaired[name], values)
    assert fault.num_axes == 2
    # Neither a half turn of all body axes nor a wrong frame is considered if no attitude is logged.
    without_attitude = [*faults({"velocity": SIGNALS["velocity"], "position": SIGNALS["position"]})]
    both = {("position", "velocity"), ("velocity", "position")}  # in NED, and in reverse order
    assert {fault.signals for fault in without_attitude} == {("velocity",), ("position",), *both}
    assert not any(fault.is_frame for fault in without_attitude)
