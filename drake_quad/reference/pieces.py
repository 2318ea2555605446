"""Conversion of plans from and to polynomial pieces, as in Crazyswarm2, uav_trajectories and minsnap-trajectories.

A piece consists of a duration and polynomials c_0 + c_1 t + ... + c_7 t⁷ for x, y, z (m) and the yaw (rad), where t is
the time from the beginning of the piece, s. In a file, the columns are `duration,x^0,...,x^7,y^0,...,z^0,...,yaw^0,...,
yaw^7`, each row is a piece, and the first piece begins at time 0. The format was introduced by W. Hönig et al.,
"Trajectory planning for quadrotor swarms", 2018.
"""

import math
from pathlib import Path
from typing import Any

import numpy as np

from drake_quad.errors import InputError
from drake_quad.extras import import_extra
from drake_quad.files import write_table
from drake_quad.reference.plan import Plan
from drake_quad.reference.polynomial_path import PolynomialPath, knots, subdivide

AXES = ("x", "y", "z", "yaw")
POWERS = 8
"""Number of coefficients of each polynomial in the format."""
COLUMNS = ("duration", *(f"{axis}^{power}" for axis in AXES for power in range(POWERS)))
"""Names of the columns of a file."""


def plan_to_pieces(plan: Plan) -> np.ndarray:
    """Convert a plan exactly to a (pieces, 33) table with the columns of `COLUMNS`.

    A piece ends at each knot of the position and at each knot of the yaw. If a plan begins later than at time 0, the
    first piece hovers until then.

    Raises:
        InputError: if a polynomial has a degree higher than 7.
    """
    path, yaw = subdivide(plan.path, plan.yaw.times), subdivide(plan.yaw, plan.path.times)
    polynomials = [_in_seconds(part) for part in (path, yaw)]
    rows = np.column_stack([path.durations, *(part.reshape(len(part), -1) for part in polynomials)])
    start = float(path.times[0])
    if start > 0.0:
        hover = np.zeros((1, len(COLUMNS)))
        hover[0, 0], hover[0, 1::POWERS] = start, rows[0, 1::POWERS]
        rows = np.vstack([hover, rows])
    return rows


def pieces_to_plan(rows: np.ndarray, *, origin: Any = (0.0, 0.0, 0.0), time_scale: float = 1.0) -> Plan:
    """Return the plan of a table of polynomial pieces.

    The yaw of a piece is shifted by whole turns so that it begins nearest to the end of the preceding piece. A table
    whose yaw wraps from π to -π between two pieces therefore has a continuous yaw.

    Args:
        rows: (pieces, 33) table with the columns of `COLUMNS` and at least one row.
        origin: (3,) origin of the table's coordinates in W, m.
        time_scale: factor by which all times are multiplied.
    """
    times = np.concatenate([[0.0], np.cumsum(rows[:, 0])])
    polynomials = rows[:, 1:].reshape(len(rows), len(AXES), POWERS).transpose(0, 2, 1)
    unit = polynomials * (np.diff(times)[:, np.newaxis] ** np.arange(POWERS))[:, :, np.newaxis]
    unit[:, 0, :3] += origin
    unit[1:, 0, 3] -= _whole_turns(unit[:, :, 3])
    path, yaw = (PolynomialPath(time_scale * times, part) for part in np.split(unit, [3], axis=2))
    return Plan(path, yaw)


def _whole_turns(yaws: np.ndarray) -> np.ndarray:
    """Return the whole turns, (pieces - 1,) in rad, to subtract from all pieces but the first for a continuous yaw.

    Args:
        yaws: (pieces, powers) yaw coefficients in unit time, starting with the constant term, rad.
    """
    jumps = yaws[1:, 0] - yaws[:-1].sum(axis=1)
    return np.asarray(math.tau * np.cumsum(np.rint(jumps / math.tau)))


def save_pieces(plan: Plan, path: Path | str) -> Path:
    """Write a plan to a file of pieces, which Crazyswarm2 and a route of kind `trajectory` can read.

    Returns:
        The path of the file.

    Raises:
        InputError: if a polynomial has a degree higher than 7.
        OSError: if the file cannot be written.
    """
    return write_table(Path(path), dict(zip(COLUMNS, plan_to_pieces(plan).T, strict=True)))


def minsnap_trajectory(plan: Plan) -> Any:
    """Convert the position of a plan exactly to a `PiecewisePolynomialTrajectory` of minsnap-trajectories.

    Raises:
        ImportError: if minsnap-trajectories is not installed; the extra `minsnap` contains it.
    """
    minsnap, path = import_extra("minsnap_trajectories", "minsnap"), plan.path
    scale = path.durations[:, np.newaxis, np.newaxis] ** -np.arange(path.coefficients.shape[1])[:, np.newaxis]
    return minsnap.PiecewisePolynomialTrajectory(path.times, path.durations, path.coefficients * scale)


def minsnap_waypoints(plan: Plan) -> list[Any]:
    """Return position, velocity, acceleration and jerk at each knot of a plan, as waypoints of minsnap-trajectories.

    With `degree=7` and `num_continuous_orders=4`, minsnap-trajectories plans the same path from these waypoints.

    Raises:
        ImportError: if minsnap-trajectories is not installed; the extra `minsnap` contains it.
    """
    minsnap = import_extra("minsnap_trajectories", "minsnap")
    return [
        minsnap.Waypoint(float(time), *derivatives)
        for time, derivatives in zip(plan.path.times, knots(plan.path, 4), strict=True)
    ]


def minsnap_to_plan(trajectory: Any, yaw: float = 0.0) -> Plan:
    """Return the plan that follows a trajectory of minsnap-trajectories with a constant yaw.

    Args:
        trajectory: `PiecewisePolynomialTrajectory` with three dimensions.
        yaw: constant yaw, rad.

    Raises:
        InputError: if the trajectory has no pieces, or does not have three dimensions.
    """
    coefficients = np.asarray(trajectory.coefficients, dtype=float)
    times = np.asarray(trajectory.time_reference, dtype=float)
    if coefficients.ndim != 3 or coefficients.shape[2] != 3 or not len(coefficients):
        raise InputError(
            f"the coefficients of the trajectory have shape {coefficients.shape}, but must have (pieces, powers, 3)"
        )
    powers = np.arange(coefficients.shape[1])
    path = PolynomialPath(times, coefficients * np.diff(times)[:, np.newaxis, np.newaxis] ** powers[:, np.newaxis])
    return Plan.with_constant_yaw(path, yaw)


def _in_seconds(path: PolynomialPath) -> np.ndarray:
    """Return (segments, axes, 8) coefficients for powers of the time since the start of the segment, in m and s."""
    segments, powers, axes = path.coefficients.shape
    if powers > POWERS and path.coefficients[:, POWERS:].any():
        raise InputError(f"the path has degree {powers - 1}, but a piece has at most degree {POWERS - 1}")
    coefficients = np.zeros((segments, POWERS, axes))
    coefficients[:, :powers] = path.coefficients[:, :POWERS]
    coefficients *= (path.durations[:, np.newaxis] ** -np.arange(POWERS))[:, :, np.newaxis]
    return coefficients.transpose(0, 2, 1)
