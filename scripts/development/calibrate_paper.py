"""Estimate two parameters that the paper does not give from two cells of its Table II, and predict the other cells.

The estimation is repeated for three hypotheses about the cause of the PD's error in the paper. Each hypothesis has its
own two parameters.
"""

from pathlib import Path

from drake_quad.command_line.running import run

from drake_quad import Scenario, load_scenario
from drake_quad.command_line.options import add_wired, check_ranges, parser_without_options
from drake_quad.command_line.output import print_columns, print_files
from drake_quad.command_line.progress import new_bar
from drake_quad.files import output_folder, write_table
from drake_quad.replication.calibration import HYPOTHESES, NETWORK_CELL, PD_CELL, Calibration, calibrate
from drake_quad.replication.published import CONTROLLERS, WINDS, Cell, published_table

_PAPER = Path(__file__).parents[2] / "diagrams" / "paper.yaml"


def main() -> None:
    options = parser_without_options(__doc__, "python scripts/development/calibrate_paper.py --quick")
    options.add_argument("--samples", type=int, help="number of flights of each cell (default: 64)")
    options.add_argument("--quick", action="store_true", help="use 8 samples and only the first hypothesis")
    options.add_argument("--output", type=Path, default=Path("out/calibration"), help="folder (default: %(default)s)")
    add_wired(options)
    arguments = options.parse_args()
    check_ranges(arguments, {"samples": (2, 10_000)})
    num_samples = arguments.samples or (8 if arguments.quick else 64)
    names = list(HYPOTHESES)[:1] if arguments.quick else list(HYPOTHESES)
    folder = output_folder(arguments.output)
    calibrations = {
        name: calibrate(HYPOTHESES[name], load, num_samples, compiled=not arguments.wired)
        for name in new_bar(names, desc="fitting")
    }
    file = write_calibrations(folder / "calibration.csv", calibrations)
    for calibration in calibrations.values():
        print_calibration(calibration)
    print_files([file])


def load(cell: Cell, overrides: list[str]) -> Scenario:
    """Return the scenario that corresponds to a cell of Table II."""
    return load_scenario(f"{_PAPER}:{cell.scenario}", overrides)


def print_calibration(calibration: Calibration) -> None:
    """Print the two fitted parameters of a hypothesis, and the simulated and published RMSE of each cell."""
    label, _, pd, network = calibration.hypothesis
    print(f"{label}: {pd.label} {calibration.pd:.4g}, {network.label} {calibration.network:.4g}")
    rows = []
    for cell, line in published_table().items():
        simulated, printed = calibration.errors[cell], line.rmse.mean
        rows.append(
            (
                WINDS[cell.wind],
                CONTROLLERS[cell.controller],
                simulated.text(),
                f"{printed:.3f}" if printed == printed else "–",
                f"{100.0 * (simulated.value / printed - 1.0):+.1f} %" if printed == printed else "–",
                "fitted" if cell in (PD_CELL, NETWORK_CELL) else "predicted",
            )
        )
    print_columns(("", "", "RMSE (m)", "paper", "difference", ""), rows)


def write_calibrations(path: Path, calibrations: dict[str, Calibration]) -> Path:
    """Write a CSV file with a row for each hypothesis and cell, and return its path."""
    rows = [
        (name, each.pd, each.network, *cell, *error)
        for name, each in calibrations.items()
        for cell, error in each.errors.items()
    ]
    header = ("hypothesis", "pd_number", "network_number", "wind", "controller", "rmse_m", "low", "high")
    return write_table(path, dict(zip(header, zip(*rows, strict=True), strict=True)), digits=9)


if __name__ == "__main__":
    run(main)
