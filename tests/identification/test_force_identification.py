"""Drag, lift and thrust from forces: numbers that are known come back within their intervals."""

from dataclasses import replace

import numpy as np
import pytest
from neural_fly_flight import DIAGRAM
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from drake_quad import InputError, load_scenario, simulate
from drake_quad.identification.fitting.windows import coarser
from drake_quad.identification.force_identification import identify_forces
from drake_quad.identification.logs.reading import read_log
from drake_quad.identification.logs.record import FlightRecord
from drake_quad.identification.results.vehicle_numbers import number_of, with_numbers
from drake_quad.scenario.files.loading import load_undesigned

WEIGHT = 2.644 * 9.81
TRUE = {
    "body_drag.linear[0]": 0.7,
    "body_drag.quadratic[0]": 0.05,
    "body_drag.quadratic[2]": 0.15,
    "rotor_aerodynamics.climb": 0.8,
    "rotor_aerodynamics.lift": 0.03,
    "rotor_time_constant": 0.08,
}
SLOPE, TRIM = 1.3, 0.9
# Of Neural-Fly's vehicle: link and frame of the cameras.
DELAY = 0.03


@pytest.fixture(scope="module")
def vehicle():
    return load_undesigned(f"{DIAGRAM.parent}/vehicles/neural_fly.yaml:neural_fly")


def made(wind, seed, *, noise=0.3, duration=40.0):
    """A flight along and against a wind with forces by the formula, and noise that stays on for half a second."""
    rng = np.random.default_rng(seed)
    fine, step = np.arange(0.0, duration, 0.002), 10
    time = fine[::step]
    position = np.column_stack([1.25 * np.sin(fine), 0.0 * fine, 0.75 * np.sin(2.0 * fine)])
    velocity = np.gradient(position, fine, axis=0)
    pitch = 0.2 * np.sin(fine + 0.5) - 0.04 * wind
    rotation = Rotation.from_euler("ZYX", np.column_stack([0.0 * fine, pitch, 0.0 * fine]))
    share = 0.5 * (1.0 + 0.2 * np.sin(2.0 * fine + 1.0) + 0.1 * np.sin(3.3 * fine))
    commanded = WEIGHT * np.repeat(share[::step], step) / 0.5
    late = np.concatenate([np.full(15, commanded[0]), commanded[:-15]])
    decay = np.exp(-0.002 / TRUE["rotor_time_constant"])
    thrust = WEIGHT + SLOPE * (lfilter([1.0 - decay], [1.0, -decay], late - WEIGHT))
    air = rotation.inv().apply(np.array([-wind, 0.0, 0.0]) - velocity)
    speed = np.linalg.norm(air, axis=1)
    force = np.zeros_like(air)
    force[:, 0] = (TRUE["body_drag.linear[0]"] + TRUE["body_drag.quadratic[0]"] * speed) * air[:, 0] + TRIM
    force[:, 2] = (TRUE["rotor_aerodynamics.climb"] + TRUE["body_drag.quadratic[2]"] * speed) * air[:, 2]
    force[:, 2] += TRUE["rotor_aerodynamics.lift"] * (air[:, 0] ** 2 + air[:, 1] ** 2) + thrust - commanded
    whole = rotation.apply(force)[::step]
    gusts = lfilter([np.sqrt(1.0 - 0.96**2)], [1.0, -0.96], rng.normal(size=whole.shape), axis=0)
    return FlightRecord(
        f"wind {wind:g}",
        time,
        position=position[::step],
        velocity=velocity[::step],
        attitude=rotation.as_euler("ZYX")[::step, ::-1],
        thrust_share=share[::step],
        hover_share=np.full(len(time), 0.5),
        wind=np.tile([-wind, 0.0, 0.0], (len(time), 1)),
        residual_force=whole + noise * gusts,
    )


@pytest.fixture(scope="module")
def found(vehicle):
    return identify_forces([made(wind, seed) for seed, wind in enumerate((0.0, 4.0, 8.0, 12.0))], vehicle)


