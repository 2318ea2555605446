"""Functions that print the output of commands: tables, margins, prediction errors, file names and remarks."""

import math
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from drake_quad import Scenario
    from drake_quad.design.certificate import Certificate
    from drake_quad.identification.validation.prediction import Predictions

# Display factor and unit of each predicted quantity.
_DISPLAY_UNITS = {
    "position": (1e2, "cm"),
    "height": (1e2, "cm"),
    "attitude": (180.0 / math.pi, "°"),
    "body_rates": (1.0, "rad/s"),
}


def print_table(rows: list[tuple[str, str, str]]) -> None:
    """Print rows of name, value and unit in aligned columns."""
    names, values = (max(len(row[i]) for row in rows) for i in (0, 1))
    for name, value, unit in rows:
        print(f"{name:<{names}}  {value:>{values}} {unit}".rstrip())


def print_columns(header: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a table with a header. The first and the last column are left-aligned, the others right-aligned."""
    table = [header, *rows]
    widths = [max(len(line[i]) for line in table) for i in range(len(header))]
    for line in table:
        cells = [cell.rjust(width) for cell, width in zip(line, widths, strict=True)]
        print("  ".join([line[0].ljust(widths[0]), *cells[1:-1], line[-1]]).rstrip())


def print_margins(margins_by_signal: dict[str, Any]) -> None:
    """Print stability margins, with a row for each signal at which the loop is opened.

    Args:
        margins_by_signal: margins that `link_margins` returns, by signal; None for a signal without a loop.
    """
    rows = [
        (
            name,
            f"{margins.sensitivity:.2f}",
            f"{1e3 * margins.delay:.0f} ms",
            f"{margins.phase:.1f}°",
            f"{margins.gain:.1f} dB",
            f"{margins.gain_reduction:.1f} dB",
            f"{margins.crossover:.2f} rad/s",
            f"{margins.bandwidth:.2f} rad/s",
        )
        for name, margins in margins_by_signal.items()
        if margins is not None
    ]
    print("stability margins of the exact linear model, with the loop opened at the command link")
    print_columns(("signal", "max |S|", "delay", "phase", "gain", "gain reduction", "crossover", "bandwidth"), rows)


def print_joint_disk_margin(margin: Any) -> None:
    """Print the disk margin of all loops at once, a `JointDiskMargin`."""
    print(
        f"all loops at the command link at once: disk margin {margin.disk:.2f}, which tolerates ±{margin.gain:.1f} dB"
        f" and ±{margin.phase:.0f}° in every signal"
    )


def print_scales(name: str, found: "Certificate") -> None:
    """Print the scale up to which hover is certified to be stable, and the scales at which it fails.

    The ranges of all random parameters are multiplied by the scale.

    Args:
        name: name of the scenario.
        found: certificate of the scenario.
    """
    from drake_quad.design.certificate import MAX_SCALE

    print(f"{name}: hover in still air, with the ranges of {len(found.ranges)} parameters scaled at once")
    print("  scale 1                  the ranges in the scenario; three standard deviations if there are no limits")
    print(f"  stable up to scale       {found.stable_scale:.3g}")
    for kind, failure in {"unstable": found.unstable, "no equilibrium": found.without_equilibrium}.items():
        if failure.values:
            print(f"  {f'{kind} at scale':24s} {failure.scale:.3g}")
        elif kind == "unstable":
            print(f"  no unstable loop was found up to scale {min(found.without_equilibrium.scale, MAX_SCALE):.3g}")
    print(f"  gap between the scales   {100.0 * found.gap:.1f} % (with {found.num_cells} linear fractional models)")


def remark(sentence: str) -> None:
    """Print a remark on standard error about a result or an input that the user may not have intended."""
    print(f"remark: {sentence}", file=sys.stderr)


def print_predictions(predictions: "Predictions") -> None:
    """Print the prediction errors of several vehicle models, and the improvement of the first model over the second."""
    names, rows = predictions.vehicles, []
    first, second, *_ = names
    for quantity, (size, unit) in _DISPLAY_UNITS.items():
        for horizon in predictions.horizons if quantity in predictions.errors else ():
            if predictions.starts(horizon):
                errors = [predictions.rmse(quantity, name, horizon).text(size=1.0 / size) for name in names]
                errors.append(predictions.error_reduction(quantity, first, second, horizon).text(size=0.01))
                rows.append((quantity.replace("_", " "), f"{horizon:g} s", *errors, unit))
    print_columns(("", "horizon", *names, f"improvement over {second} (%)", "unit"), rows)


def flying_command(command: str, scenario: "Scenario", file: Path, *options: str) -> str:
    """Return a command line that runs a command on a scenario file, with options that import the user's Python files.

    Args:
        command: name of the command, such as "fly".
        scenario: scenario that the file contains.
        file: file of the scenario.
        options: further options of the command.
    """
    from drake_quad.scenario.files.saving import registration_options

    return " ".join(["drake-quad", command, str(file), *options, *filter(None, [registration_options(scenario)])])


def print_files(files: list[Path]) -> None:
    """Print the names of written files."""
    print("wrote")
    for file in files:
        print(f"  {file}")
