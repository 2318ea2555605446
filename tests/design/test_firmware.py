"""Tests of PX4's and the Crazyflie's controllers, by comparison with their firmware, and of parameter files."""

import math
import struct
from pathlib import Path

import numpy as np
import pytest

from drake_quad import InputError, load_scenario
from drake_quad.assembly.control import control_setting
from drake_quad.design.firmware.crazyflie import MAX_THRUST, crazyflie_layer, output_scales
from drake_quad.design.firmware.layer import firmware_layer
from drake_quad.design.firmware.parameters import default_parameters, read_parameters
from drake_quad.design.firmware.px4 import px4_layer
from drake_quad.flight.mission import plan_route
from drake_quad.planning.nominal import nominal_parameters
from drake_quad.signals import AttitudeTarget, Reference, State
from drake_quad.vehicle.autopilot import AutopilotMemory, autopilot_step
from drake_quad.vehicle.px4_units import torque_units

TEST_FOLDER = Path(__file__).parent
DEGREE = math.pi / 180.0  # rad
THRUST_PER_UNIT = MAX_THRUST / 65535.0  # N, rotor thrust per unit of the 16-bit command
CRAZYFLIE_SCENARIO = load_scenario("laboratory:nominal", layers=["vehicles/crazyflie", "gains/laboratory"])
# Relative tolerance. The firmware computes in single precision, and differences of angles over 2 ms magnify its
# rounding errors.
SINGLE_PRECISION_TOLERANCE = 5e-6


def with_firmware(parameters):
    """Return a Crazyflie scenario with the firmware's controller, given the firmware's parameters."""
    layer = firmware_layer(parameters, CRAZYFLIE_SCENARIO)
    flat = {f"{part}.{name}": value for part, fields in layer.items() for name, value in fields.items()}
    return load_scenario("laboratory:nominal", flat, layers=["vehicles/crazyflie"])


@pytest.fixture(scope="module")
def recorded():
    """Return the firmware's inputs and outputs that scripts/development/record_crazyflie_firmware.py recorded."""
    return np.genfromtxt(TEST_FOLDER / "crazyflie_firmware.csv", delimiter=",", names=True)


def outputs_of_scenario(parameters, recorded):
    """Return the outputs of the scenario's controllers for the recorded inputs, in the firmware's units."""
    scenario = with_firmware(parameters)
    nominal = nominal_parameters(scenario)
    cascade = scenario.control.recipes(control_setting(scenario, plan_route(scenario)))["cascade"].build(1)
    autopilot = scenario.laboratory.autopilot
    recipe = autopilot.recipes(nominal, settings=autopilot, follows_attitude=True, curve=None)["autopilot"]
    context, memory = cascade.CreateDefaultContext(), AutopilotMemory.of(recipe.parameters)
    per_unit = np.array(nominal.inertia) * output_scales(nominal, THRUST_PER_UNIT)
    rows = []
    for row in recorded:
        x, y, z, v_x, v_y, v_z, roll, pitch, yaw, p, q, r, x_r, y_r, z_r, yaw_r = list(row)[:16]
        # The firmware's pitch angle has the opposite sign, but its gyroscope's pitch rate has not.
        angles = [angle * DEGREE for angle in (roll, -pitch, yaw)]
        state = State(x, y, z, *angles, v_x, v_y, v_z, *(rate * DEGREE for rate in (p, q, r)))
        reference = Reference(x_r, y_r, z_r, *[0.0] * 6, yaw_r * DEGREE, 0.0)
        cascade.GetInputPort("measurement").FixValue(context, list(state))
        cascade.GetInputPort("reference").FixValue(context, list(reference))
        target = AttitudeTarget(*cascade.GetOutputPort("attitude_target").Eval(context))
        cascade.updates[0].computation.run(cascade, context, [context.get_mutable_discrete_state(0)])
        structure = recipe.structure
        wrench, memory = autopilot_step(
            target, state, None, recipe.parameters, memory, structure["period"], structure["rules"]
        )
        outputs = np.array(wrench[1:]) / per_unit * [1.0, -1.0, 1.0]
        rows.append([target.roll / DEGREE, -target.pitch / DEGREE, target.thrust / (4.0 * THRUST_PER_UNIT), *outputs])
    return dict(zip(("roll_d", "pitch_d", "thrust", "roll_out", "pitch_out", "yaw_out"), np.transpose(rows)))


