"""Design the gains of a scenario's cascade for its laboratory, and print the stability margins of each loop.

If an autopilot controls the attitude on board, only the position gains are designed, around the attitude loop of the
autopilot. With the option --firmware, the command does not design gains. It writes the controller of a
flight-controller firmware, with the gains from the firmware's parameters.
"""

import argparse
import math
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field
from ruamel.yaml import YAML

from drake_quad import InputError
from drake_quad.command_line.firmware import write_firmware_controller
from drake_quad.command_line.flight_remarks import print_flight_remarks, remark_on_estimator
from drake_quad.command_line.options import (
    add_controller,
    add_vector,
    check_ranges,
    parse_overrides,
    parser,
    resolve_output_folder,
    scenario_from_arguments,
)
from drake_quad.command_line.output import (
    flying_command,
    print_columns,
    print_files,
    print_joint_disk_margin,
    print_scales,
    remark,
)
from drake_quad.design.cascade import (
    CascadeDesign,
    LoopOptions,
    default_options,
    design_cascade,
    hover_offset,
    on_board_options,
    with_autopilot_gains,
    with_gains,
    with_integrals,
)
from drake_quad.design.certificate import certify_hover
from drake_quad.design.gains import SLOWER_POLE, OutputRegulator, PolePair
from drake_quad.errors import join_names
from drake_quad.files import output_folder, write_atomically
from drake_quad.linear.closed_loop import ClosedLoop, closed_loop
from drake_quad.linear.link_margins import joint_disk_margin
from drake_quad.linear.modes import MAX_POLE_ERROR, modes
from drake_quad.scenario.batch import median_scenario
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.files.loading import build_model, load_undesigned
from drake_quad.scenario.files.saving import save_scenario
from drake_quad.scenario.hovering import nominal_hover
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.paths import distributions_in
from drake_quad.visualization.design_plots import DESIGN_PLOTS, plot_steps
from drake_quad.visualization.style import save_figures

# Modes with a larger frequency, rad/s, are not printed, since they belong to delay lines and filters.
_MAX_MODE_FREQUENCY = 60.0
# Order in which the loops of the ground station are printed.
_AXIS_ORDER = ("roll", "pitch", "yaw", "z", "x", "y")
# Fraction of the phase margin that the integral gains of a PID may cost by default.
_DEFAULT_INTEGRAL_FRACTION = 0.15
# The command prints a remark if the steady position error in hover exceeds this limit, m. The limit is the lower end of
# the position errors of the shipped flights, which are 1 to 10 cm.
_MAX_HOVER_OFFSET = 0.01
# Smallest and largest values of options: margins in degrees, dB and ticks, and a fraction of the phase margin.
_RANGES = {
    "phase-margin": (0.0, 180.0),
    "gain-margin": (0.0, 60.0),
    "delay-margin": (0.0, 1000.0),
    "integral": (0.01, 0.9),
}


class LoopRequest(Model):
    """Requirements on a loop, from the option `--loop`; None for the default.

    Attributes:
        bandwidth: bandwidth of the pole pair, rad/s.
        damping: damping ratio of the pole pair.
        rate_time: time T in the terms value² + (T · rate)² of the LQR cost, s.
    """

    bandwidth: Annotated[float, Field(ge=1e-3, le=100.0)] | None = None
    damping: Annotated[float, Field(ge=0.05, le=0.999)] | None = None
    rate_time: Annotated[float, Field(ge=0.0, le=10.0)] | None = None


class LoopRequests(Model):
    """Requirements on the loops of a cascade, from the option `--loop`."""

    attitude: LoopRequest = LoopRequest()
    yaw: LoopRequest = LoopRequest()
    height: LoopRequest = LoopRequest()
    position: LoopRequest = LoopRequest()


_LOOP_OF_AXIS = {"roll": "attitude", "pitch": "attitude", "yaw": "yaw", "z": "height", "x": "position", "y": "position"}
# Default value of `LoopRequest.rate_time` for each loop, s.
_DEFAULT_RATE_TIMES = {"attitude": 0.2, "yaw": 0.2, "height": 0.2, "position": 1.0}


