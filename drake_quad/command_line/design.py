"""Designs the gains of a scenario's cascade for its laboratory, and states the margins that they keep.

With an autopilot on board the gains are those of the position, around the attitude as it is controlled on board.
"""

import argparse
import itertools
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

from drake_quad import InputError
from drake_quad.command_line.options import add_vector, all_overrides_of, folder_of, parser
from drake_quad.command_line.output import print_columns, print_files, remark
from drake_quad.design.cascade import (
    CascadeDesign,
    LoopOptions,
    default_options,
    design_cascade,
    on_board_options,
    with_autopilot_gains,
    with_gains,
    with_integrals,
)
from drake_quad.design.gains import PolePair, RegulatorRequirements
from drake_quad.files import output_folder, write_whole
from drake_quad.linear.closed_loop import ClosedLoop, closed_loop
from drake_quad.linear.modes import modes
from drake_quad.scenario.batch import middle_of
from drake_quad.scenario.files.loading import load_undesigned
from drake_quad.scenario.files.saving import save_scenario
from drake_quad.scenario.hovering import as_believed
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.paths import distributions_in
from drake_quad.visualization.design_plots import DESIGN_PLOTS, plot_steps
from drake_quad.visualization.style import save_figures

# Modes that are faster belong to delay lines and filters and are not printed, rad/s.
_FASTEST_MODE = 60.0
# The axes of each loop, and the default cost of a rate beside that of a value with --method lqr, s.
_AXES = {"attitude": ("roll", "pitch"), "yaw": ("yaw",), "height": ("z",), "position": ("x", "y")}
_RATE_TIMES = {"attitude": 0.2, "yaw": 0.2, "height": 0.2, "position": 1.0}
# In which loops on the ground are printed.
_ORDER = ("roll", "pitch", "yaw", "z", "x", "y")
# The part of the phase margin that the integrals of a PID cost if nothing is said.
_INTEGRAL = 0.15
# The options of each loop: the method that they are for, and their range.
_LIMITS = {"bandwidth": ("poles", 1e-3, 100.0), "damping": ("poles", 0.05, 0.999), "rate_time": ("lqr", 0.0, 10.0)}
_MARGINS = {"phase_margin": 180.0, "gain_margin": 60.0, "delay_margin": 1000.0}


def options() -> argparse.ArgumentParser:
    """The options of the command."""
    result = parser(
        "design",
        __doc__,
        example="drake-quad design laboratory:nominal --phase-margin 50",
        output="out/gains",
        scenario="figure_eight",
    )
    add_design_options(result)
    add_vector(result)
    return result


def main(arguments: argparse.Namespace) -> None:
    """Runs the command."""
    scenario = load_undesigned(arguments.scenario, all_overrides_of(arguments))
    period = scenario.laboratory.command_link.period
    if scenario.laboratory.autopilot.controls_attitude:
        _check_position_alone(arguments, scenario.laboratory.autopilot.kind)
    if arguments.integral is not None:
        scenario = with_integrals(scenario)
    # A PID has its integral designed, too.
    integral = arguments.integral
    if integral is None and scenario.cascade.position.has_integral:
        integral = _INTEGRAL
    uncertain = bool(distributions_in(scenario))
    if uncertain:
        remark("gains are designed for the median of each distribution")
    middle, chosen = middle_of(scenario), design_options(arguments, period)
    design = design_cascade(middle, chosen, on_board=arguments.on_board, integral=integral)
    designed = with_gains(scenario, design.gains())
    if arguments.on_board:
        designed = with_autopilot_gains(designed, design.autopilot_gains())
    loop = closed_loop(as_believed(middle_of(designed)))
    folder = output_folder(folder_of(arguments, scenario.name))
    files = [
        write_whole(folder / "gains.yaml", lambda path: write_gains(design, designed, path, arguments.command)),
        write_whole(folder / "scenario.yaml", lambda path: save_scenario(designed, path)),
    ]
    figures = {name: plot(design) for name, plot in DESIGN_PLOTS.items()} | {"steps": plot_steps(loop)}
    files += save_figures(figures, folder, vector=arguments.vector)
    print_design(design)
    print_modes(loop)
    print(f"\na scenario takes the gains by `extends: [FILE:NAME, {files[0]}]`, in this order; or fly it as it is:")
    fly = "study {} --samples 32" if uncertain else "fly {}"
    print(f"  drake-quad {fly.format(files[1])}")
    print_files(files)


