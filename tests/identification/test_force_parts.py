"""The steps of an identification by forces, compared with plain least squares and the vehicle's own motion."""

from dataclasses import replace

import numpy as np
import pytest
from neural_fly_flight import DIAGRAM, FULL
from scipy.spatial.transform import Rotation

from drake_quad import InputError, load_scenario
from drake_quad.identification import force_identification as forces
from drake_quad.identification.fitting.windows import airborne
from drake_quad.identification.logs.record import FlightRecord
from drake_quad.identification.results.estimates import Explained
from drake_quad.identification.results.vehicle_numbers import number_of
from drake_quad.scenario.files.loading import load_undesigned

PERIOD = 0.02


@pytest.fixture(scope="module")
def vehicle():
    return load_undesigned(f"{DIAGRAM.parent}/vehicles/neural_fly.yaml:neural_fly")


def record(seconds=20.0, *, name="log", **changes):
    """Return a flight whose motion, force and thrust are sinusoids."""
    time = PERIOD * np.arange(round(seconds / PERIOD))

    def swings(size, rate):
        return size * np.sin(np.outer(time, rate * (1.0 + 0.1 * np.arange(3))) + np.arange(3))

    signals = {
        "velocity": swings(1.5, 1.1),
        "attitude": swings(0.3, 1.3),
        "wind": np.tile([2.0, -1.0, 0.5], (len(time), 1)),
        "residual_force": swings(2.0, 0.9),
        "thrust_share": 0.5 + 0.1 * np.sin(2.0 * time),
    }
    return FlightRecord(name, time, **(signals | changes))


def turned(log, rows):
    """Return world-frame rows (N, 3) along the axes of the body."""
    return Rotation.from_euler("ZYX", log.attitude[:, ::-1]).inv().apply(rows)


def test_air_velocity_and_force_are_along_the_axes_of_the_body(vehicle):
    log = record()
    motion = forces._motion(log, vehicle)
    np.testing.assert_allclose(motion.air, turned(log, log.wind - log.velocity), atol=1e-12)
    np.testing.assert_allclose(motion.speed, np.linalg.norm(log.wind - log.velocity, axis=1))
    # The thrust curve that the autopilot believes goes through zero and gives 14.27 N at full throttle.
    np.testing.assert_allclose(motion.commanded, 4.0 * FULL * log.thrust_share)
    expected = turned(log, log.residual_force) + motion.commanded[:, None] * [0.0, 0.0, 1.0]
    np.testing.assert_allclose(motion.force, expected, atol=1e-12)


def test_the_force_without_a_logged_residual_is_mass_times_acceleration_plus_weight(vehicle):
    log = record(residual_force=None)
    motion = forces._motion(log, vehicle)
    mass, gravity = vehicle.vehicle.mass, vehicle.vehicle.gravity
    rates = np.stack(
        [1.5 * rate * np.cos(log.time * rate + i) for i, rate in enumerate(1.1 * (1.0 + 0.1 * np.arange(3)))], 1
    )
    expected = mass * turned(log, rates + np.array([0.0, 0.0, gravity]))
    inside = slice(3, -3)
    np.testing.assert_allclose(motion.force[inside], expected[inside], atol=2e-3 * mass * gravity)


def test_a_log_without_wind_uses_the_wind_of_the_scenario(vehicle):
    windy = load_scenario(f"{DIAGRAM}:still", ["laboratory.wind=[{kind: steady, velocity: [3.0, 0.0, -0.5]}]"])
    log = record(wind=None)
    np.testing.assert_allclose(forces._motion(log, windy).air, turned(log, [3.0, 0.0, -0.5] - log.velocity), atol=1e-12)


