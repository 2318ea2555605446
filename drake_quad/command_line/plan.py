"""Plan a route through waypoints from a YAML or CSV file, and write the trajectory and a plot of it."""

import argparse
import itertools

import numpy as np

from drake_quad.command_line.options import add_vector, parse_overrides, parser, resolve_output_folder
from drake_quad.command_line.output import print_files, print_table
from drake_quad.files import output_folder
from drake_quad.flight.mission import plan_route_with_problem
from drake_quad.planning.feasibility import plan_demand
from drake_quad.planning.nominal import planned_parameters
from drake_quad.reference.active_constraints import ActiveConstraint, active_constraints
from drake_quad.reference.feasibility import sample_times
from drake_quad.reference.minimum_snap import snap_cost
from drake_quad.reference.path_problem import PathLimits, PathProblem
from drake_quad.reference.plan import Plan
from drake_quad.reference.polynomial_path import evaluate, peak_norm
from drake_quad.reference.trajectory_files import save_plan
from drake_quad.scenario.files.loading import load_mission
from drake_quad.scenario.models import Mission
from drake_quad.space.distance import nearest_approach
from drake_quad.visualization.plan_plots import plot_plan
from drake_quad.visualization.style import save_figures


def options() -> argparse.ArgumentParser:
    result = parser(__doc__, "drake-quad plan slalom --set route.top_speed=1.5", output="out", scenario="slalom")
    add_vector(result)
    return result


def main(arguments: argparse.Namespace) -> None:
    mission = load_mission(arguments.scenario, parse_overrides(arguments.set))
    plan, problem, waypoints, space = plan_route_with_problem(mission)
    folder = output_folder(resolve_output_folder(arguments, mission))
    route = mission.route
    # The planner adds corners to a path around obstacles. These are not waypoints of the route, so they are left out.
    regions = (
        () if problem is None else problem.waypoints if waypoints is None else [problem.waypoints[i] for i in waypoints]
    )
    limits = route.limits()
    figure = plot_plan(
        plan,
        planned_parameters(mission),
        limits=limits,
        regions=regions,
        corridors=problem.corridors if problem else (),
        waypoints=waypoints,
        space=space,
    )
    files = [
        *save_plan(plan, folder, name=mission.name),
        *save_figures({"plan": figure}, folder, vector=arguments.vector),
    ]
    rows = summary(mission, plan, limits, problem)
    approach = None if space is None else nearest_approach(plan.path, space)
    if space is not None and approach is not None:
        rows.append(
            ("smallest distance", f"{approach.distance:.3f}", f"m from {approach.obstacle}, at {approach.time:.2f} s")
        )
        rows.append(("clearance", f"{space.clearance:.3f}", f"m: {space.clearance_text}"))
    print_table(rows)
    print(
        "active limits:", binding_summary(active_constraints(plan.path, limits, problem.corridors if problem else ()))
    )
    print_files(files)


def summary(
    mission: Mission, plan: Plan, limits: PathLimits, problem: PathProblem | None
) -> list[tuple[str, str, str]]:
    """Return the properties of a plan as rows of name, value and unit."""
    path, parameters = plan.path, planned_parameters(mission)
    times = sample_times(path)
    length = np.linalg.norm(np.diff(evaluate(path, times), axis=1), axis=0).sum()
    rotors = np.array(plan_demand(plan, parameters, times).rotor_speed)
    rows = [
        ("waypoints", f"{len(path.times)}", ""),
        ("duration", f"{plan.duration:.3f}", "s"),
        ("length", f"{length:.2f}", "m"),
        ("top speed", f"{peak_norm(path, 1):.3f}", _with_limit("m/s", limits.speed)),
        ("top acceleration", f"{peak_norm(path, 2):.3f}", _with_limit("m/s²", limits.acceleration)),
        ("top snap", f"{peak_norm(path, 4):.2f}", "m/s⁴"),
        ("snap cost", f"{snap_cost(path).sum():.4g}", "m²/s⁷"),
        (
            "rotor speeds",
            f"{rotors.min():.0f} to {rotors.max():.0f}",
            f"rad/s of {parameters.min_rotor_speed:g} to {parameters.max_rotor_speed:g}",
        ),
    ]
    if problem is not None and len(path.times) < len(problem.waypoints):
        repeats = len(problem.waypoints) - len(path.times)
        rows.insert(1, ("repeated", f"{repeats}", "waypoints that equal the previous one and are passed only once"))
    return rows


def _with_limit(unit: str, limit: float) -> str:
    """Return the unit of a quantity, followed by the quantity's limit if it is finite."""
    return f"{unit} of {limit:g}" if np.isfinite(limit) else unit


def binding_summary(constraints: list[ActiveConstraint]) -> str:
    """Return the active constraints of a path as text, each with the segments on which it is active."""
    segments_by_constraint: dict[str, set[int]] = {}
    for constraint in constraints:
        segments_by_constraint.setdefault(f"{constraint.quantity} {constraint.location}".strip(), set()).add(
            constraint.segment
        )
    parts = [
        f"{name} on segment{'s' if len(segments) > 1 else ''} {_ranges(segments)}"
        for name, segments in segments_by_constraint.items()
    ]
    return "; ".join(parts) or "none"


def _ranges(numbers: set[int]) -> str:
    """Return integers as text, with consecutive integers abbreviated as in `0, 2-4`."""
    runs = itertools.groupby(enumerate(sorted(numbers)), key=lambda pair: pair[1] - pair[0])
    parts = [[number for _, number in run] for _, run in runs]
    return ", ".join(f"{part[0]}-{part[-1]}" if len(part) > 1 else f"{part[0]}" for part in parts)