def add_design_options(options: argparse.ArgumentParser) -> None:
    """Adds the options that say how gains shall be designed."""
    options.add_argument("--method", choices=("poles", "lqr"), default="poles", help="place two poles, or least cost")
    options.add_argument("--phase-margin", type=float, metavar="DEGREES", help="of every loop (45; on board 60)")
    options.add_argument("--gain-margin", type=float, metavar="DB", help="of every loop (6; on board 10)")
    options.add_argument("--delay-margin", type=float, metavar="TICKS", help="of the attitude loops on the ground (2)")
    options.add_argument(
        "--on-board", action="store_true", help="design k_rate and k_attitude of an autopilot of kind attitude first"
    )
    options.add_argument(
        "--integral",
        type=float,
        metavar="PART",
        help="design a PID for the position, whose integral costs this part of the phase margin"
        f" ({_INTEGRAL:g} for what is a PID already)",
    )
    for loop, rate_time in _RATE_TIMES.items():
        options.add_argument(
            f"--{loop}-bandwidth",
            type=float,
            metavar="RAD/S",
            help="of the pole pair (the highest that keeps the margins)",
        )
        options.add_argument(f"--{loop}-damping", type=float, metavar="RATIO", help="of the pole pair (0.8)")
        options.add_argument(
            f"--{loop}-rate-time",
            type=float,
            metavar="SECONDS",
            help=f"what a rate costs beside a value, with --method lqr ({rate_time:g})",
        )


def design_options(arguments: argparse.Namespace, period: float) -> dict[str, LoopOptions]:
    """How each axis shall be designed: as by default, except for what the arguments ask for.

    Raises:
        InputError: a number is out of range, or is for the other method.
    """
    for name, limit in _MARGINS.items():
        _check(name, getattr(arguments, name), 0.0, limit)
    _check("integral", arguments.integral, 0.01, 0.9)
    for loop, (name, (method, least, most)) in itertools.product(_AXES, _LIMITS.items()):
        value = getattr(arguments, f"{loop}_{name}")
        _check(f"{loop}_{name}", value, least, most)
        if value is not None and method != arguments.method:
            raise InputError(f"--{loop}-{name.replace('_', '-')} is for --method {method}")
    found = {
        axis: _asked(arguments, loop, period, default)
        for axis, default in default_options(period).items()
        for loop in _AXES
        if axis in _AXES[loop]
    }
    if arguments.on_board:
        found |= {axis: _with_margins(arguments, period, default) for axis, default in on_board_options().items()}
    return found


def _asked(arguments: argparse.Namespace, loop: str, period: float, default: LoopOptions) -> LoopOptions:
    """The options of an axis: the default ones, except for what the arguments ask for its loop."""
    family = default.family
    bandwidth, damping, rate_time = (getattr(arguments, f"{loop}_{name}") for name in _LIMITS)
    if arguments.method == "lqr":
        family = RegulatorRequirements(_RATE_TIMES[loop] if rate_time is None else rate_time)
    elif damping is not None:
        family = PolePair(damping)
    return _with_margins(arguments, period, LoopOptions(family, default.requirements, bandwidth))


def _with_margins(arguments: argparse.Namespace, period: float, options: LoopOptions) -> LoopOptions:
    """The options of an axis with the margins that the arguments ask for."""
    phase, gain, delay = (getattr(arguments, name) for name in _MARGINS)
    requirements = options.requirements
    if phase is not None:
        requirements = requirements._replace(phase=phase)
    if gain is not None:
        requirements = requirements._replace(gain=gain)
    if delay is not None and requirements.delay:
        requirements = requirements._replace(delay=delay * period)
    return options._replace(requirements=requirements)