def test_the_thrust_is_taken_from_the_preferred_signal_of_the_log(vehicle):
    """Measured rotor speeds come first, then commands of thrust, of shares of hover thrust, and of motors."""
    log = record(thrust_share=None)
    speeds = np.tile([300.0, 310.0, 320.0, 330.0], (len(log.time), 1))
    factor = vehicle.nominal.thrust_factor
    for own, expected in (
        ({"thrust_command": np.full(len(log.time), 9.0)}, 9.0),
        ({"thrust_share": np.full(len(log.time), 0.4)}, 0.4 * 4.0 * FULL),
        (
            {"thrust_share": np.full(len(log.time), 0.4), "hover_share": np.full(len(log.time), 0.5)},
            0.8 * vehicle.nominal.mass * vehicle.nominal.gravity,
        ),
        ({"motor_command": np.full((len(log.time), 4), 0.3)}, 0.3 * 4.0 * FULL),
    ):
        np.testing.assert_allclose(forces._commanded(replace(log, **own), vehicle), expected)
    measured = forces._commanded(replace(log, rotor_speed=speeds), load_scenario("laboratory:low_wind"))
    np.testing.assert_allclose(
        measured, load_scenario("laboratory:low_wind").nominal.thrust_factor * np.sum(speeds[0] ** 2)
    )
    assert factor > 0.0
    with pytest.raises(InputError, match="says nothing of the thrust"):
        forces._commanded(log, vehicle)


def test_stretches_follow_one_another_in_the_air(vehicle):
    """Compare with a search sample by sample, which starts after 0.5 s and keeps the filter's margin on both sides."""
    log = record(25.0)
    resting = replace(log, thrust_share=np.where((log.time > 9.0) & (log.time < 9.4), 0.0, log.thrust_share))
    gapped = resting.part((log.time < 16.0) | (log.time > 17.0))
    stretches = forces._Stretches([gapped, record(10.0)], 0.3, 3.0)
    assert stretches.length == 150
    width = 5
    for number, one in enumerate(stretches.records):
        flying = airborne(one)
        sample = 25
        starts = []
        while sample + 150 + width <= len(one.time):
            around = slice(sample - width, sample + 150 + width)
            good = flying[around].all() and np.diff(one.time[around]).max() < 0.1
            starts += [sample] if good else []
            sample += 150 if good else 1
        assert stretches.starts[stretches.log == number].tolist() == starts
    assert stretches.unseen.any()
    assert not stretches.unseen.all()
    # A box filter of 0.1 s smooths without a shift.
    smooth = stretches.of([one.velocity[:, 0] for one in stretches.records])
    for window, (number, start) in enumerate(zip(stretches.log, stretches.starts, strict=True)):
        one = stretches.records[number].velocity[:, 0]
        expected = [one[k - 2 : k + 3].mean() for k in range(start, start + 150)]
        np.testing.assert_allclose(smooth[window], expected)
        np.testing.assert_array_equal(
            stretches.cut([each.velocity[:, 1] for each in stretches.records])[window],
            stretches.records[number].velocity[start : start + 150, 1],
        )
    assert not forces._Stretches([record(10.0)], 0.0, 3.0).unseen.any()


@pytest.mark.parametrize(("delay", "lag"), [(0.0, 0.0), (0.03, 0.08), (0.05, 0.3)])
def test_a_thrust_follows_its_command_with_a_delay_and_a_first_order_lag(delay, lag):
    """Compare with the same response on a clock a hundred times as fast."""
    time = np.arange(0.0, 2.0, 0.02)
    command = np.where(time < 0.5, 3.0, 5.0) + np.where(time > 1.2, -1.0, 0.0)
    found = forces._followed(time, command, delay, lag)
    fine = np.arange(0.0, 2.0, 2e-4)
    late = command[np.clip(np.searchsorted(time, fine - delay + 1e-9, side="right") - 1, 0, None)]
    level = command[0]
    expected = np.empty(len(fine))
    for i, value in enumerate(late):
        expected[i] = level
        level = value if lag == 0.0 else level + (1.0 - np.exp(-2e-4 / lag)) * (value - level)
    if lag == 0.0:
        # Without a lag, the thrust is the mean over the previous sample period.
        means = np.array([late[(fine > t - 0.02) & (fine <= t)].mean() if t > 0.0 else 3.0 for t in time])
        np.testing.assert_allclose(found, means, atol=0.03)
    else:
        np.testing.assert_allclose(found, np.interp(time, fine, expected), atol=0.02)


