"""Compare RMS position errors in simulated hover with predictions of the linear model, and print two tables.

The first table has a row for each shipped controller, in `laboratory:nominal`. It lists the RMS errors along x and z of
the linear model, of a simulation without packet loss, and of a simulation with packet loss. Its last column shows how
much the results depend on the seed: the error along x with packet loss for a second seed, relative to the first seed.

The second table lists the simulated error of one controller, relative to the linear model, for several noise levels.
"""

import re
from collections.abc import Iterator
from pathlib import Path

from drake_quad.command_line.running import run

import numpy as np

from drake_quad import InputError, Scenario, load_scenario
from drake_quad.command_line.options import parser_without_options
from drake_quad.flight.hover_error import hover_error
from drake_quad.linear.hover_covariance import linear_hover_error
from drake_quad.scenario.paths import map_leaves

_CONTROLLERS = Path(__file__).parents[2] / "diagrams" / "controllers"
_DESIGNED = _CONTROLLERS / "designed" / "laboratory.yaml"
_LQG_CONTROLLERS = ("lqg_low_wind", "lqg_robustness")
_LOSSLESS = "laboratory.command_link.loss_rate=0"
_OTHER_SEED = 1
_NOISE_FIELDS = ("laboratory.motion_capture.position_noise", "laboratory.motion_capture.attitude_noise")
_NOISE_FACTORS = (0.01, 0.1, 0.3, 1.0, 2.0)  # relative to the noise of `laboratory:nominal`


def main() -> None:
    options = parser_without_options(__doc__, "python scripts/development/hover_errors.py")
    options.add_argument(
        "--noise-of", default="indi", metavar="NAME", help="controller of the second table (default: %(default)s)"
    )
    arguments = options.parse_args()
    print_header("RMS error in hover, mm", "linear", "no packet loss", "packet loss", last="other seed")
    for name, layer in shipped():
        print_controller(name, layer)
    print()
    print_noises(f"{_DESIGNED}:{arguments.noise_of}")


def print_header(first: str, *groups: str, last: str | None = None) -> None:
    """Print the head of a table with a column for x and a column for z in each group of errors."""
    columns = [first, *(f"{group}, {axis}" for group in groups for axis in "xz"), *([] if last is None else [last])]
    print(f"| {' | '.join(columns)} |")
    print("|---" * len(columns) + "|")


def shipped() -> Iterator[tuple[str, str]]:
    """Yield the name and the layer of each shipped controller that is designed for the laboratory."""
    for name in re.findall(r"^(\w+):", _DESIGNED.read_text(encoding="utf-8"), re.MULTILINE):
        yield name, f"{_DESIGNED}:{name}"
    for name in _LQG_CONTROLLERS:
        yield f"{name} of `controllers/lqg.yaml`", f"{_CONTROLLERS / 'lqg.yaml'}:{name}"


def print_controller(name: str, layer: str) -> None:
    """Print a controller's row of the first table."""
    scenario, lossless = (load_scenario("laboratory:nominal", each, layers=[layer]) for each in ([], [_LOSSLESS]))
    lossy_error, lossless_error = hover_error(scenario), hover_error(lossless)
    seed_ratio = hover_error(scenario, seed=_OTHER_SEED).x.value / lossy_error.x.value
    simulated = (lossless_error.x.value, lossless_error.z.value, lossy_error.x.value, lossy_error.z.value)
    print(f"| {name} | {' | '.join(in_millimetres(*linear_errors(lossless), *simulated))} | {seed_ratio:.2f} |")


def linear_errors(scenario: Scenario) -> tuple[float, float]:
    """Return the RMS errors along x and z that the linear model predicts, m; NaN where the model does not apply."""
    try:
        x, _, z = np.hypot(*linear_hover_error(scenario))
    except InputError:
        return np.nan, np.nan
    return float(x), float(z)


def in_millimetres(*errors: float) -> list[str]:
    """Convert lengths from m to text in mm, with a dash for NaN."""
    return ["–" if np.isnan(error) else f"{1e3 * error:.2f}" for error in errors]


def print_noises(layer: str) -> None:
    """Print the ratio of simulated to linear errors for several noise levels, for the controller in a layer."""
    print_header("noise relative to `laboratory:nominal`", "no packet loss", "packet loss")
    for factor in _NOISE_FACTORS:
        cells = []
        for overrides in ([_LOSSLESS], []):
            scenario = with_noise(load_scenario("laboratory:nominal", overrides, layers=[layer]), factor)
            error = hover_error(scenario)
            cells += [f"{a / b:.2f}" for a, b in zip((error.x.value, error.z.value), linear_errors(scenario))]
        print(f"| {factor:g} | {' | '.join(cells)} |")


def with_noise(scenario: Scenario, factor: float) -> Scenario:
    """Return a scenario whose camera noise is multiplied by a factor."""
    scaled: Scenario = map_leaves(scenario, lambda path, value: factor * value if path in _NOISE_FIELDS else value)
    return scaled


if __name__ == "__main__":
    run(main)
