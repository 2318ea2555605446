"""Plan routes through the forest with several margins, fly them, and plot the probability of touching a trunk."""

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from drake_quad.command_line.running import run

from drake_quad import load_scenario, run_monte_carlo
from drake_quad.command_line.options import check_ranges, parser_without_options
from drake_quad.command_line.output import print_columns, print_files
from drake_quad.command_line.progress import new_bar
from drake_quad.files import output_folder, write_table
from drake_quad.flight.mission import plan_route_with_problem
from drake_quad.statistics.estimates import proportion_interval
from drake_quad.studies.statistics import Interval
from drake_quad.visualization.style import BLUE, VERMILION, new_figure, save_figures, use_style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MARGINS = (0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4)  # m, between the vehicle and the trunks
# Scenario layers of two controllers: an LQG regulator, and the controller that had the second fewest crashes without
# obstacles.
CONTROLLERS = {"lqg": "lqg:lqg_robustness", "indi_t2fnn": "designed/robustness:indi_t2fnn"}
_DIAGRAMS = Path(__file__).parents[2] / "diagrams"


class Point(NamedTuple):
    """Results of one controller's flights along one plan.

    Attributes:
        controller: name of the controller.
        margin: smallest distance between the vehicle and the trunks along the plan, m.
        duration: duration of the plan, s.
        flights: number of flights.
        touched: number of flights that touched a trunk.
        crashed: number of flights that crashed, including those that touched a trunk.
    """

    controller: str
    margin: float
    duration: float
    flights: int
    touched: int
    crashed: int

    @property
    def probability(self) -> Interval:
        """Estimated probability of touching a trunk, with its 95 % interval."""
        return proportion_interval(self.touched, self.flights)


def main() -> None:
    options = parser_without_options(__doc__, "python scripts/development/forest_margins.py --samples 100")
    options.add_argument("--samples", type=int, default=1000, help="flights of each plan (default: %(default)s)")
    options.add_argument(
        "--output", type=Path, default=Path("out/forest_margins"), help="folder (default: %(default)s)"
    )
    arguments = options.parse_args()
    check_ranges(arguments, {"samples": (10, 100_000)})
    folder = output_folder(arguments.output)
    points = [
        fly(name, margin, arguments.samples) for name in new_bar(list(CONTROLLERS), desc="flying") for margin in MARGINS
    ]
    columns = [*zip(*points, strict=True), *zip(*(point.probability for point in points), strict=True)]
    names = [*Point._fields, "probability", "low", "high"]
    table = write_table(folder / "forest_margins.csv", dict(zip(names, columns, strict=True)), digits=6)
    print_columns(
        ("controller", "margin (m)", "duration (s)", "touched", "crashed"),
        [
            (p.controller, f"{p.margin:.2f}", f"{p.duration:.2f}", p.probability.percent(), f"{p.crashed}")
            for p in points
        ],
    )
    print_files([table, *save_figures({"forest_margins": draw(points)}, folder)])


def fly(controller: str, margin: float, samples: int) -> Point:
    """Plan a route that keeps a margin (m) from the trunks, and fly it with random samples of the vehicle."""
    file, name = CONTROLLERS[controller].split(":")
    layer = f"{_DIAGRAMS / 'controllers' / file}.yaml:{name}"
    scenario = load_scenario(_DIAGRAMS / "forest.yaml", [f"space.margin={margin}"], layers=[layer])
    study = run_monte_carlo(scenario, samples)
    duration = plan_route_with_problem(scenario).plan.duration
    return Point(
        controller, margin, duration, samples, sum(study.crashes_by_obstacle.values()), int(study.metrics.crashed.sum())
    )


def draw(points: list[Point]) -> "Figure":
    """Plot the probability of touching a trunk and the duration of the plan against the margin."""
    with use_style():
        figure = new_figure(6.4, 4.6)
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=[3, 1])
        for name, colour, shift in zip(CONTROLLERS, (BLUE, VERMILION), (-0.002, 0.002), strict=True):
            own = [point for point in points if point.controller == name]
            fractions = [point.probability for point in own]
            middle = [100.0 * fraction.value for fraction in fractions]
            ends = [[100.0 * (s.value - s.low) for s in fractions], [100.0 * (s.high - s.value) for s in fractions]]
            above.errorbar(
                [p.margin + shift for p in own],
                middle,
                ends,
                color=colour,
                marker="o",
                markersize=4,
                capsize=3,
                label=name,
            )
        above.set(ylabel="flights that touch a trunk (%)", ylim=(-2.0, 102.0))
        above.set_title(f"{points[0].flights:,} flights of each, with 95 % intervals", loc="left")
        above.legend()
        own = points[: len(MARGINS)]
        below.plot([p.margin for p in own], [p.duration for p in own], color="0.3", marker="o", markersize=4)
        below.set(xlabel="margin of the plan beyond the vehicle's radius (m)", ylabel="duration (s)")
        return figure


if __name__ == "__main__":
    run(main)
