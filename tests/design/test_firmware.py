"""Controllers of PX4 and of the Crazyflie's firmware: their laws against the firmware, and readers of parameters."""

import math
from pathlib import Path

import numpy as np
import pytest

from drake_quad import load_scenario
from drake_quad.assembly.control import control_setting
from drake_quad.control.pid_cascade import PidCascade
from drake_quad.design.firmware.crazyflie import MAX_THRUST, output_scales
from drake_quad.design.firmware.layer import firmware_layer
from drake_quad.design.firmware.parameters import defaults_of, read_parameters
from drake_quad.flight.mission import plan_route
from drake_quad.planning.believed import nominal_parameters
from drake_quad.signals import AttitudeTarget, Reference, State
from drake_quad.vehicle.autopilot import AutopilotMemory, autopilot_law

HERE = Path(__file__).parent
DEGREE = math.pi / 180.0
# Thrust of a rotor for a unit of its 16-bit command, N.
UNIT = MAX_THRUST / 65535.0
VEHICLE = load_scenario("laboratory:nominal", layers=["vehicles/crazyflie", "gains/laboratory"])
# The firmware computes with floats of 24 bits; differences of angles over 2 ms magnify their rounding.
SINGLE = 5e-6


def with_firmware(parameters, *overrides):
    layer = firmware_layer(parameters, VEHICLE)
    flat = {f"{part}.{name}": value for part, fields in layer.items() for name, value in fields.items()}
    return load_scenario("laboratory:nominal", flat, layers=["vehicles/crazyflie"])


@pytest.fixture(scope="module")
def recorded():
    """Return what the compiled firmware computed, see scripts/development/record_crazyflie_firmware.py."""
    return np.genfromtxt(HERE / "crazyflie_firmware.csv", delimiter=",", names=True)


def computed(parameters, recorded):
    """Return what the scenario's controllers make of the recorded inputs, in the firmware's units, by its names."""
    scenario = with_firmware(parameters)
    believed = nominal_parameters(scenario)
    cascade = scenario.control.recipes(control_setting(scenario, plan_route(scenario)))["cascade"].build(1)
    autopilot = scenario.laboratory.autopilot
    recipe = autopilot.recipes(believed, written=autopilot, heeds_attitude=True)["autopilot"]
    context, memory = cascade.CreateDefaultContext(), AutopilotMemory.of(recipe.numbers)
    per_unit = np.array(believed.inertia) * output_scales(believed, UNIT)
    rows = []
    for row in recorded:
        x, y, z, v_x, v_y, v_z, roll, pitch, yaw, p, q, r, x_r, y_r, z_r, yaw_r = list(row)[:16]
        # The firmware's pitch has the other sign; its gyroscope has not.
        angles = [angle * DEGREE for angle in (roll, -pitch, yaw)]
        state = State(x, y, z, *angles, v_x, v_y, v_z, *(rate * DEGREE for rate in (p, q, r)))
        reference = Reference(x_r, y_r, z_r, *[0.0] * 6, yaw_r * DEGREE, 0.0)
        cascade.GetInputPort("measurement").FixValue(context, list(state))
        cascade.GetInputPort("reference").FixValue(context, list(reference))
        target = AttitudeTarget(*cascade.GetOutputPort("attitude_target").Eval(context))
        cascade.updates[0].computation.run(cascade, context, [context.get_mutable_discrete_state(0)])
        structure = recipe.structure
        wrench, memory = autopilot_law(
            target, state, None, recipe.numbers, memory, structure["period"], structure["rules"]
        )
        turning = np.array(wrench[1:]) / per_unit * [1.0, -1.0, 1.0]
        rows.append([target.roll / DEGREE, -target.pitch / DEGREE, target.thrust / (4.0 * UNIT), *turning])
    return dict(zip(("roll_d", "pitch_d", "thrust", "roll_out", "pitch_out", "yaw_out"), np.transpose(rows)))


@pytest.mark.slow
@pytest.mark.parametrize("tuned", [False, True])
def test_the_crazyflie_s_firmware_computes_the_same_tick_by_tick(recorded, tuned):
    """At first no limit is reached and in the end every one; tuned parameters switch on all other terms and filters."""
    parameters = read_parameters(HERE / "crazyflie_tuned.txt") if tuned else defaults_of("crazyflie")
    for name, found in computed(parameters, recorded).items():
        expected = recorded[f"{name}_tuned" if tuned else name]
        if name.endswith("_out"):  # the firmware's next step saturates them to 16 bits
            expected = np.clip(expected, -32767.0, 32767.0)
        np.testing.assert_allclose(found, expected, rtol=SINGLE, atol=SINGLE * np.abs(expected).max(), err_msg=name)
