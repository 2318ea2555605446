"""Compare flights of exported C code with the flights of the shipped controllers from which it was exported.

For each controller, a compiled and an uncompiled flight of 10 s are compared with a flight of the exported code in
double precision, bit by bit. The steps of this flight are repeated with each compiler and each level of optimisation.
In single precision, the RMSE and the largest difference of a command are compared. The script prints a table.
"""

import shutil
import tempfile
from pathlib import Path
from typing import ClassVar

from drake_quad.command_line.running import run

import numpy as np
from ruamel.yaml import YAML

from drake_quad import InputError, draw_sample, export_controller, exported_controller, load_scenario, simulate
from drake_quad.command_line.options import parser_without_options
from drake_quad.exported.description import read_description
from drake_quad.exported.machines import COMPILER_FLAGS, HostMachine
from drake_quad.scenario.files.shipped import shipped_folder

# Laboratories in which the controllers of each file are designed to fly.
LABORATORIES = {
    "calibrated": ["laboratory:nominal", "laboratory:low_wind", "laboratory:high_wind"],
    "paper": ["laboratory:nominal", "laboratory:low_wind", "laboratory:high_wind"],
    "raptor": ["hover", "figure_eight"],
    "designed/laboratory": ["laboratory:nominal", "laboratory:low_wind", "laboratory:high_wind"],
    "designed/neural_fly": ["neural_fly:still", "neural_fly:wind_8", "neural_fly:wind_12"],
    "designed/outdoor": ["outdoor"],
    "designed/priced": ["robustness"],
    "designed/robustness": ["robustness"],
}
# Scenarios that already contain a controller.
SCENARIOS = [
    *("robustness", "onboard", "crazyswarm2:log08", "nanobench", "slalom", "forest", "upset"),
    *("indoor_flow", "outdoor_gnss", "warehouse_uwb"),
    *(f"bad_day:{name}" for name in ("crazyflie", "crazyflie_onboard", "hummingbird", "neural_fly", "racer")),
]
OPTIMISATION_LEVELS = ("-O0", "-O1", "-O2", "-O3")
SHORT_FLIGHT = ["duration=10", "metrics={start: 0, end: null}"]


class Recorded(HostMachine):
    """Exported controller on this computer, which records its steps."""

    steps: ClassVar[list[tuple[bytes, bytes, tuple[bytes, bytes]]]] = []

    def step(self, state: bytes, inputs: bytes) -> tuple[bytes, bytes]:
        """Return the next state and the outputs of a step, and record both."""
        result = super().step(state, inputs)
        self.steps.append((state, inputs, result))
        return result


def cases(only: str) -> list[tuple[str, str]]:
    """Return the scenario and the controller of each flight; "" if the scenario already contains a controller.

    Args:
        only: text that the name of the scenario or of the controller must contain.
    """
    result = [(scenario, "") for scenario in SCENARIOS]
    for name, laboratories in LABORATORIES.items():
        file = shipped_folder() / "controllers" / f"{name}.yaml"
        controllers = [f"controllers/{name}:{key}" for key in YAML(typ="safe").load(file)]
        result += [(laboratory, controller) for laboratory in laboratories for controller in controllers]
    return [case for case in result if only in " ".join(case)]


def row(laboratory: str, controller: str, folder: Path) -> str:
    """Return the results of a controller as a line of text."""
    scenario = draw_sample(load_scenario(laboratory, SHORT_FLIGHT, layers=[controller] if controller else []), 0)
    try:
        export_controller(scenario, folder)
    except InputError as error:
        return str(error)
    expected, uncompiled = simulate(scenario, compiled=True), simulate(scenario, compiled=False)
    kind = exported_controller(folder)
    Recorded.steps.clear()
    system = kind()
    system._running = Recorded(folder)
    flown = simulate(scenario, control=system)
    unequal = [
        sum(int((bits(flown[name]) != bits(other[name])).sum()) for name in flown) for other in (expected, uncompiled)
    ]
    compilers = [compiler for compiler in ("gcc", "clang") if shutil.which(compiler)]
    changed = 0
    for compiler in compilers:
        for level in OPTIMISATION_LEVELS:
            machine = HostMachine(folder, compiler=compiler, flags=(*COMPILER_FLAGS, level))
            changed += sum(machine.step(state, inputs) != result for state, inputs, result in Recorded.steps)
    export_controller(scenario, folder, precision="single")
    single = simulate(scenario, control=exported_controller(folder)())
    command = next(iter(read_description(folder).outputs))
    ratio = single.metrics.rmse / expected.metrics.rmse - 1.0
    difference = np.abs(single[command] - expected[command]).max(axis=0) / np.abs(expected[command]).max(axis=0).clip(
        1e-9
    )
    return (
        f"{unequal[0]} unequal values (compiled) and {unequal[1]} (uncompiled) in {len(flown)} signals, {changed} of"
        f" {len(Recorded.steps)} steps changed by {', '.join(compilers)};"
        f" single precision: RMSE {100.0 * ratio:+.4f} %, command {difference.max():.1e}"
    )


def bits(values: np.ndarray) -> np.ndarray:
    """Return the bit patterns of numbers as integers."""
    return np.ascontiguousarray(values).view(np.uint64)


def main() -> None:
    """Print the table."""
    options = parser_without_options(__doc__, "python scripts/development/exported_bits.py --only lqg")
    options.add_argument("--only", default="", help="fly only cases whose laboratory or controller contains this text")
    only = options.parse_args().only
    with tempfile.TemporaryDirectory() as folder:
        for laboratory, controller in cases(only):
            print(f"{laboratory} {controller}: {row(laboratory, controller, Path(folder))}", flush=True)


if __name__ == "__main__":
    run(main)