@pytest.mark.slow
@pytest.mark.parametrize("tuned", [False, True])
def test_the_crazyflie_controller_matches_the_firmware_at_every_tick(recorded, tuned):
    """No limit is active at the beginning of the recorded flight, and all limits are active at its end.

    The tuned parameters also activate all terms and filters that are off by default.
    """
    parameters = read_parameters(TEST_FOLDER / "crazyflie_tuned.txt") if tuned else default_parameters("crazyflie")
    for name, output in outputs_of_scenario(parameters, recorded).items():
        expected = recorded[f"{name}_tuned" if tuned else name]
        if name.endswith("_out"):  # The firmware saturates these outputs to 16 bits in a later step.
            expected = np.clip(expected, -32767.0, 32767.0)
        np.testing.assert_allclose(
            output,
            expected,
            rtol=SINGLE_PRECISION_TOLERANCE,
            atol=SINGLE_PRECISION_TOLERANCE * np.abs(expected).max(),
            err_msg=name,
        )


def test_the_shipped_controller_has_the_default_parameters():
    shipped = load_scenario("laboratory:nominal", layers=["vehicles/crazyflie", "controllers/crazyflie"])
    from_defaults = with_firmware(default_parameters("crazyflie"))
    assert shipped.control == from_defaults.control
    assert shipped.laboratory.autopilot == from_defaults.laboratory.autopilot


def test_output_scales_of_the_crazyflie_match_its_mixer(recorded):
    """The recorded motor commands, rounded to integers, produce the torques that the recorded outputs demand."""
    rotors = nominal_parameters(CRAZYFLIE_SCENARIO).rotors
    inertia, per_unit = (
        np.array(nominal_parameters(CRAZYFLIE_SCENARIO).inertia),
        output_scales(nominal_parameters(CRAZYFLIE_SCENARIO), THRUST_PER_UNIT),
    )
    for row in recorded[:60]:
        forces = [THRUST_PER_UNIT * row[f"m{number}"] for number in (1, 2, 3, 4)]
        torque = [
            sum(rotor.y * force for rotor, force in zip(rotors, forces)),
            sum(-rotor.x * force for rotor, force in zip(rotors, forces)),
            sum(
                -rotor.direction * rotor.drag_factor / rotor.thrust_factor * force
                for rotor, force in zip(rotors, forces)
            ),
        ]
        outputs = np.clip([row["roll_out"], -row["pitch_out"], row["yaw_out"]], -32767.0, 32767.0)
        np.testing.assert_allclose(torque / (inertia * per_unit), outputs, atol=3.0)


def test_a_rate_error_causes_the_same_torque_as_in_px4():
    """Each 1 rad/s of roll rate error adds the fraction MC_ROLLRATE_K · MC_ROLLRATE_P of the full torque."""
    scenario = load_scenario("laboratory:nominal", layers=["vehicles/racer", "gains/laboratory"])
    nominal, values = nominal_parameters(scenario), dict(default_parameters("px4").values)
    values |= {"MC_ROLLRATE_K": 0.5, "MC_ROLLRATE_FF": 0.01, "MPC_THR_HOVER": 0.4, "IMU_GYRO_RATEMAX": 1000.0}
    autopilot = px4_layer(values, nominal)["laboratory"]["autopilot"]
    unit = torque_units(nominal, 0.4)[0] / nominal.inertia.i_xx
    assert autopilot["k_rate"][0] == pytest.approx(0.5 * 0.15 * unit)
    assert autopilot["rate_terms"]["k_i"][0] == pytest.approx(0.5 * 0.2 * unit)
    assert autopilot["rate_terms"]["k_ff"] == pytest.approx([0.01 * unit, 0.0, 0.0])
    assert autopilot["rate_terms"]["integral_limit"][0] == pytest.approx(0.3 * unit)
    assert autopilot["period"] == 0.00125, "the nearest period that the laboratory allows"
    assert px4_layer(values, nominal)["control"]["command"]["max_thrust"] == pytest.approx(1.0 / 0.4)