def options() -> argparse.ArgumentParser:
    result = parser(__doc__, "drake-quad design laboratory:nominal --phase-margin 50", output="out/gains")
    add_design_options(result)
    add_controller(result)
    result.add_argument(
        "--firmware",
        metavar="FILE",
        help="write the controller of PX4 or of a Crazyflie, with the parameters in a file: a parameter file of"
        " QGroundControl or of the Crazyflie client, or a ULog; px4 or crazyflie for the default parameters",
    )
    add_vector(result)
    return result


def main(arguments: argparse.Namespace) -> None:
    if arguments.firmware is not None:
        refuse_design_options(arguments)
        write_firmware_controller(arguments)
        return
    scenario = scenario_from_arguments(arguments, load=load_undesigned)
    has_distributions = bool(distributions_in(scenario))
    if arguments.certify and not has_distributions:
        raise InputError(f"--certify: {scenario.name} contains no distribution, so there is nothing to certify")
    print_flight_remarks([scenario])
    remark_on_estimator(scenario)
    loop_options = design_options(arguments, scenario)
    if arguments.integral is not None:
        scenario = with_integrals(scenario)
    # A PID has integral gains, which are designed even without the option `--integral`.
    integral = arguments.integral
    if integral is None and scenario.cascade.position.has_integral:
        integral = _DEFAULT_INTEGRAL_FRACTION
    if has_distributions:
        remark("the gains are designed for the median of each distribution")
    design = design_cascade(median_scenario(scenario), loop_options, on_board=arguments.on_board, integral=integral)
    designed = with_gains(scenario, design.gains())
    if arguments.on_board:
        designed = with_autopilot_gains(designed, design.autopilot_gains())
    for sentence in design_remarks(design, designed):
        remark(sentence)
    loop = closed_loop(nominal_hover(median_scenario(designed)))
    folder = output_folder(resolve_output_folder(arguments, scenario))
    files = [
        write_atomically(folder / "gains.yaml", lambda path: write_gains(design, designed, path, arguments.command)),
        write_atomically(folder / "scenario.yaml", lambda path: save_scenario(designed, path)),
    ]
    figures = {name: plot(design) for name, plot in DESIGN_PLOTS.items()} | {"steps": plot_steps(loop)}
    files += save_figures(figures, folder, vector=arguments.vector)
    print_design(design)
    print_modes(loop)
    print_joint_disk_margin(joint_disk_margin(nominal_hover(median_scenario(designed))))
    if arguments.certify:
        print_scales(designed.name, certify_hover(designed))
    print(f"\nto use the gains in a scenario, write `extends: [FILE:NAME, {files[0]}]`; to fly the designed scenario:")
    command = ("study", designed, files[1], "--samples 32") if has_distributions else ("fly", designed, files[1])
    print(f"  {flying_command(*command)}")
    print_files(files)


def design_remarks(design: CascadeDesign, designed: Scenario) -> list[str]:
    """Return remarks on a design.

    The remarks concern loops whose bandwidth is limited by a slow pole, and a steady offset in hover if no loop has an
    integral.
    """
    remarks = []
    limited = [axis for axis in _AXIS_ORDER if axis in design.loops and SLOWER_POLE in design.loops[axis].limits]
    if limited and designed.laboratory.autopilot.controls_attitude:
        remarks.append(
            f"a slow pole of the loops on board limits {join_names(limited)}, rather than a margin; an integral on"
            " board can cause such a pole; --method lqr has no such limit and may give a faster loop"
        )
    autopilot: Any = designed.laboratory.autopilot
    terms = (autopilot.attitude_terms, autopilot.rate_terms) if design.on_board else ()
    integrates = designed.cascade.position.has_integral or any(each is not None and each.k_i for each in terms)
    offset = hover_offset(median_scenario(designed)) if design.on_board and not integrates else 0.0
    if offset > _MAX_HOVER_OFFSET:
        remarks.append(
            f"the vehicle will hover {100.0 * offset:.0f} cm from its reference, because its centre of mass is not in"
            " the middle, and neither the loops on board nor the position loops have an integral; --integral adds"
            " one to the position loops"
        )
    return remarks


