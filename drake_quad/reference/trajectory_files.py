"""Export of plans: tables for other tools, and a route that a scenario can include."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from drake_quad.files import output_folder, write_atomically, write_table
from drake_quad.reference.pieces import save_pieces
from drake_quad.reference.plan import Plan
from drake_quad.reference.polynomial_path import PolynomialPath, evaluate, hermite_path, knots

_MAX_SAMPLES = 20_000  # largest number of rows of `trajectory.csv`, not counting the last row
_PIECES_FILE = "pieces.csv"
# Tolerance for rounding errors in coefficients that are computed from derivatives, relative to the largest coefficient.
_COEFFICIENT_TOLERANCE = 1e-12
_COLUMNS = (
    "time (s)",
    *(f"{name} (m)" for name in "xyz"),
    *(f"v_{name} (m/s)" for name in "xyz"),
    *(f"a_{name} (m/s²)" for name in "xyz"),
    *(f"j_{name} (m/s³)" for name in "xyz"),
    *(f"s_{name} (m/s⁴)" for name in "xyz"),
    "yaw (rad)",
    "yaw_rate (rad/s)",
)


def save_plan(plan: Plan, folder: Path | str, *, name: str, period: float = 0.02) -> list[Path]:
    """Write a plan as samples in `trajectory.csv`, and exactly in `trajectory.yaml` and `pieces.csv`.

    The YAML file contains a scenario `name` that has only a route of kind `trajectory`, so that other scenarios can
    extend it. The route contains the knots of the plan, or, if the knots do not determine the plan, the name of the
    file of pieces. Crazyswarm2 can read the file of pieces (`drake_quad.reference.pieces`).

    Args:
        plan: plan to write.
        folder: folder to write to.
        name: name of the scenario, of letters, digits, '_', '.' and '-'.
        period: time between samples, s. It is increased if there would be more than 20,000 samples. The last sample is
            the end of the plan.

    Returns:
        Paths of the files.

    Raises:
        InputError: if the folder cannot be written.
    """
    target = output_folder(Path(folder))
    start, end = plan.path.times[[0, -1]]
    times = np.append(np.arange(start, end - 1e-9, max(period, (end - start) / _MAX_SAMPLES)), end)
    table = [times, *(row for order in range(5) for row in evaluate(plan.path, times, order))]
    table += [evaluate(plan.yaw, times, order)[0] for order in range(2)]

    def write_yaml(path: Path) -> None:
        path.write_text(_yaml_text(plan, name), encoding="utf-8")

    return [
        write_table(target / "trajectory.csv", dict(zip(_COLUMNS, table, strict=True)), digits=9),
        write_atomically(target / "trajectory.yaml", write_yaml),
        save_pieces(plan, target / _PIECES_FILE),
    ]


def _yaml_text(plan: Plan, name: str) -> str:
    """Return the content of the YAML file."""
    if not (_follows_from_knots(plan.path, 4) and _follows_from_knots(plan.yaw, 2)):
        return f"{name}:\n  route:\n    kind: trajectory\n    pieces: {_PIECES_FILE}\n"
    lines = [f"{name}:", "  route:", "    kind: trajectory", "    knots:"]
    for time, derivatives in zip(plan.path.times, knots(plan.path, 4), strict=True):
        motion = zip(("position", "velocity", "acceleration", "jerk"), derivatives.tolist(), strict=True)
        lines.append(_yaml_entry({"time": float(time), **dict(motion)}))
    lines.append("    yaw_knots:")
    for time, derivatives in zip(plan.yaw.times, knots(plan.yaw, 2), strict=True):
        yaw, rate = derivatives[:, 0].tolist()
        lines.append(_yaml_entry({"time": float(time), "yaw": yaw, "yaw_rate": rate}))
    return "\n".join(lines) + "\n"


def _follows_from_knots(path: PolynomialPath, orders: int) -> bool:
    """Return True if the derivatives of a path up to order `orders` - 1 at its knots determine the path."""
    rebuilt = hermite_path(path.times, knots(path, orders)).coefficients
    original = np.zeros((len(rebuilt), max(rebuilt.shape[1], path.coefficients.shape[1]), rebuilt.shape[2]))
    padded = original.copy()
    original[:, : path.coefficients.shape[1]], padded[:, : rebuilt.shape[1]] = path.coefficients, rebuilt
    return np.allclose(original, padded, rtol=0.0, atol=_COEFFICIENT_TOLERANCE * max(1.0, np.abs(original).max()))


def _yaml_entry(fields: Mapping[str, float | list[float]]) -> str:
    """Return an item of a YAML list."""
    return "      - {" + ", ".join(f"{key}: {value}" for key, value in fields.items()) + "}"
