"""A vehicle behind its autopilot, found again from logs in Neural-Fly's form."""

from dataclasses import replace

import numpy as np
import pytest
from neural_fly_flight import DIAGRAM, guessed, write_flight

from drake_quad import InputError, load_scenario
from drake_quad.identification.fitting.open_loop import delay_of
from drake_quad.identification.identify import identify
from drake_quad.identification.logs.reading import read_log
from drake_quad.identification.results.vehicle_file import write_vehicle
from drake_quad.identification.results.vehicle_numbers import number_of, with_numbers
from drake_quad.scenario.files.loading import load_undesigned

NO_LOSS = "laboratory.command_link.loss_rate=0"


@pytest.fixture(scope="module")
def flown():
    return load_scenario(f"{DIAGRAM}:still", [NO_LOSS, "laboratory.motion_capture.misalignment=[0.0, 0.02, 0.0]"])


@pytest.fixture(scope="module")
def log(flown, tmp_path_factory):
    return write_flight(tmp_path_factory.mktemp("logs") / "still.csv", flown)


@pytest.fixture(scope="module")
def found(log):
    return identify([read_log(log)], guessed())


@pytest.mark.slow
def test_the_numbers_of_the_vehicle_come_back_within_their_intervals(found, flown):
    estimates = found.estimates
    assert {"autopilot.natural_frequency[1]", "motors.curve[1]", "body_drag.linear[0]"} <= {*estimates.names}
    # Of 95 % intervals, with a margin: that each holds is not to be expected.
    true = np.array([number_of(flown, name) for name in estimates.names])
    off = np.abs(estimates.values - true) / (estimates.quantiles() * estimates.deviations)
    assert off.max() < 1.5, dict(zip(estimates.names, off.round(2), strict=True))
    assert np.mean(off < 1.0) > 0.8
    assert found.delay.value == pytest.approx(float(delay_of(flown)), abs=2.5 * found.delay.deviation)
    for name, within in (
        ("autopilot.natural_frequency[1]", 0.1),
        ("autopilot.damping[1]", 0.02),
        ("motors.curve[1]", 0.2),
    ):
        assert estimates.value(name) == pytest.approx(number_of(flown, name), abs=within)


@pytest.mark.slow
def test_what_was_not_flown_is_not_told_and_stays_as_it_was(found):
    not_seen = found.estimates.not_seen
    assert "the command of yaw varies by" in not_seen["autopilot.damping[2]"]
    assert "too little beside noise" in not_seen["body_drag.quadratic[1]"]
    assert found.vehicle.laboratory.autopilot.damping[2] == 0.7


@pytest.mark.slow
def test_flights_that_were_held_out_are_explained(found):
    share = {output.name: output.share for output in found.outputs}
    assert min(share["residual force x"], share["residual force z"]) > 0.9
    assert share["pitch"] > 0.95
    noise = {output.name: output.deviation for output in found.outputs}
    assert noise["pitch"] == pytest.approx(0.004, rel=0.1)
    assert found.outputs[0].held_out.any()
    assert not found.outputs[0].held_out.all()


@pytest.mark.slow
def test_poses_tell_the_same_where_no_force_is_logged(log, flown):
    found = identify([replace(read_log(log), residual_force=None)], guessed())
    estimates = found.estimates
    true = np.array([number_of(flown, name) for name in estimates.names])
    off = np.abs(estimates.values - true) / (estimates.quantiles() * estimates.deviations)
    assert off.max() < 1.5, dict(zip(estimates.names, off.round(2), strict=True))
    assert np.mean(off < 1.0) > 0.8
    assert "does not excite" in estimates.not_seen["body_drag.quadratic[1]"]
    outputs = {output.name: output for output in found.outputs}
    assert min(outputs["position x"].share, outputs["position z"].share) > 0.99
    assert outputs["position x"].deviation == pytest.approx(0.001, rel=0.1)


@pytest.mark.slow
def test_the_vehicle_is_written_and_loaded(found, tmp_path):
    path = write_vehicle(
        tmp_path / "mine.yaml", "mine", found.estimates, base=f"{DIAGRAM}:still", given=["nominal.mass=2.6"]
    )
    scenario = load_undesigned(path)
    assert scenario.nominal.mass == 2.6
    mean = scenario.laboratory.autopilot.natural_frequency[1].normal.mean
    assert mean == pytest.approx(found.estimates.value("autopilot.natural_frequency[1]"), rel=1e-3)


@pytest.mark.slow
def test_most_intervals_hold_what_was_flown(tmp_path):
    """Of three vehicles that were drawn anew."""
    held = []
    for seed in range(3):
        draw = np.random.default_rng(seed).uniform
        slope = draw(15.0, 19.0)
        overrides = (
            NO_LOSS,
            f"seed={seed}",
            f"laboratory.autopilot.natural_frequency=[{draw(6, 9)}, {draw(6, 9)}, 7]",
            f"laboratory.autopilot.damping=[{draw(0.4, 0.8)}, {draw(0.4, 0.8)}, 0.5]",
            f"vehicle.motors={{kind: throttle, curve: [{6.484 - slope * 6.484 / 14.27}, {slope}, 0.0]}}",
            f"vehicle.body_drag.linear=[{draw(0.4, 1.0)}, 0.5, 0.0]",
        )
        scenario = load_scenario(f"{DIAGRAM}:still", overrides)
        estimates = identify([read_log(write_flight(tmp_path / f"{seed}.csv", scenario))], guessed()).estimates
        true = np.array([number_of(scenario, name) for name in estimates.names])
        low, high = estimates.intervals().T
        held += [*((low <= true) & (true <= high))]
    assert len(held) > 35
    assert np.mean(held) > 0.88


def test_a_log_without_what_is_needed_gets_a_sentence(log):
    record = read_log(log)
    with pytest.raises(InputError, match="too few: it takes 5"):
        identify([record.part(slice(0, 300))], guessed())
    with pytest.raises(InputError, match="lacks attitude_command"):
        identify(
            [
                record.part(slice(None)).__class__(
                    "bare", record.time, position=record.position, attitude=record.attitude
                )
            ],
            guessed(),
        )
    with pytest.raises(InputError, match="there is no log"):
        identify([], guessed())
    slow = record.part(np.arange(len(record.time)) % 2 == 0)
    with pytest.raises(InputError, match="identify from logs of one rate"):
        identify([record, slow], guessed())


@pytest.mark.slow
def test_a_delay_below_zero_is_said_in_milliseconds(log):
    """Cameras that are believed to be 60 ms later than they are."""
    late = with_numbers(guessed(), {"laboratory.motion_capture.latency_frames": 6})
    remarks = identify([read_log(log)], late).remarks
    (remark,) = (each for each in remarks if each.startswith("laboratory.command_link.delay_ticks came out at"))
    value = float(remark.removeprefix("laboratory.command_link.delay_ticks came out at ").split()[0])
    assert -55.0 < value < -25.0
    assert "ms, and is held at zero" in remark