@pytest.fixture(scope="module")
def made():
    """Return stretches with two unknown parameters and a trim, in noise that is correlated within a stretch."""
    random = np.random.default_rng(4)
    stretches = forces._Stretches([record(14.0, name=str(i)) for i in range(4)], 0.3, 1.0)
    count = (len(stretches.starts), stretches.length)
    rows = random.normal(size=(*count, 3))
    rows[..., 2] = 1.0
    true = np.array([0.8, 0.3, 0.5])
    noise = 0.2 * random.normal(size=(count[0], 1)) + 0.1 * random.normal(size=count)
    names = ("body_drag.linear[0]", "body_drag.quadratic[0]", forces._TRIM)
    columns = [forces._Column(name, rows[..., i], 0.1, 1e3) for i, name in enumerate(names)]
    return stretches, columns, rows, true, rows @ true + noise


def test_parameters_are_least_squares_estimates_on_the_training_data(made):
    stretches, columns, rows, true, force = made
    fit = forces._fit(columns, forces._Target("x", force, 0.0 * force), stretches)
    seen = ~stretches.unseen
    expected = np.linalg.lstsq(rows[seen].reshape(-1, 3), force[seen].ravel(), rcond=None)[0]
    np.testing.assert_allclose(fit.values, expected, atol=1e-6)
    np.testing.assert_allclose(fit.predicted, rows @ fit.values)
    assert np.abs(fit.values - true).max() < 5.0 * np.sqrt(np.diag(fit.covariance)).max()
    assert fit.not_seen == {}
    assert fit.below == ()
    spread = fit.of(forces._TRIM, "N")
    assert (spread.value, spread.deviation) == pytest.approx((fit.values[2], np.sqrt(fit.covariance[2, 2])))
    assert spread.unit == "N"
    # A parameter's explained share is its gain over the believed value, on the held-out data.
    late = stretches.unseen
    rest = force[late] - rows[late] @ fit.values
    for i, name in enumerate(fit.names):
        other = rest + rows[late][..., i] * (fit.values[i] - 0.1)
        worth = (np.sum(other**2) - np.sum(rest**2)) / (np.var(force[late]) * rest.size)
        assert fit.explained[name] == Explained(pytest.approx(min(worth, 1.0)), "residual force x")


def test_deviations_follow_from_the_scatter_of_stretches_or_of_whole_logs(made):
    """The scores of stretches are corrected for their own influence on the fit (CR2)."""
    stretches, columns, rows, _, force = made
    fit = forces._fit(columns, forces._Target("x", force, 0.0 * force), stretches)
    seen = ~stretches.unseen
    inverse = np.linalg.inv(np.einsum("wtp,wtq->pq", rows[seen], rows[seen]))
    left = force[seen] - rows[seen] @ fit.values

    def sandwich(groups):
        total = np.zeros((3, 3))
        for group in groups:
            own = rows[seen][group].reshape(-1, 3)
            hat = np.eye(len(own)) - own @ inverse @ own.T
            values, vectors = np.linalg.eigh(hat)
            root = vectors @ np.diag(np.maximum(values, 1e-3) ** -0.5) @ vectors.T
            move = inverse @ own.T @ root @ left[group].ravel()
            total += np.outer(move, move)
        return np.sqrt(np.diag(total))

    by_stretches = sandwich([[w] for w in range(seen.sum())])
    by_logs = sandwich([np.flatnonzero(stretches.log[seen] == log) for log in range(4)])
    noise = np.mean(
        (force - rows @ np.linalg.lstsq(rows[seen].reshape(-1, 3), force[seen].ravel(), rcond=None)[0])[seen] ** 2
    )
    by_noise = np.sqrt(np.diag(inverse) * noise * 0.5 / PERIOD)
    np.testing.assert_allclose(
        np.sqrt(np.diag(fit.covariance)), np.maximum.reduce([by_stretches, by_logs, by_noise]), rtol=0.02
    )
    wider = by_logs > np.maximum(by_stretches, by_noise)
    np.testing.assert_array_equal(fit.freedom, np.where(wider, 3.0, seen.sum() - 1.0))