def _check_position_alone(arguments: argparse.Namespace, kind: str) -> None:
    """Raises InputError if an option is for an attitude loop on the ground, which an autopilot replaces."""
    for loop, name in itertools.product(("attitude", "yaw"), _LIMITS):
        if getattr(arguments, f"{loop}_{name}") is not None:
            raise InputError(
                f"--{loop}-{name.replace('_', '-')} is for attitude control on the ground, but laboratory.autopilot is"
                f" of kind {kind}"
            )
    if arguments.delay_margin is not None:
        raise InputError(
            f"--delay-margin is for attitude control on the ground, but laboratory.autopilot is of kind {kind}"
        )


def _check(name: str, value: float | None, least: float, most: float) -> None:
    if value is not None and not least <= value <= most:
        raise InputError(f"--{name.replace('_', '-')} is {value:g}, but must be between {least:g} and {most:g}")


def write_gains(design: CascadeDesign, designed: Scenario, path: Path, command: str) -> None:
    """Writes the gains as YAML that a scenario can extend, under the command that designed them.

    They replace whatever they are laid over, and so say their kind, and what is differentiated and fed forward.
    """
    yaml = YAML()
    yaml.default_flow_style = None
    with path.open("w", encoding="utf-8") as file:
        file.write(f"# {command}\n")
        blocks = design.gains()
        kept = {"position": ("kind", "derivative", "feed_forward"), "attitude": ("kind",)}
        control = {
            name: {field: getattr(getattr(designed.cascade, name), field) for field in kept[name]} | block
            for name, block in blocks.items()
        }
        gains: dict[str, Any] = {"control": {"kind": "cascade", **control}}
        if design.on_board:
            gains["laboratory"] = {"autopilot": design.autopilot_gains()}
        yaml.dump({"gains": gains}, file)


def print_design(design: CascadeDesign) -> None:
    """Prints gains and margins, with a row for each axis."""
    titles = "axis, k_P, k_D, k_I, phase, gain, delay, ticks, disk, crossover, bandwidth, max |S|, limit"
    if design.on_board:
        titles = titles.replace("k_P", "k_P or k", 1)
    rows = []
    for axis in [*design.on_board, *(axis for axis in _ORDER if axis in design.loops)]:
        loop = design.all_loops[axis]
        margins, cost = loop.margins, loop.cost_ratio
        gains = [f"{gain:.4g}" for gain in loop.gains]
        rows.append(
            (
                axis,
                *(gains + ["–"] * (3 - len(gains))),
                f"{margins.phase:.1f}°",
                f"{margins.gain:.1f} dB",
                f"{1e3 * margins.delay:.0f} ms",
                f"{margins.delay / loop.plant.period:.1f}",
                f"{margins.disk:.2f}",
                f"{margins.crossover:.2f} rad/s",
                f"{margins.bandwidth:.2f} rad/s",
                f"{margins.sensitivity:.2f}",
                (", ".join(loop.limits) or "as asked")
                + (f"; cost {cost:.2f} × the full regulator's" if cost is not None else ""),
            )
        )
    at = ", or rate" if design.on_board else ""
    print(f"margins of each loop, broken at its commanded acceleration{at}")
    print_columns(titles.split(", "), rows)


def print_modes(loop: ClosedLoop) -> None:
    """Prints the Floquet multipliers of the whole loop as modes, the slowest first."""
    system = loop.system
    rows = []
    for mode in modes(system.A, system.states, period=system.period):
        if mode.frequency < _FASTEST_MODE:
            steps = (name.split(".")[-2:] for name in mode.states if ".vehicle." in name)
            states = ", ".join(dict.fromkeys("rotors" if group == "rotor_speed" else row for group, row in steps))
            decay = -mode.pole.real
            rows.append((f"{mode.frequency:.2f} rad/s", f"{mode.damping:.2f}", f"{1.0 / decay:.2f} s", states))
    print(f"\nmodes of the whole loop, from one tick to the next ({system.period:g} s)")
    print_columns(("frequency", "damping", "time constant", "states"), rows)