def test_the_climb_limit_of_a_crazyflie_is_at_least_half_a_metre_per_second():
    values = dict(default_parameters("crazyflie").values) | {"posCtlPid.zVelMax": 0.2, "posCtlPid.xVelMax": 0.2}
    layer = crazyflie_layer(values, nominal_parameters(CRAZYFLIE_SCENARIO))
    assert layer["control"]["position"]["limit"] == pytest.approx([0.22, 1.1, 0.55])


QGROUNDCONTROL_FILE = """# Onboard parameters for Vehicle 1
# Vehicle-Id Component-Id Name Value Type
1\t1\tMC_ROLL_P\t7.25\t9
1\t1\tMPC_THR_HOVER\t0.375\t9
1\t1\tMPC_ACC_DECOUPLE\t0\t6
1\t1\tSYS_AUTOSTART\t4001\t6
"""
CRAZYFLIE_CLIENT_FILE = """params:
  pid_rate.roll_kp:
    default_value: 250.0
    is_stored: true
    stored_value: 70.5
  posCtlPid.xKp: {default_value: 2.5, is_stored: false, stored_value: null}
type: persistent_param_state
version: '1'
"""
PARAMETER_DUMP = (
    "posCtlPid.xKp: 1.75\n# posCtlPid.yKp: 9\nvelCtlPid.vxKp = 2.2e1\npid_rate.roll_kp,71\nposCtlPid.zKp 1.5\n"
)


@pytest.mark.parametrize(
    ("text", "firmware", "values"),
    [
        (
            QGROUNDCONTROL_FILE,
            "px4",
            {"MC_ROLL_P": 7.25, "MPC_THR_HOVER": 0.375, "MPC_ACC_DECOUPLE": 0.0, "MC_PITCH_P": 6.5},
        ),
        (CRAZYFLIE_CLIENT_FILE, "crazyflie", {"pid_rate.roll_kp": 70.5, "posCtlPid.xKp": 2.5, "posCtlPid.yKp": 2.0}),
        (
            PARAMETER_DUMP,
            "crazyflie",
            {
                "posCtlPid.xKp": 1.75,
                "posCtlPid.yKp": 2.0,
                "velCtlPid.vxKp": 22.0,
                "pid_rate.roll_kp": 71.0,
                "posCtlPid.zKp": 1.5,
            },
        ),
    ],
)
def test_missing_parameters_have_their_defaults(text, firmware, values, tmp_path):
    path = tmp_path / "parameters.txt"
    path.write_text(text)
    parameters = read_parameters(path)
    assert parameters.firmware == firmware
    assert {name: parameters.values[name] for name in values} == values
    defaults = default_parameters(firmware)
    assert parameters.values.keys() == defaults.values.keys()
    assert {*parameters.missing} == {name for name in defaults.values if name not in text or f"# {name}" in text}


