"""Tests of the candidate parameters for the outputs of a log, and of their priors."""

import numpy as np
import pytest

from drake_quad import Scenario, load_scenario
from drake_quad.identification.parameters import Parameter, parameter_names, parameters_of
from drake_quad.identification.prediction_errors import FORCE
from drake_quad.scenario.layouts import arm_length_of

DELAY = 0.013  # s, delay from a command to the measurement of its effect, before the fit
MAX_DELAY = 0.15  # s, limit of the fitted delay
POSE, IMU = {"position", "attitude"}, {"body_rates", FORCE}
INERTIA = [f"inertia[{axis}]" for axis in range(3)]
CENTRE_OF_MASS = ["centre_of_mass[0]", "centre_of_mass[1]"]
MARKER_MISALIGNMENT = [f"laboratory.motion_capture.misalignment[{axis}]" for axis in range(2)]
LINEAR_DRAG = ["body_drag.linear[0]", "body_drag.linear[1]"]
QUADRATIC_DRAG = [f"body_drag.quadratic[{axis}]" for axis in range(3)]
CENTRE_OF_PRESSURE = ["body_drag.centre_of_pressure[2]"]
ATTITUDE_RESPONSE = [f"autopilot.{name}[{axis}]" for name in ("natural_frequency", "damping") for axis in range(3)]
ROTOR_PARAMETERS = ["thrust_factor", "rotor_time_constant"]


@pytest.fixture(scope="module")
def rotors() -> Scenario:
    """Return a vehicle with rotor speed commands, whose only effect is linear drag."""
    return load_scenario("laboratory:low_wind", ["vehicle.inertia=[0.0066, 0.0079, 0.0121]"])


@pytest.fixture(scope="module")
def full() -> Scenario:
    """Return a vehicle with every effect that may be identified."""
    effects = [
        "vehicle.body_drag={linear: [0.5, 0.1, 0.2], centre_of_pressure: [0, 0, 0.01]}",
        "vehicle.rotor_aerodynamics={climb: 0.02}",
        "vehicle.reaction_torque=true",
        "vehicle.rotor_time_constant_down=0.09",
        "vehicle.linear_drag=0",
    ]
    return load_scenario("laboratory:low_wind", effects)


@pytest.fixture(scope="module")
def attitudes() -> Scenario:
    """Return a vehicle with attitude commands, whose closed attitude loop is modelled as a whole."""
    return load_scenario("neural_fly:still", ["laboratory.autopilot.natural_frequency=[6.0, 7.0, 3.0]"])


@pytest.fixture(scope="module")
def throttles() -> Scenario:
    curve = "motors={kind: throttle, curve: [0.0, 1.0, 3.4]}"
    return load_scenario("laboratory:low_wind", [f"nominal.{curve}", f"vehicle.{curve}"])


def found_in(scenario: Scenario, signals: set[str], *, has_motor_throttles: bool = False) -> dict[str, Parameter]:
    result = parameters_of(scenario, signals, has_motor_throttles=has_motor_throttles, delay=DELAY, max_delay=MAX_DELAY)
    names = parameter_names(result)
    assert len(names) == len({*names})
    return dict(zip(names, result, strict=True))


@pytest.mark.parametrize(
    ("signals", "expected"),
    [
        (POSE, [*ROTOR_PARAMETERS, *INERTIA, *CENTRE_OF_MASS, *MARKER_MISALIGNMENT, "linear_drag"]),
        # Velocities do not determine the axes along which the markers measure positions.
        ({"attitude", "velocity"}, [*ROTOR_PARAMETERS, *INERTIA, *CENTRE_OF_MASS, "linear_drag"]),
        ({"attitude"}, [*ROTOR_PARAMETERS, *INERTIA, *CENTRE_OF_MASS]),
        # An accelerometer determines only the product of drag and velocity if no position is measured.
        (IMU, [*ROTOR_PARAMETERS, *INERTIA, *CENTRE_OF_MASS]),
        # A log of heights determines no parameter of the rotation.
        ({"position"}, [*ROTOR_PARAMETERS, "linear_drag"]),
    ],
)
def test_parameters_of_rotors_are_candidates_if_the_outputs_depend_on_them(
    rotors: Scenario, signals: set[str], expected: list[str]
) -> None:
    assert {*found_in(rotors, signals)} == {*expected, "delay"}