def test_unexcited_parameters_stay_as_believed_and_negative_ones_are_set_to_zero(made):
    stretches, columns, rows, true, force = made
    still = [columns[0], columns[1]._replace(values=1e-6 * columns[1].values, scale=0.1), columns[2]]
    target = forces._Target("x", rows[..., [0, 2]] @ true[[0, 2]] + 0.1 * np.sin(rows[..., 1]), 0.0 * force)
    fit = forces._fit([each._replace(scale=1.0) if each is not still[1] else each for each in still], target, stretches)
    assert list(fit.not_seen) == ["body_drag.quadratic[0]"]
    assert fit.values[1] == 0.1
    # A negative drag is set to zero, and the other parameters are fitted without it.
    shoved = force - 0.6 * rows[..., 1]
    pushing = forces._fit(
        [each._replace(scale=1.0) for each in columns], forces._Target("x", shoved, 0.0 * force), stretches
    )
    assert pushing.below == ("body_drag.quadratic[0]",)
    assert pushing.values[1] == 0.0
    seen = ~stretches.unseen
    others = rows[seen][..., [0, 2]].reshape(-1, 2)
    expected = np.linalg.lstsq(others, shoved[seen].ravel(), rcond=None)[0]
    np.testing.assert_allclose(pushing.values[[0, 2]], expected, atol=1e-3)


def test_explained_shares_refer_to_the_variance_around_the_mean():
    measured = np.array([[1.0, 3.0], [5.0, 7.0]])
    predicted = measured - np.array([[0.5, -0.5], [1.0, 1.0]])
    chosen = np.array([True, False])
    assert forces._share(measured, predicted, chosen) == pytest.approx(1.0 - 0.25 / 1.0)
    assert np.isnan(forces._share(measured, predicted, np.array([False, False])))


def test_the_curve_of_a_rotor_follows_from_level_and_slope(vehicle):
    """The level is a force of all four rotors together, and the slope scales their believed curve."""
    stretches = forces._Stretches([record(20.0)], 0.0, 3.0)
    names = (forces._LEVEL, forces._SLOPE)
    covariance = np.array([[0.04, 0.003], [0.003, 0.01]])
    fit = forces._Fit(names, np.array([-2.0, 1.2]), covariance, np.array([9.0, 7.0]), np.zeros(1), {}, (), {})
    estimates = forces._estimates([fit], vehicle, stretches)
    assert estimates.names == ("motors.curve[0]", "motors.curve[1]")
    k_0, k_1, _ = vehicle.nominal.motors.curve
    rows = np.array([[0.25, k_0], [0.0, k_1]])
    np.testing.assert_allclose(estimates.values, rows @ [-2.0, 1.2])
    np.testing.assert_allclose(estimates.covariance, rows @ covariance @ rows.T)
    np.testing.assert_array_equal(estimates.degrees_of_freedom, [7.0, 7.0])
    assert [source.log for source in estimates.sources_of(0)] == ["log"]
    unexcited = fit._replace(names=(forces._TRIM,), values=np.ones(1), covariance=np.eye(1), freedom=np.ones(1))
    with pytest.raises(InputError, match="drag and lift"):
        forces._estimates([unexcited], load_scenario("laboratory:low_wind"), stretches)


