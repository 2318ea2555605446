"""Compare the logged commands of a Crazyflie with those of this library's model of its firmware.

The argument is the folder of the NanoBench data set (S. I. Ullah, J. Baca, arXiv 2603.09908; BSD-3). Its flights log
the estimated state, the setpoint and the output of the position and velocity loops of firmware 2025.12.1.

The logs start after the take-off, so the values of the integrals along Z at their start are unknown. These values add a
straight line over time to the thrust command before it is limited. The script fits this line and subtracts it.
"""

import math
from pathlib import Path

from drake_quad.command_line.running import run

import numpy as np

from drake_quad import load_scenario
from drake_quad.assembly.control import control_setting
from drake_quad.command_line.options import parser_without_options
from drake_quad.control.pid_cascade.system import initial_state, step_cascade
from drake_quad.design.firmware.crazyflie import MAX_THRUST
from drake_quad.flight.mission import plan_route
from drake_quad.framework.recipe import Recipe
from drake_quad.signals import Reference, State

NUM_LANDING_SAMPLES = (
    300  # samples before the end of a flight that are not compared; the log has 100 samples per second
)
MAX_COMMAND = 65535.0  # largest thrust in units of the firmware
DEGREE = math.pi / 180.0  # rad
UNIT = MAX_THRUST / MAX_COMMAND  # N, thrust of one rotor per unit of the firmware
OUTPUT_UNITS = {"roll": "degrees", "pitch": "degrees", "cmd_thrust": "16-bit counts"}


def commanded(log: np.ndarray, recipe: Recipe) -> np.ndarray:
    """Return the roll, pitch and thrust (n, 3) that the model commands for a log, in the firmware's units.

    The integrals are reset while the logged thrust is 0.

    Args:
        log: table of n samples with the columns of a NanoBench log.
        recipe: recipe for the system that models the controller.
    """
    parameters, rules = recipe.parameters, recipe.structure["rules"]
    x, y, z = parameters.velocity.terms
    parameters = parameters._replace(
        velocity=parameters.velocity._replace(terms=(x, y, z._replace(limit=None))),
        command=parameters.command._replace(max_thrust=math.inf),
    )
    rows, loop_state = [], initial_state(parameters, 1)
    for row in log:
        estimate = [row[f"est_stateEstimate_{name}"] for name in ("x", "y", "z", "vx", "vy", "vz")]
        attitude = [row[f"att_stateEstimate_{name}"] * DEGREE for name in ("roll", "pitch", "yaw")]
        state = State._make([*estimate[:3], *attitude, *estimate[3:], 0.0, 0.0, 0.0])
        setpoint = [row[f"sp_ctrltarget_{name}"] for name in "xyz"]
        reference = Reference._make([*setpoint, *[0.0] * 6, row["sp_ctrltarget_yaw"] * DEGREE, 0.0])
        target, next_state = step_cascade(state, reference, parameters, loop_state, 0.01, 1, rules)
        loop_state = next_state if row["pid_controller_cmd_thrust"] > 0.0 else initial_state(parameters, 1)
        rows.append([target.roll / DEGREE, -target.pitch / DEGREE, target.thrust / (4.0 * UNIT)])
    return np.array(rows)


def main() -> None:
    """Print correlation and RMS difference of modelled and logged commands, for each output of each flight."""
    options = parser_without_options(__doc__, "python scripts/development/check_crazyflie_controller.py nanobench")
    options.add_argument("folder", type=Path)
    scenario = load_scenario("laboratory:nominal", layers=["vehicles/crazyflie", "controllers/crazyflie"])
    recipe = scenario.control.recipes(control_setting(scenario, plan_route(scenario)))["cascade"]
    for path in sorted(options.parse_args().folder.glob("B*_rep*.csv.xz")):
        log = np.genfromtxt(path, delimiter=",", names=True)
        computed = commanded(log, recipe)
        flying = (log["pid_controller_cmd_thrust"] > 0.0) & (log["est_stateEstimate_z"] > 0.3)
        # The end of each flight is not compared, since in some flights the rotors stop briefly at the landing command,
        # which resets all integrals.
        flying[max(0, np.flatnonzero(flying)[-1] - NUM_LANDING_SAMPLES) if flying.any() else 0 :] = False
        texts = []
        for column, (name, unit) in zip(computed.T, OUTPUT_UNITS.items(), strict=True):
            logged = log[f"pid_controller_{name}"][flying]
            if not flying.any():
                continue
            command, time = column[flying], log["t"][flying]
            if name == "cmd_thrust":
                free, time = logged < MAX_COMMAND, time - time[0]
                command = np.minimum(
                    command - np.polyval(np.polyfit(time[free], (command - logged)[free], 1), time), MAX_COMMAND
                )
            rms, correlation = np.sqrt(np.mean((command - logged) ** 2)), np.corrcoef(command, logged)[0, 1]
            texts.append(f"{name} {correlation:.4f}, {rms:.3g} {unit} of {np.std(logged):.3g}")
        print(f"{path.name.partition('_rep')[0]:20}", "; ".join(texts) or "no flight in this log")


if __name__ == "__main__":
    run(main)