@pytest.mark.parametrize(
    ("signals", "expected"),
    [
        (
            POSE,
            [
                *INERTIA,
                *CENTRE_OF_MASS,
                "rotor_inertia",
                *MARKER_MISALIGNMENT,
                *LINEAR_DRAG,
                *CENTRE_OF_PRESSURE,
                "rotor_aerodynamics.climb",
            ],
        ),
        (
            POSE | IMU,
            [
                *INERTIA,
                *CENTRE_OF_MASS,
                "rotor_inertia",
                *MARKER_MISALIGNMENT,
                *LINEAR_DRAG,
                *QUADRATIC_DRAG,
                *CENTRE_OF_PRESSURE,
                "rotor_aerodynamics.climb",
            ],
        ),
        (IMU, [*INERTIA, *CENTRE_OF_MASS, "rotor_inertia", *CENTRE_OF_PRESSURE]),
        ({"position"}, ["rotor_aerodynamics.climb"]),
    ],
)
def test_parameters_of_effects_are_candidates_if_the_vehicle_has_the_effect(
    full: Scenario, signals: set[str], expected: list[str]
) -> None:
    assert {*found_in(full, signals)} == {*ROTOR_PARAMETERS, "rotor_time_constant_down", *expected, "delay"}


def test_an_attitude_response_replaces_the_parameters_of_rotation(attitudes: Scenario) -> None:
    """A throttle command for all motors varies around hover, so it determines only two coefficients of the curve."""
    drag = [*LINEAR_DRAG, *QUADRATIC_DRAG, "rotor_aerodynamics.lift", "rotor_aerodynamics.climb"]
    thrust = ["motors.curve[0]", "motors.curve[1]", "rotor_time_constant"]
    assert {*found_in(attitudes, POSE)} == {*thrust, *ATTITUDE_RESPONSE, *MARKER_MISALIGNMENT, *drag, "delay"}
    heights = {"motors.curve[0]", "motors.curve[2]", "rotor_time_constant", "delay"}
    vertical = {"rotor_aerodynamics.lift", "rotor_aerodynamics.climb"}
    assert {*found_in(attitudes, {"position"})} == heights | vertical


def test_only_individual_motor_throttles_determine_all_coefficients_of_the_thrust_curve(throttles: Scenario) -> None:
    def powers(signals: set[str], *, individual: bool) -> str:
        return "".join(
            name[-2] for name in found_in(throttles, signals, has_motor_throttles=individual) if "curve" in name
        )

    assert powers(POSE, individual=True) == powers(IMU, individual=True) == "012"
    assert powers(POSE, individual=False) == "01"
    assert powers({"position"}, individual=True) == powers({"position"}, individual=False) == "02"
    assert "thrust_factor" not in found_in(throttles, POSE, has_motor_throttles=True)


def test_priors_are_around_the_values_of_the_scenario(full: Scenario, attitudes: Scenario) -> None:
    result = found_in(full, POSE | IMU)
    vehicle = full.vehicle
    starts = {name: result[name].start for name in (*INERTIA, *LINEAR_DRAG, *CENTRE_OF_PRESSURE, *ROTOR_PARAMETERS)}
    assert starts == dict(
        zip(
            starts,
            [*vehicle.inertia, 0.5, 0.1, 0.01, vehicle.thrust_factor, vehicle.rotor_time_constant],
            strict=True,
        )
    )
    # The prior mean of an effect that the scenario lacks is zero.
    assert all(result[name].start == 0.0 for name in QUADRATIC_DRAG)
    behind = found_in(attitudes, POSE)
    assert [behind[name].start for name in ATTITUDE_RESPONSE] == [6.0, 7.0, 3.0, 0.48, 0.48, 0.48]
    for delay in (result["delay"], behind["delay"]):
        assert (delay.start, delay.lower, delay.upper) == (DELAY, -MAX_DELAY, MAX_DELAY)
        # The prior permits a delay that exceeds the initial value by one camera frame or one tick of the link, but not
        # a delay of a second.
        assert 0.005 <= delay.scale <= 0.05


def test_the_prior_standard_deviation_of_a_positive_parameter_is_about_its_value(
    full: Scenario, attitudes: Scenario
) -> None:
    """Positive parameters may change by a factor of up to fifty, but not change sign."""
    result = found_in(full, POSE | IMU) | found_in(attitudes, POSE)
    positive = ["thrust_factor", *INERTIA, "rotor_inertia", *ATTITUDE_RESPONSE]
    for parameter in (result[name] for name in positive):
        assert parameter.lower == pytest.approx(0.02 * parameter.start)
        assert parameter.upper == pytest.approx(50.0 * parameter.start)
    for name in ("thrust_factor", *INERTIA, "rotor_inertia"):
        assert result[name].scale == pytest.approx(result[name].start)
    for i, name in enumerate(ATTITUDE_RESPONSE):
        # The prior standard deviation of a natural frequency is half of its value. For a damping, it is 0.5, which is
        # half of the critical damping.
        assert result[name].scale == (0.5 * result[name].start if i < 3 else 0.5)
    for name in (*LINEAR_DRAG, *QUADRATIC_DRAG, "rotor_aerodynamics.lift"):
        assert (result[name].lower, result[name].upper) == (0.0, np.inf)
    for name in (
        *CENTRE_OF_MASS,
        *CENTRE_OF_PRESSURE,
        *MARKER_MISALIGNMENT,
        "rotor_aerodynamics.climb",
        "motors.curve[0]",
        "motors.curve[1]",
    ):
        assert (result[name].lower, result[name].upper) == (-np.inf, np.inf)