def refuse_design_options(arguments: argparse.Namespace) -> None:
    """Raise InputError if the arguments contain a design option, since `--firmware` designs no gains."""
    parser = argparse.ArgumentParser(add_help=False)
    add_design_options(parser)
    for name, default in vars(parser.parse_args([])).items():
        if getattr(arguments, name) != default:
            raise InputError(
                f"--{name.replace('_', '-')} cannot be combined with --firmware, which designs no gains; leave one out"
            )


def add_design_options(options: argparse.ArgumentParser) -> None:
    """Add the options for the design of gains."""
    options.add_argument(
        "--method",
        choices=("poles", "lqr"),
        default="poles",
        help="design method: placement of two poles, or a linear-quadratic regulator (default: %(default)s)",
    )
    options.add_argument(
        "--phase-margin",
        type=float,
        metavar="DEGREES",
        help="smallest permitted phase margin of a loop, in degrees (default: 45, or 60 for loops on board)",
    )
    options.add_argument(
        "--gain-margin",
        type=float,
        metavar="DB",
        help="smallest permitted gain margin of every loop, in dB (default: 6, or 10 for loops on board)",
    )
    options.add_argument(
        "--delay-margin",
        type=float,
        metavar="TICKS",
        help="smallest permitted delay margin of attitude loops through the ground station, in ticks (default: 2)",
    )
    options.add_argument(
        "--on-board",
        action="store_true",
        help="before the position gains, design the gains k_rate and k_attitude of an autopilot of kind `attitude`",
    )
    options.add_argument(
        "--integral",
        type=float,
        metavar="FRACTION",
        help="design a PID for the position, whose integral gains may cost this fraction of the phase margin (default:"
        f" {_DEFAULT_INTEGRAL_FRACTION:g} if the scenario has a PID, otherwise no integral)",
    )
    options.add_argument(
        "--loop",
        metavar="LOOP.FIELD=VALUE",
        action="append",
        default=[],
        help="change a requirement on a loop, as in position.damping=0.7. Loops are attitude, yaw, height and position."
        " Fields are bandwidth (rad/s, default: the largest bandwidth with the required margins) and damping (default:"
        " 0.8) of the pole pair. With --method lqr, the only field is rate_time (s): the cost contains value² +"
        " (rate_time · rate)²",
    )
    options.add_argument(
        "--certify",
        action="store_true",
        help="print the scale up to which hover is certified to be stable for all random parameters at once, as"
        " `drake-quad certify` does; this takes one or more minutes",
    )


def design_options(arguments: argparse.Namespace, scenario: Scenario) -> dict[str, LoopOptions]:
    """Return the design options of each axis: the defaults, changed as the command-line arguments request.

    Raises:
        InputError: if a value is out of range, an option belongs to the other design method, or an option concerns
            attitude control on the ground although the autopilot controls the attitude on board.
    """
    check_ranges(arguments, _RANGES)
    requests = build_model(LoopRequests, parse_overrides(arguments.loop, "--loop"))
    period = scenario.laboratory.command_link.period
    requested = [(loop, name) for loop, request in requests for name in request.model_fields_set]
    for loop, name in requested:
        method = "lqr" if name == "rate_time" else "poles"
        if method != arguments.method:
            raise InputError(f"--loop {loop}.{name} requires --method {method}")
    if scenario.laboratory.autopilot.controls_attitude:
        on_ground = [f"--loop {loop}.{name}" for loop, name in requested if loop in ("attitude", "yaw")]
        for option in [*on_ground, *(["--delay-margin"] if arguments.delay_margin is not None else [])]:
            kind = scenario.laboratory.autopilot.kind
            raise InputError(
                f"{option} belongs to attitude control on the ground, but laboratory.autopilot is of kind {kind}, which"
                " controls the attitude on board; leave the option out"
            )
    options_by_axis = {}
    for axis, default in default_options(period).items():
        request: LoopRequest = getattr(requests, _LOOP_OF_AXIS[axis])
        family = default.family if request.damping is None else PolePair(request.damping)
        if arguments.method == "lqr":
            rate_time = _DEFAULT_RATE_TIMES[_LOOP_OF_AXIS[axis]] if request.rate_time is None else request.rate_time
            family = OutputRegulator(rate_time)
        options_by_axis[axis] = default._replace(family=family, effort=request.bandwidth)
    options_by_axis |= on_board_options() if arguments.on_board else {}
    return {axis: _with_margins(arguments, period, each) for axis, each in options_by_axis.items()}