def test_outputs_exclude_weight_and_commanded_thrust(vehicle):
    log = record(25.0)
    stretches = forces._Stretches([log], 0.4, 3.0)
    motion = forces._motion(log, vehicle)
    random = np.random.default_rng(1)
    fits = [
        forces._Fit(
            (), np.empty(0), np.empty((0, 0)), np.empty(0), random.normal(size=(len(stretches.starts), 150)), {}, (), {}
        )
        for _ in range(3)
    ]
    for axis, (output, fit) in enumerate(zip(forces._outputs(fits, stretches, [motion]), fits, strict=True)):
        own = stretches.of([motion.force[:, axis]])
        thrust = stretches.of([motion.commanded]) if axis == 2 else 0.0
        np.testing.assert_allclose(output.measured, own - thrust)
        np.testing.assert_allclose(output.predicted, fit.predicted - thrust)
        np.testing.assert_array_equal(output.time, stretches.cut([log.time]))
        left = output.measured - output.predicted
        for share, chosen in ((output.share, stretches.unseen), (output.share_fitted, ~stretches.unseen)):
            assert share == pytest.approx(1.0 - np.mean(left[chosen] ** 2) / np.var(output.measured[chosen]))
        # Differencing white noise doubles its variance.
        assert output.deviation == pytest.approx(np.std(np.diff(left, axis=1)) / np.sqrt(2.0))
        assert (output.name, output.unit) == (f"residual force {'xyz'[axis]}", "N")


def test_drag_of_a_short_flight_is_a_least_squares_estimate_with_block_deviations(vehicle):
    """Regress filtered force (0.1 s) on air velocity and a constant. An axis at rest has the drag of the other axis."""
    log = record(6.0, wind=np.zeros((300, 3)))
    found = forces.linear_drag(log, vehicle)
    motion = forces._motion(log, vehicle)
    for axis, spread in enumerate(found):
        air, force = (np.convolve(each[:, axis], np.ones(5) / 5, "same")[10:-10] for each in (motion.air, motion.force))
        design = np.column_stack([air, np.ones_like(air)])
        values = np.linalg.lstsq(design, force, rcond=None)[0]
        assert spread.value == pytest.approx(values[0])
        left = force - design @ values
        blocks = np.floor(log.time[10:-10] / 0.5).astype(int)
        scores = np.array([design[blocks == b].T @ left[blocks == b] for b in np.unique(blocks)])
        inverse = np.linalg.inv(design.T @ design)
        covariance = len(scores) / (len(scores) - 1) * inverse @ scores.T @ scores @ inverse
        assert spread.deviation == pytest.approx(np.sqrt(covariance[0, 0]))
        assert spread.degrees_of_freedom == len(scores) - 1
    level = {"attitude": np.zeros((300, 3))}
    one_way = record(6.0, **level, wind=np.zeros((300, 3)), velocity=record(6.0).velocity * [1.0, 0.05, 1.0])
    first, second = forces.linear_drag(one_way, vehicle)
    assert first == second
    # A fast climb contains no information on drag along x and y.
    climbing = record(6.0, **level, wind=np.zeros((300, 3)), velocity=one_way.velocity * [1.0, 1.0, 20.0])
    assert forces.linear_drag(climbing, vehicle) == (first, second)
    with pytest.raises(InputError, match="hovers"):
        forces.linear_drag(record(6.0, **level, wind=np.zeros((300, 3)), velocity=0.1 * record(6.0).velocity), vehicle)
    with pytest.raises(InputError, match="too short"):
        forces.linear_drag(record(0.6), vehicle)


def test_a_log_determines_forces_if_it_has_a_thrust_and_the_resulting_motion():
    assert forces.tells_forces(record())
    assert forces.tells_forces(record(thrust_share=None, thrust_command=np.ones(1000)))
    for name in ("residual_force", "velocity", "attitude", "thrust_share"):
        assert not forces.tells_forces(record(**{name: None}))


