"""Fits what the paper does not give to two cells of its Table II, by three hypotheses, and predicts the others."""

import argparse
import csv
from pathlib import Path

from command_line import bar_over, print_columns, print_files, run

from drake_quad import InputError, Scenario, load_scenario
from drake_quad.replication.calibration import HYPOTHESES, NETWORK_CELL, PD_CELL, Calibration, calibrate
from drake_quad.replication.printed import CONTROLLERS, WINDS, Cell, table_ii
from drake_quad.files import output_folder, write_whole

_PAPER = Path(__file__).parent.parent / "diagrams" / "paper.yaml"


def main() -> None:
    options = argparse.ArgumentParser(
        description=__doc__,
        epilog="example: python scripts/calibrate_paper.py --quick",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    options.add_argument("--samples", type=int, help="over which errors are averaged (default: 64)")
    options.add_argument("--quick", action="store_true", help="8 samples, and the first hypothesis alone")
    options.add_argument("--output", type=Path, default=Path("out/calibration"), help="folder (default: %(default)s)")
    arguments = options.parse_args()
    num_samples = arguments.samples if arguments.samples is not None else 8 if arguments.quick else 64
    if not 2 <= num_samples <= 10_000:
        raise InputError(f"--samples is {num_samples}, but must be between 2 and 10000")
    names = list(HYPOTHESES)[:1] if arguments.quick else list(HYPOTHESES)
    folder = output_folder(arguments.output)
    found = {name: calibrate(HYPOTHESES[name], load, num_samples) for name in bar_over(names, "fitting")}
    file = write_whole(folder / "calibration.csv", lambda path: write_calibrations(path, found))
    for calibration in found.values():
        print_calibration(calibration)
    print_files([file])


def load(cell: Cell, overrides: list[str]) -> Scenario:
    """The scenario of a cell of Table II."""
    return load_scenario(f"{_PAPER}:{cell.scenario}", overrides)


def print_calibration(found: Calibration) -> None:
    """Prints what was fitted, and every cell beside the printed one."""
    hypothesis = found.hypothesis
    print(f"{hypothesis.words}: {hypothesis.pd.words} {found.pd:.4g}, {hypothesis.network.words} {found.network:.4g}")
    rows = []
    for cell, line in table_ii().items():
        ours, printed = found.errors[cell], line.rmse.mean
        rows.append(
            (
                WINDS[cell.wind],
                CONTROLLERS[cell.controller],
                f"{ours.value:.3f} ± {ours.high - ours.value:.3f}",
                f"{printed:.3f}" if printed == printed else "–",
                f"{100.0 * (ours.value / printed - 1.0):+.1f} %" if printed == printed else "–",
                "fitted" if cell in (PD_CELL, NETWORK_CELL) else "predicted",
            )
        )
    print_columns(("", "", "RMSE (m)", "printed", "off by", ""), rows)


def write_calibrations(path: Path, found: dict[str, Calibration]) -> None:
    """Writes a line for each hypothesis and cell."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["hypothesis", "pd_number", "network_number", "wind", "controller", "rmse_m", "low", "high"])
        for name, each in found.items():
            for cell, error in each.errors.items():
                numbers = (f"{value:.9g}" for value in (each.pd, each.network))
                writer.writerow([name, *numbers, *cell, *(f"{value:.9g}" for value in error)])


if __name__ == "__main__":
    run(main)
