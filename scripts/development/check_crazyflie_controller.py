"""Compare the logged commands of a Crazyflie with those of the cascade of its firmware in this library.

Give the folder of NanoBench (S. I. Ullah, J. Baca, arXiv 2603.09908; BSD-3), whose flights log the estimate, the
setpoint and the output of the position and velocity loops of firmware 2025.12.1. The log misses the instants of
take-off, in which the integrals of both loops along Z begin. Wrong initial integrals add a straight line to the thrust
before its limit, which the script removes.
"""

import math
from pathlib import Path

from drake_quad.command_line.running import run

import numpy as np

from drake_quad import load_scenario
from drake_quad.assembly.control import control_setting
from drake_quad.command_line.options import bare_parser
from drake_quad.control.pid_cascade.system import initial_state, step_cascade
from drake_quad.design.firmware.crazyflie import MAX_THRUST
from drake_quad.flight.mission import plan_route
from drake_quad.framework.recipe import Recipe
from drake_quad.signals import Reference, State

LANDING = 300  # samples at 100 Hz
FULL = 65535.0  # largest thrust in units of the firmware
DEGREE, UNIT = math.pi / 180.0, MAX_THRUST / FULL
OUTPUTS = {"roll": "degrees", "pitch": "degrees", "cmd_thrust": "units of 16 bits"}


def commanded(log: np.ndarray, recipe: Recipe) -> np.ndarray:
    """Return (n, 3) roll, pitch and thrust in the firmware's units; loops are reset while the logged thrust is 0."""
    numbers, rules = recipe.numbers, recipe.structure["rules"]
    x, y, z = numbers.velocity.terms
    numbers = numbers._replace(
        velocity=numbers.velocity._replace(terms=(x, y, z._replace(limit=None))),
        command=numbers.command._replace(max_thrust=math.inf),
    )
    rows, held = [], initial_state(numbers, 1)
    for row in log:
        estimate = [row[f"est_stateEstimate_{name}"] for name in ("x", "y", "z", "vx", "vy", "vz")]
        attitude = [row[f"att_stateEstimate_{name}"] * DEGREE for name in ("roll", "pitch", "yaw")]
        state = State._make([*estimate[:3], *attitude, *estimate[3:], 0.0, 0.0, 0.0])
        wanted = [row[f"sp_ctrltarget_{name}"] for name in "xyz"]
        reference = Reference._make([*wanted, *[0.0] * 6, row["sp_ctrltarget_yaw"] * DEGREE, 0.0])
        target, after = step_cascade(state, reference, numbers, held, 0.01, 1, rules)
        held = after if row["pid_controller_cmd_thrust"] > 0.0 else initial_state(numbers, 1)
        rows.append([target.roll / DEGREE, -target.pitch / DEGREE, target.thrust / (4.0 * UNIT)])
    return np.array(rows)


def main() -> None:
    """Print correlation and RMS difference of each output, by flight."""
    options = bare_parser(__doc__, "python scripts/development/check_crazyflie_controller.py nanobench")
    options.add_argument("folder", type=Path)
    scenario = load_scenario("laboratory:nominal", layers=["vehicles/crazyflie", "controllers/crazyflie"])
    recipe = scenario.control.recipes(control_setting(scenario, plan_route(scenario)))["cascade"]
    for path in sorted(options.parse_args().folder.glob("B*_rep*.csv.xz")):
        log = np.genfromtxt(path, delimiter=",", names=True)
        found = commanded(log, recipe)
        flying = (log["pid_controller_cmd_thrust"] > 0.0) & (log["est_stateEstimate_z"] > 0.3)
        # Some flights stop their rotors for an instant when the landing is commanded, which resets all integrals.
        flying[max(0, np.flatnonzero(flying)[-1] - LANDING) if flying.any() else 0 :] = False
        words = []
        for column, (name, unit) in zip(found.T, OUTPUTS.items(), strict=True):
            flown = log[f"pid_controller_{name}"][flying]
            if not flying.any():
                continue
            here, time = column[flying], log["t"][flying]
            if name == "cmd_thrust":
                free, time = flown < FULL, time - time[0]
                here = np.minimum(here - np.polyval(np.polyfit(time[free], (here - flown)[free], 1), time), FULL)
            rms, correlation = np.sqrt(np.mean((here - flown) ** 2)), np.corrcoef(here, flown)[0, 1]
            words.append(f"{name} {correlation:.4f}, {rms:.3g} {unit} of {np.std(flown):.3g}")
        print(f"{path.name.partition('_rep')[0]:20}", "; ".join(words) or "does not fly")


if __name__ == "__main__":
    run(main)