def test_a_trim_is_a_tilt_of_the_weight(vehicle):
    found = forces.identify_forces([record(40.0), record(40.0, name="other")], vehicle)
    weight = vehicle.vehicle.mass * vehicle.vehicle.gravity
    for axis in "xy":
        force, tilt = found.further[f"trim force along {axis}"], found.further[f"tilt that makes it along {axis}"]
        assert (tilt.value, tilt.deviation) == pytest.approx((force.value / weight, force.deviation / weight))
        assert tilt.degrees_of_freedom == force.degrees_of_freedom
        assert (force.unit, tilt.unit) == ("N", "rad")
    nobody = [record(40.0, wind=None), record(40.0, name="other", wind=None)]
    assert forces.identify_forces(nobody, vehicle).remarks[0].startswith("no log says how the air moved")


@pytest.fixture
def columns_of(monkeypatch):
    """The columns and the force that are fitted along an axis."""
    kept = []

    def fit(columns, target, stretches):
        kept.append((columns, target))
        raise StopIteration

    monkeypatch.setattr(forces, "_fit", fit)

    def asked(function, *arguments):
        with pytest.raises(StopIteration):
            function(*arguments)
        return kept.pop()

    return asked


def test_numbers_may_be_off_by_shares_of_the_mass_and_the_weight(vehicle, columns_of):
    """Drag is linear and quadratic in the air's velocity, and lift in that across the rotors."""
    log = record(20.0)
    stretches, motion = forces._Stretches([log], 0.0, 3.0), forces._motion(log, vehicle)
    mass, weight = vehicle.vehicle.mass, vehicle.vehicle.mass * vehicle.vehicle.gravity
    ones = np.ones(len(log.time))

    def check(columns, expected):
        assert [column.name for column in columns] == [name for name, *_ in expected]
        for column, (name, values, scale) in zip(columns, expected, strict=True):
            np.testing.assert_allclose(column.values, stretches.of([values]), atol=1e-12)
            assert column.scale == pytest.approx(scale)
            own = {forces._TRIM: 0.0, forces._LEVEL: 0.0, forces._SLOPE: 1.0}
            assert column.believed == (own[name] if name in own else number_of(vehicle, name))

    for axis in range(2):
        columns, target = columns_of(forces._across, stretches, [motion], vehicle, axis)
        air = motion.air[:, axis]
        check(
            columns,
            [
                (f"body_drag.linear[{axis}]", air, 0.3 * mass),
                (f"body_drag.quadratic[{axis}]", motion.speed * air, 0.05 * mass),
                (forces._TRIM, ones, 0.2 * weight),
            ],
        )
        assert target.axis == "xy"[axis]
        np.testing.assert_allclose(target.force, stretches.of([motion.force[:, axis]]))
        np.testing.assert_array_equal(target.thrust, 0.0)
    delay, lag = 0.03, 0.1
    columns, target = columns_of(forces._along_after, stretches, [motion], vehicle, delay, lag)
    across = motion.air[:, 0] ** 2 + motion.air[:, 1] ** 2
    check(
        columns,
        [
            ("body_drag.quadratic[2]", motion.speed * motion.air[:, 2], 0.05 * mass),
            ("rotor_aerodynamics.climb", motion.air[:, 2], 0.3 * mass),
            ("rotor_aerodynamics.lift", across, 0.05 * mass),
            (forces._LEVEL, ones, weight),
            (forces._SLOPE, forces._followed(log.time, motion.commanded, delay, lag), 0.5),
        ],
    )
    assert target.axis == "z"
    np.testing.assert_allclose(target.force, stretches.of([motion.force[:, 2]]))
    np.testing.assert_allclose(target.thrust, stretches.of([motion.commanded]))
    # The thrust of measured rotor speeds has no delay and no lag.
    turning = replace(log, rotor_speed=np.full((len(log.time), 4), 300.0))
    turned = forces._Stretches([turning], 0.0, 3.0)
    columns, _ = columns_of(forces._along_after, turned, [motion], vehicle, delay)
    np.testing.assert_allclose(columns[-1].values, turned.of([motion.commanded]))
    assert (columns[-1].believed, columns[-1].scale) == (1.0, 0.5)
    # The same is believed of the slope where the lag is sought.
    columns, _ = columns_of(forces._along_after, stretches, [motion], vehicle, delay)
    assert (columns[-1].name, columns[-1].believed, columns[-1].scale) == (forces._SLOPE, 1.0, 0.5)