def test_parameters_are_read_from_a_ulog(tmp_path):
    path = tmp_path / "flight.ulg"
    messages = [(b"B", bytes(40))]
    for name, value in {"MC_ROLL_P": 7.25, "MPC_XY_P": 1.125}.items():
        key = f"float {name}".encode()
        messages.append((b"P", bytes([len(key)]) + key + struct.pack("<f", value)))
    header = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0)
    path.write_bytes(header + b"".join(struct.pack("<H", len(data)) + kind + data for kind, data in messages))
    parameters = read_parameters(path)
    assert (parameters.firmware, parameters.values["MC_ROLL_P"], parameters.values["MPC_XY_P"]) == ("px4", 7.25, 1.125)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"nothing: 1", "not a parameter file of PX4 or of a Crazyflie: it contains neither posCtlPid.* nor MPC_"),
        (b"", "is empty"),
        (b"\xff\xfe\x00", "neither a text file nor a ULog"),
        (b"MC_ROLL_P nan", "MC_ROLL_P is nan; it must be finite and not negative"),
        (b"MC_ROLL_P 1e999", "MC_ROLL_P is inf; it must be finite"),
        (b"MC_ROLL_P -1", "MC_ROLL_P is -1; it must be finite and not negative"),
        (b"MPC_THR_HOVER 0", "MPC_THR_HOVER is 0; it must be between 0.01 and 1, since it is a fraction"),
        (b"MPC_THR_HOVER 50", r"MPC_THR_HOVER is 50; .* a fraction of the largest thrust \(50 % = 0.5\)$"),
        (b"MPC_THR_HOVER nan", "MPC_THR_HOVER is nan; it must be between 0.01 and 1"),
        (b"MPC_TILTMAX_AIR 0.785", r"between 2 and 90, since it is an angle in degrees \(0.785 rad = 45°\)"),
        (b"MC_YAWRATE_MAX 3.5", "MC_YAWRATE_MAX is 3.5; .* a rate in degrees per second"),
        (b"posCtlPid.thrustBase 0.55", "between 655 and 65535, since it is a thrust in units of a 16-bit number"),
        (b"posCtlPid.rLimit: 0.35", "posCtlPid.rLimit is 0.35; .* an angle in degrees"),
        (b"persistent_param_state: [", "is not YAML"),
        (b"type: persistent_param_state", "`params` is missing"),
        (
            b"type: persistent_param_state\nparams: {pid_rate.roll_kp: {is_stored: true}}",
            "roll_kp is None; it must be",
        ),
    ],
)
def test_invalid_parameter_files_are_refused(content, message, tmp_path):
    path = tmp_path / "parameters.txt"
    path.write_bytes(content)
    with pytest.raises(InputError, match=message):
        read_parameters(path)


@pytest.mark.slow
def test_the_command_writes_the_layer_and_the_scenario(tmp_path, run):
    (tmp_path / "mine.params").write_text(QGROUNDCONTROL_FILE)
    folder = tmp_path / "out"
    call = ["design", "vehicles/racer", "--firmware", tmp_path / "mine.params", "--output", folder]
    completed = run(*call)
    assert completed.returncode == 0
    assert "the multicopter controllers of PX4, 1.15" in completed.stdout
    assert "parameters are missing in the file and set to the firmware's default: MPC_XY_P" in completed.stderr
    scenario = load_scenario(folder / "scenario.yaml")
    assert scenario.laboratory.autopilot.k_attitude == (7.25, 6.5, 2.8)
    assert not scenario.control.command.decouples_vertical
    extended = load_scenario("laboratory:nominal", layers=["vehicles/racer", folder / "controller.yaml"])
    assert extended.control == scenario.control
    refused = run(*call, "--integral", "0.2")
    assert refused.returncode == 2
    assert "--integral cannot be combined with --firmware, which designs no gains" in refused.stderr


@pytest.mark.slow
def test_a_vehicle_that_is_too_heavy_for_its_rotors_is_refused(tmp_path, run):
    call = ["design", "vehicles/racer", "--firmware", "px4", "--output", tmp_path / "out"]
    refused = run(*call, "--set", "nominal.mass=75", "--set", "vehicle.mass=75")
    assert (refused.returncode, [*(tmp_path / "out").glob("*")]) == (2, [])
    assert "the rotors cannot fly this route" in refused.stderr


@pytest.mark.slow
def test_an_invalid_controller_is_not_written(tmp_path, run):
    (tmp_path / "mine.params").write_text("1 1 MPC_XY_VEL_P_ACC 1.5 9\n1 1 MC_YAW_WEIGHT 0 9\n")
    refused = run("design", "vehicles/racer", "--firmware", tmp_path / "mine.params", "--output", tmp_path / "out")
    assert refused.returncode == 2
    assert "yaw_weight is 0.0, but must be larger than 0 and at most 1" in refused.stderr
    assert not [*(tmp_path / "out").iterdir()]
