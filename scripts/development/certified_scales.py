"""Certify the controllers of the robustness study, fly them, and compare the certificates with the crashes."""

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from drake_quad.command_line.running import run

from drake_quad import load_scenario, run_monte_carlo
from drake_quad.command_line.options import check_ranges, parser_without_options
from drake_quad.command_line.output import print_columns, print_files
from drake_quad.command_line.progress import new_bar
from drake_quad.design.certificate import certify_hover
from drake_quad.files import output_folder, write_table
from drake_quad.framework.result_cache import cached_on_disk
from drake_quad.statistics.estimates import proportion_interval
from drake_quad.studies.statistics import Interval
from drake_quad.visualization.style import BLUE, VERMILION, new_figure, save_figures, use_style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CONTROLLERS = ("pd", "pid", "geometric", "disturbance_observer", "l1", "indi", "lqg")
_DIAGRAMS = Path(__file__).parents[2] / "diagrams"


class Row(NamedTuple):
    """Certified scale of the parameter ranges, and crashes, of a controller.

    Attributes:
        controller: name of the controller.
        stable_scale: scale of all parameter ranges up to which hover is certified to be stable.
        unstable_scale: smallest scale for which an unstable loop was found.
        flights: number of flights.
        crashed: number of flights that crashed.
    """

    controller: str
    stable_scale: float
    unstable_scale: float
    flights: int
    crashed: int

    @property
    def probability(self) -> Interval:
        """Estimated probability of a crash, with its 95 % interval."""
        return proportion_interval(self.crashed, self.flights)


def main() -> None:
    options = parser_without_options(__doc__, "python scripts/development/certified_scales.py --samples 100")
    options.add_argument("--samples", type=int, default=5000, help="flights of each controller (default: %(default)s)")
    options.add_argument(
        "--output", type=Path, default=Path("out/certified_scales"), help="folder (default: %(default)s)"
    )
    arguments = options.parse_args()
    check_ranges(arguments, {"samples": (10, 100_000)})
    folder = output_folder(arguments.output)
    rows = [row_of(name, arguments.samples) for name in new_bar(list(CONTROLLERS), desc="certifying and flying")]
    columns = [*zip(*rows, strict=True), *zip(*(row.probability for row in rows), strict=True)]
    names = [*Row._fields, "probability", "low", "high"]
    table = write_table(folder / "certified_scales.csv", dict(zip(names, columns, strict=True)), digits=6)
    print_columns(
        ("controller", "certified up to", "unstable at", "gap", "crashed"),
        [
            (
                row.controller,
                f"{row.stable_scale:.3f}",
                f"{row.unstable_scale:.3f}",
                f"{100.0 * (1.0 - row.stable_scale / row.unstable_scale):.1f} %",
                row.probability.percent(),
            )
            for row in rows
        ],
    )
    print_files([table, *save_figures({"certified_scales": draw(rows)}, folder)])


def row_of(controller: str, samples: int) -> Row:
    """Certify a controller in the scenario `robustness`, and fly it with random samples."""
    layer = f"{_DIAGRAMS / 'controllers' / 'designed' / 'robustness.yaml'}:{controller}"
    scenario = load_scenario(_DIAGRAMS / "robustness.yaml", layers=[layer])
    found = cached_on_disk(certify_hover, scenario)
    crashed = int(run_monte_carlo(scenario, samples).metrics.crashed.sum())
    return Row(controller, found.stable_scale, found.unstable.scale, samples, crashed)


def draw(rows: list[Row]) -> "Figure":
    """Plot the stable and the unstable scale of the parameter ranges, and the crash probability, of each controller."""
    places = range(len(rows))[::-1]
    with use_style():
        figure = new_figure(6.8, 3.0)
        left, right = figure.subplots(1, 2, sharey=True, width_ratios=[3, 2])
        stable, unstable = ([getattr(row, f"{name}_scale") for row in rows] for name in ("stable", "unstable"))
        left.barh(places, stable, height=0.5, color=BLUE, alpha=0.3)
        left.scatter(stable, places, color=BLUE, s=24, label="certified up to", zorder=3)
        left.scatter(unstable, places, color=VERMILION, marker="x", s=28, label="unstable at", zorder=3)
        left.axvline(1.0, color="0.4", linewidth=0.8, linestyle="--")
        left.set(xlabel="scale of all random parameters", xlim=(0.0, 1.15 * max(unstable)))
        left.set_yticks(places, [row.controller.replace("_", " ") for row in rows])
        left.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2)
        middle = [100.0 * row.probability.value for row in rows]
        low, high = ([100.0 * getattr(row.probability, end) for row in rows] for end in ("low", "high"))
        ends = [[m - a for m, a in zip(middle, low, strict=True)], [b - m for m, b in zip(middle, high, strict=True)]]
        right.errorbar(middle, places, xerr=ends, fmt="o", color="0.2", markersize=4, capsize=3)
        right.set(xlabel=f"crashes in {rows[0].flights:,} flights (%)")
        right.set_xlim(left=-0.03 * max(high))
        return figure


if __name__ == "__main__":
    run(main)