def test_known_numbers_come_back(found, vehicle):
    for name, true in TRUE.items():
        place = found.estimates.names.index(name)
        low, high = found.estimates.intervals()[place]
        # Of 95 % intervals, with a margin: that each holds is not to be expected.
        assert abs(found.estimates.value(name) - true) < 0.75 * (high - low), name
        assert high - low < 3.0 * max(true, 0.1), name
    assert found.further["change of thrust over what is commanded"].value == pytest.approx(SLOPE, abs=0.03)
    assert found.further["trim force along x"].value == pytest.approx(TRIM, abs=0.3)
    # K1 of a rotor: what is believed is 14.27 N over full throttle.
    assert found.estimates.value("motors.curve[1]") == pytest.approx(SLOPE * 14.27, rel=0.03)


def test_what_was_not_flown_is_not_told(found):
    assert "too little beside noise" in found.estimates.not_seen["body_drag.linear[1]"]


def test_the_share_that_is_explained(found):
    share = {output.name: output.share for output in found.outputs}
    assert share["residual force x"] > 0.97
    assert share["residual force z"] > 0.9
    # Nothing but noise.
    assert abs(share["residual force y"]) < 0.3
    assert found.outputs[0].held_out.any()
    assert found.estimates.explained["body_drag.linear[0]"].output == "residual force x"


@pytest.mark.slow
def test_intervals_hold_as_often_as_they_say(vehicle):
    inside = []
    for seed in range(0, 40, 2):
        estimates = identify_forces([made(0.0, seed), made(8.0, seed + 1)], vehicle).estimates
        known = [name for name in TRUE if name in estimates.names]
        ends = dict(zip(estimates.names, estimates.intervals(), strict=True))
        inside += [ends[name][0] < TRUE[name] < ends[name][1] for name in known]
    # Of 95 % of some hundred, a third of which go with each other.
    assert np.mean(inside) > 0.88, np.mean(inside)


def test_numbers_below_zero_are_held_there(vehicle):
    """A wind that is said to blow the other way makes thrust of drag."""
    records = [made(wind, seed) for seed, wind in enumerate((0.0, 4.0, 8.0, 12.0))]
    forces = identify_forces([replace(record, wind=-record.wind) for record in records], vehicle)
    below = [
        name for name in TRUE if any(remark.startswith(f"{name} came out below zero") for remark in forces.remarks)
    ]
    assert "body_drag.linear[0]" in below or "body_drag.quadratic[0]" in below
    assert all(forces.estimates.value(name) == 0.0 for name in below)


def test_logs_without_wind_are_left_out_where_others_have_it(vehicle):
    records = [made(0.0, 0), made(8.0, 1), replace(made(12.0, 2), wind=None)]
    forces = identify_forces(records, vehicle)
    assert any("forces of wind 12 are not used" in remark for remark in forces.remarks)
    assert "wind 12" not in forces.outputs[0].log


def test_a_short_flight_is_refused(vehicle):
    """It takes as many stretches as the sentence says."""
    words = r"^there are 4 stretches of 3 s in the air to be fitted, too few: it takes 5$"
    with pytest.raises(InputError, match=words):
        identify_forces([made(0.0, 0, duration=20.0)], vehicle)
    assert identify_forces([made(0.0, 0, duration=27.0)], vehicle).estimates.names


def test_a_log_without_thrust_is_refused(vehicle):
    with pytest.raises(InputError, match="says nothing of the thrust"):
        identify_forces([replace(made(0.0, 0), thrust_share=None)], vehicle)


WINDS = [-8.0, 2.0, 0.0], [0.0, 5.0, 0.0], [-3.0, -2.0, 0.0]