@pytest.mark.parametrize("constant", [0.0005, 0.004, 0.06, 0.3])
def test_the_prior_of_a_time_constant_allows_errors_of_tens_of_milliseconds(constant: float) -> None:
    """The time constant stays above 2 ms, or above the value of the data sheet if that is smaller."""
    scenario = load_scenario("laboratory:low_wind", [f"vehicle.rotor_time_constant={constant}"])
    result = found_in(scenario, POSE)["rotor_time_constant"]
    assert 0.02 <= result.scale <= 0.1
    assert result.lower == pytest.approx(min(constant, max(0.002, 0.02 * constant)))
    assert result.upper == pytest.approx(50.0 * constant)


def test_drag_priors_scale_with_the_mass_and_position_priors_with_the_arm_length(
    full: Scenario, attitudes: Scenario, throttles: Scenario
) -> None:
    """Prior standard deviations of forces are proportional to the weight, and those of positions to the arm length."""

    def larger(scenario: Scenario, **update: float) -> Scenario:
        changed = {"mass": 2.0 * scenario.vehicle.mass} | update
        return scenario.model_copy(update={"vehicle": scenario.vehicle.model_copy(update=changed)})

    twice = larger(full, arm_length=3.0 * full.vehicle.arm_length)
    result, other = found_in(full, POSE | IMU), found_in(twice, POSE | IMU)
    for name in (*QUADRATIC_DRAG, "body_drag.linear[1]", "rotor_aerodynamics.climb"):
        assert other[name].scale == pytest.approx(2.0 * result[name].scale), name
    for name in (*CENTRE_OF_MASS, *CENTRE_OF_PRESSURE):
        assert other[name].scale == pytest.approx(3.0 * result[name].scale)
        # The prior is narrow enough that the centre of mass is very likely between the rotors.
        assert result[name].scale < 0.5 * arm_length_of(full.vehicle)
    # The prior does not depend on an accelerometer.
    without = found_in(full, POSE)
    for name in (*CENTRE_OF_MASS, *CENTRE_OF_PRESSURE, "body_drag.linear[1]", "rotor_aerodynamics.climb"):
        assert without[name].scale == result[name].scale
    # The prior standard deviation of a large drag equals the drag itself.
    assert result["body_drag.linear[0]"].scale == other["body_drag.linear[0]"].scale == 0.5
    mass, gravity = full.vehicle.mass, full.vehicle.gravity
    # If the data sheet contains no drag, the prior assumes that the drag at 8 m/s is less than the weight.
    assert result["body_drag.linear[1]"].scale * 8.0 < mass * gravity
    assert result["rotor_aerodynamics.climb"].scale * 8.0 < mass * gravity
    assert result["body_drag.quadratic[0]"].scale * 8.0**2 < mass * gravity
    original, heavy = found_in(attitudes, POSE), found_in(larger(attitudes), POSE)
    assert heavy["rotor_aerodynamics.lift"].scale == pytest.approx(2.0 * original["rotor_aerodynamics.lift"].scale)
    assert original["rotor_aerodynamics.lift"].scale * 8.0**2 < attitudes.vehicle.mass * gravity
    # An effect that the vehicle lacks has the same prior as an effect with zero coefficients.
    lacking = attitudes.model_copy(update={"vehicle": attitudes.vehicle.model_copy(update={"body_drag": None})})
    without_drag, light = (
        found_in(lacking, POSE),
        found_in(load_scenario("neural_fly:still", ["vehicle.mass=0.02"]), POSE),
    )
    for name in LINEAR_DRAG:
        assert without_drag[name].scale == pytest.approx(0.3 * attitudes.vehicle.mass)
        assert light[name].scale == original[name].start
        assert without_drag[name].start == 0.0
    # Each of four motors carries a quarter of the weight in hover.
    curve = found_in(throttles, POSE, has_motor_throttles=True)
    assert [curve[f"motors.curve[{i}]"].scale for i in range(3)] == pytest.approx(
        [0.25 * throttles.vehicle.mass * gravity] * 3
    )
    assert [result[name].scale < 0.1 for name in MARKER_MISALIGNMENT] == [True, True]
    # If the data sheet contains a drag, the prior standard deviation equals this drag.
    assert found_in(load_scenario("laboratory:low_wind"), POSE)["linear_drag"].scale == 0.1