@pytest.mark.parametrize(("speed", "told"), [(0.19, False), (0.21, True)])
def test_along_an_axis_in_which_the_air_hardly_moves_drag_is_believed(vehicle, speed, told):
    """The standard deviation of the speed decides. Below the limit only the trim is fitted, with the believed drag."""
    time = PERIOD * np.arange(1000)
    sway = np.sqrt(2.0) * speed * np.sin(2.0 * np.pi * time / 3.0)
    log = record(
        20.0,
        attitude=np.zeros((1000, 3)),
        velocity=np.column_stack([sway, 0.0 * sway, 0.0 * sway]),
        wind=np.zeros((1000, 3)),
        residual_force=np.column_stack([0.4 - 0.3 * sway, 0.0 * sway, 0.0 * sway]),
    )
    stretches, motion = forces._Stretches([log], 0.0, 3.0), forces._motion(log, vehicle)
    fit = forces._across(stretches, [motion], vehicle, 0)
    drag = [number_of(vehicle, f"body_drag.{kind}[0]") for kind in ("linear", "quadratic")]
    if told:
        assert fit.names == ("body_drag.linear[0]", "body_drag.quadratic[0]", forces._TRIM)
        return
    assert fit.names == (forces._TRIM,)
    assert {*fit.not_seen} == {"body_drag.linear[0]", "body_drag.quadratic[0]"}
    assert fit.not_seen["body_drag.linear[0]"].startswith(f"the air along x of the body moves by {speed:.2g} m/s")
    air = motion.air[:, 0]
    believed = stretches.of([drag[0] * air + drag[1] * motion.speed * air])
    rest = stretches.of([motion.force[:, 0]]) - believed
    np.testing.assert_allclose(fit.values, rest.mean(), atol=1e-6)
    np.testing.assert_allclose(fit.predicted, believed + fit.values[0])


def test_deviations_of_the_thrust_have_what_half_a_sample_and_the_delay_may_change(monkeypatch, vehicle):
    """A command begins anywhere within a sample, and so does a measurement: together √(2/12) of a sample."""
    stretches = forces._Stretches([record(20.0)], 0.0, 3.0)
    begun = forces.delay_of(vehicle)
    asked = []

    def along_after(stretches, motions, scenario, delay, lag=None):
        asked.append((delay, lag))
        values = np.array([1.0, 2.0]) + (delay - begun) * np.array([3.0, -5.0])
        why = {forces._LAG: "hardly moves"} if lag is None and untold else {}
        return forces._Fit((forces._SLOPE, forces._LAG), values, np.eye(2) * 1e-4, np.ones(2), np.zeros(1), why, (), {})

    monkeypatch.setattr(forces, "_along_after", along_after)
    step = PERIOD * np.sqrt(2.0 / 12.0)
    for untold in (False, True):
        asked.clear()
        fit = forces._along(stretches, [], vehicle, 0.01)
        change = np.array([3.0, -5.0]) * np.hypot(step, 0.01)
        np.testing.assert_allclose(fit.covariance, np.eye(2) * 1e-4 + np.outer(change, change))
        np.testing.assert_array_equal(fit.values, [1.0, 2.0])
        own = number_of(vehicle, "rotor_time_constant")
        expected = [(begun, None), (begun + step, None)] + ([(begun, own), (begun + step, own)] if untold else [])
        np.testing.assert_allclose([delay for delay, _ in asked], [delay for delay, _ in expected])
        assert [lag for _, lag in asked] == [lag for _, lag in expected]
        assert fit.not_seen == ({forces._LAG: "hardly moves"} if untold else {})
