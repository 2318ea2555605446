"""A plan as files: a table for other tools, and a route that a scenario can include."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from drake_quad.files import output_folder, write_table, write_whole
from drake_quad.reference.plan import Plan
from drake_quad.reference.polynomial_path import evaluate, knots

_MOST_SAMPLES = 20_000
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
    """Writes a plan as `trajectory.csv`, sampled, and as `trajectory.yaml`, exact.

    The YAML file holds a scenario called `name` that has nothing but a route of kind `trajectory`, for others to
    extend.

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
        write_whole(target / "trajectory.yaml", write_yaml),
    ]


def _as_yaml(plan: Plan, name: str) -> str:
    lines = [f"{name}:", "  route:", "    kind: trajectory", "    knots:"]
    for time, derivatives in zip(plan.path.times, knots(plan.path, 4), strict=True):
        fields = zip(("position", "velocity", "acceleration", "jerk"), map(_list, derivatives), strict=True)
        lines.append(_entry([("time", repr(float(time))), *fields]))
    lines.append("    yaw_knots:")
    for time, derivatives in zip(plan.yaw.times, knots(plan.yaw, 2), strict=True):
        yaw, rate = (repr(float(value[0])) for value in derivatives)
        lines.append(_entry([("time", repr(float(time))), ("yaw", yaw), ("yaw_rate", rate)]))
    return "\n".join(lines) + "\n"


def _entry(fields: Iterable[tuple[str, str]]) -> str:
    return "      - {" + ", ".join(f"{key}: {value}" for key, value in fields) + "}"


def _list(values: np.ndarray) -> str:
    return "[" + ", ".join(repr(float(value)) for value in values) + "]"