def _with_margins(arguments: argparse.Namespace, period: float, options: LoopOptions) -> LoopOptions:
    """Return the options of an axis, with the margins that the command-line arguments request."""
    requested = {"phase": arguments.phase_margin, "gain": arguments.gain_margin}
    if options.requirements.delay and arguments.delay_margin is not None:
        requested["delay"] = arguments.delay_margin * period
    margins = {name: margin for name, margin in requested.items() if margin is not None}
    return options._replace(requirements=options.requirements._replace(**margins))


def write_gains(design: CascadeDesign, designed: Scenario, path: Path, command: str) -> None:
    """Write the gains as YAML that a scenario can extend, with the command that designed them in a comment.

    The file also contains the fields `kind`, `derivative` and `feed_forward`, so that it completely replaces any other
    controller.
    """
    yaml = YAML()
    yaml.default_flow_style = None
    with path.open("w", encoding="utf-8") as file:
        file.write(f"# {command}\n")
        blocks = design.gains()
        copied_fields = {"position": ("kind", "derivative", "feed_forward"), "attitude": ("kind",)}
        control = {
            name: {field: getattr(getattr(designed.cascade, name), field) for field in copied_fields[name]} | block
            for name, block in blocks.items()
        }
        gains: dict[str, Any] = {"control": {"kind": "cascade", **control}}
        if design.on_board:
            gains["laboratory"] = {"autopilot": design.autopilot_gains()}
        yaml.dump({"gains": gains}, file)


def print_design(design: CascadeDesign) -> None:
    """Print a table of gains and margins with a row for each axis."""
    titles = "axis, k_P, k_D, k_I, phase, gain, delay, ticks, disk, crossover, bandwidth, max |S|, limited by"
    if design.on_board:
        titles = titles.replace("k_P", "k_P or k", 1)
    rows = []
    for axis in [*design.on_board, *(axis for axis in _AXIS_ORDER if axis in design.loops)]:
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
                (", ".join(loop.limits) or "as requested")
                + (f"; cost {cost:.2f} × the cost of full state feedback" if cost is not None else ""),
            )
        )
    rate_text = ", or rate" if design.on_board else ""
    print(f"stability margins of each loop, opened at its commanded acceleration{rate_text}")
    print_columns(titles.split(", "), rows)


def print_modes(loop: ClosedLoop) -> None:
    """Print the modes of the whole closed loop, from the slowest to the fastest mode."""
    system = loop.system
    rows = []
    for mode in modes(system.A, system.states, period=system.period):
        if mode.frequency < _MAX_MODE_FREQUENCY:
            paths = [name.split(".") for name in mode.states]
            of_vehicle = ["rotors" if path[-2] == "rotor_speed" else path[-1] for path in paths if "vehicle" in path]
            # If the vehicle hardly participates in a mode, the mode is labelled with the other parts of the loop.
            states = of_vehicle or [path[1] if path[0] == "laboratory" else path[0] for path in paths]
            if math.isnan(mode.damping):
                numbers = f"< {MAX_POLE_ERROR:g} rad/s", "–", f"> {1.0 / MAX_POLE_ERROR:.0f} s"
            else:
                numbers = (
                    f"{mode.frequency:.2f} rad/s",
                    f"{mode.damping:.2f}",
                    f"{-1.0 / mode.pole.real:.2f} s",
                )
            rows.append((*numbers, ", ".join(dict.fromkeys(states))))
    print(f"\nmodes of the whole closed loop over a period of {system.period:g} s")
    print_columns(("frequency", "damping", "time constant", "states"), rows)