@pytest.fixture(scope="module")
def dragged(tmp_path_factory):
    """Return the folder of flights in `WINDS`, and the scenario of the last."""
    folder = tmp_path_factory.mktemp("flights")
    drag = "vehicle.body_drag={linear: [0.5, 0.4, 0.0], quadratic: [0.05, 0.05, 0.1]}"
    for number, wind in enumerate(WINDS):
        blown = f"laboratory.wind=[{{kind: steady, velocity: {wind}}}]"
        path = "route.amplitude=[1.25, 1.0, 0.75]"
        scenario = load_scenario(f"{DIAGRAM}:still", [drag, blown, path, "laboratory.command_link.loss_rate=0"])
        simulate(scenario, sample=number, compiled=True).save(folder / str(number))
    return folder, scenario


@pytest.mark.slow
@pytest.mark.parametrize("mapping", ["flight", "flight_truth"])
def test_the_drag_of_our_own_flights(dragged, mapping):
    """From the velocity, since flight.csv has no residual force."""
    folder, scenario = dragged
    records = []
    for number, wind in enumerate(WINDS):
        record = read_log(folder / str(number) / "flight.csv", mapping)
        records.append(replace(record, name=f"flight {number}", wind=np.tile(wind, (len(record.time), 1))))
    forces = identify_forces(records, scenario)
    estimates = forces.estimates
    # Without noise, forces of sampled states are off by what their steps of 10 ms leave.
    steps = {"body_drag.linear": 0.01, "rotor_aerodynamics.climb": 0.03}.get
    for name, reach in zip(estimates.names, estimates.quantiles() * estimates.deviations, strict=True):
        if name.startswith(("body_drag", "rotor_aerodynamics")):
            off = abs(estimates.value(name) - number_of(scenario, name))
            assert off < max(reach, steps(name.partition("[")[0], 0.002)), name
    assert {"body_drag.linear[0]", "body_drag.linear[1]", "rotor_aerodynamics.lift"} <= {*estimates.names}
    assert forces.outputs[0].share > 0.9


@pytest.mark.parametrize("off", [-1.0, 1.0])
def test_a_lag_is_as_unsure_as_the_delay(vehicle, off):
    """A command that is taken for a tick later leaves a lag that is as much shorter."""
    ticks = vehicle.laboratory.command_link.delay_ticks + off
    other = with_numbers(vehicle, {"laboratory.command_link.delay_ticks": ticks})
    tick = vehicle.laboratory.command_link.period
    records = [made(wind, seed, noise=0.02) for seed, wind in enumerate((0.0, 4.0, 8.0, 12.0))]
    sure, unsure = (identify_forces(records, other, delay_deviation=each).estimates for each in (0.0, tick))
    place = sure.names.index("rotor_time_constant")
    assert unsure.values[place] == sure.values[place]
    low, high = unsure.intervals()[place]
    assert low < TRUE["rotor_time_constant"] < high
    more = unsure.covariance[place, place] - sure.covariance[place, place]
    assert np.sqrt(more) == pytest.approx(tick, rel=0.2)


def test_a_lag_that_is_not_told_stays_as_it_was(vehicle):
    """And what there is of thrust is fitted with it."""
    noisy = [replace(made(wind, seed, noise=12.0), name=str(seed)) for seed, wind in enumerate((0.0, 8.0))]
    slopes = {}
    for lag in (0.02, 0.15):
        forces = identify_forces(noisy, with_numbers(vehicle, {"rotor_time_constant": lag}))
        assert "does not excite it" in forces.estimates.not_seen["rotor_time_constant"]
        slopes[lag] = forces.further["change of thrust over what is commanded"].value
    assert slopes[0.15] > 1.01 * slopes[0.02]


def test_a_share_of_hover_of_zero_is_refused(vehicle):
    record = made(0.0, 0)
    with pytest.raises(InputError, match="the log 'wind 0' has a hover_share of zero or less"):
        identify_forces([replace(record, hover_share=0.0 * record.time)], vehicle)


def test_logs_of_different_rates_are_refused(vehicle):
    slow = coarser(replace(made(4.0, 1), name="slow"), 2)
    with pytest.raises(InputError, match="the log 'slow' has 25 samples a second, and others 50"):
        identify_forces([made(0.0, 0), made(8.0, 2), slow], vehicle)
