"""A plan as files: tables for other tools, and a route that a scenario can include."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from drake_quad.files import output_folder, write_atomically, write_table
from drake_quad.reference.pieces import save_pieces
from drake_quad.reference.plan import Plan
from drake_quad.reference.polynomial_path import PolynomialPath, evaluate, hermite_path, knots

_MOST_SAMPLES = 20_000
_PIECES = "pieces.csv"
# Of coefficients that are made of derivatives, over the largest.
_ROUNDING = 1e-12
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
    """Writes a plan as `trajectory.csv`, sampled, and exactly as `trajectory.yaml` and `pieces.csv`.

    The YAML file holds a scenario called `name` that has nothing but a route of kind `trajectory`, for others to
    extend. Crazyswarm2 reads the pieces (`drake_quad.reference.pieces`), and the route names them if knots cannot say
    what the plan is.

    Args:
        plan: to write.
        folder: to write to.
        name: letters, digits, '_', '.' and '-'.
        period: between samples, s, longer for a plan of more than 20,000 of them; the end of the plan is the last one.

    Returns:
        The files.

    Raises:
        InputError: the folder cannot be written.
    """
    target = output_folder(Path(folder))
    start, end = plan.path.times[[0, -1]]
    times = np.append(np.arange(start, end - 1e-9, max(period, (end - start) / _MOST_SAMPLES)), end)
    table = [times, *(row for order in range(5) for row in evaluate(plan.path, times, order))]
    table += [evaluate(plan.yaw, times, order)[0] for order in range(2)]

    def write_yaml(path: Path) -> None:
        path.write_text(_as_yaml(plan, name), encoding="utf-8")

    return [
        write_table(target / "trajectory.csv", dict(zip(_COLUMNS, table, strict=True)), digits=9),
        write_atomically(target / "trajectory.yaml", write_yaml),
        save_pieces(plan, target / _PIECES),
    ]


def _as_yaml(plan: Plan, name: str) -> str:
    if not (_has_knots(plan.path, 4) and _has_knots(plan.yaw, 2)):
        return f"{name}:\n  route:\n    kind: trajectory\n    pieces: {_PIECES}\n"
    lines = [f"{name}:", "  route:", "    kind: trajectory", "    knots:"]
    for time, derivatives in zip(plan.path.times, knots(plan.path, 4), strict=True):
        motion = zip(("position", "velocity", "acceleration", "jerk"), derivatives.tolist(), strict=True)
        lines.append(_entry({"time": float(time), **dict(motion)}))
    lines.append("    yaw_knots:")
    for time, derivatives in zip(plan.yaw.times, knots(plan.yaw, 2), strict=True):
        yaw, rate = derivatives[:, 0].tolist()
        lines.append(_entry({"time": float(time), "yaw": yaw, "yaw_rate": rate}))
    return "\n".join(lines) + "\n"


def _has_knots(path: PolynomialPath, orders: int) -> bool:
    """Is a path what its derivatives below an order at its knots say?"""
    rebuilt = hermite_path(path.times, knots(path, orders)).coefficients
    own = np.zeros((len(rebuilt), max(rebuilt.shape[1], path.coefficients.shape[1]), rebuilt.shape[2]))
    padded = own.copy()
    own[:, : path.coefficients.shape[1]], padded[:, : rebuilt.shape[1]] = path.coefficients, rebuilt
    return np.allclose(own, padded, rtol=0.0, atol=_ROUNDING * max(1.0, np.abs(own).max()))


def _entry(fields: Mapping[str, float | list[float]]) -> str:
    return "      - {" + ", ".join(f"{key}: {value}" for key, value in fields.items()) + "}"
