"""The gains of a scenario's whole cascade."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from drake_quad.design.gains import (
    AxisGains,
    GainFamily,
    LoopDesign,
    PolePair,
    Proportional,
    ProportionalGain,
    Requirements,
    add_integral,
    design_loop,
)
from drake_quad.errors import InputError
from drake_quad.linear.closed_loop import LaboratoryPlant, laboratory_plant, on_board_plant
from drake_quad.linear.sampled_system import SampledSystem
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.paths import updated
from drake_quad.scenario.position_controllers.pid import PidPosition

# Which torque turns which angle at which rate; thrust lifts like a torque turns.
_SIGNALS = {
    "roll": ("tau_x", "roll", "p"),
    "pitch": ("tau_y", "pitch", "q"),
    "yaw": ("tau_z", "yaw", "r"),
    "z": ("thrust", "z", "v_z"),
}
_ANGLES = ("roll", "pitch", "yaw")
_POSITION = ("x", "y", "z")
# Which tilt moves the vehicle along which axis, and in which direction, eq (7).
_TILTS = {"x": ("pitch", 1.0), "y": ("roll", -1.0)}


class LoopOptions(NamedTuple):
    """Options for the design of a loop.

    Attributes:
        family: of gains.
        requirements: that it must meet.
        effort: that is asked for; None for the largest that meets them.
    """

    family: GainFamily
    requirements: Requirements
    effort: float | None = None


@dataclass(frozen=True)
class CascadeDesign:
    """The loops of a cascade, by axis: roll, pitch, yaw, x, y, z; of those on board: roll rate, roll, and so on.

    Attributes:
        loops: on the ground; those of the attitude are there if it is controlled there.
        on_board: those of an autopilot, if they have been designed.
    """

    loops: Mapping[str, LoopDesign]
    on_board: Mapping[str, LoopDesign] = field(default_factory=dict)

    @property
    def all_loops(self) -> dict[str, LoopDesign]:
        """All loops: those on board first, then those on the ground."""
        return {**self.on_board, **self.loops}

    def gains(self) -> dict[str, dict[str, list[float]]]:
        """Return the gains as the block `control` of a scenario has them."""
        blocks = {"position": _POSITION, "attitude": _ANGLES}
        designed = {
            block: [self.loops[axis].gains for axis in axes]
            for block, axes in blocks.items()
            if self.loops.keys() >= {*axes}
        }
        return {
            block: {name: [getattr(gains, name) for gains in loops] for name in loops[0]._fields}
            for block, loops in designed.items()
        }

    def autopilot_gains(self) -> dict[str, list[float]]:
        """The gains as the block `laboratory.autopilot` of a scenario has them; none if none have been designed."""
        if not self.on_board:
            return {}
        loops = {"k_attitude": _ANGLES, "k_rate": [_rate_of(angle) for angle in _ANGLES]}
        return {name: [_proportional(self.on_board[loop]) for loop in axes] for name, axes in loops.items()}


def _rate_of(angle: str) -> str:
    return f"{angle} rate"


def _proportional(loop: LoopDesign) -> float:
    assert isinstance(loop.gains, ProportionalGain)
    return loop.gains.k


def with_integrals(scenario: Scenario) -> Scenario:
    """Return the scenario with a PID, whose k_I are zero, in place of a position controller without an integral.

    Raises:
        InputError: if the gains of the position controller cannot be designed.
    """
    if scenario.cascade.position.has_integral:
        return scenario
    return updated(scenario, {"control.position": _integrating(scenario)})


def _integrating(scenario: Scenario) -> PidPosition:
    return PidPosition.around(scenario.cascade.position.plain())


def with_gains(scenario: Scenario, gains: Mapping[str, Mapping[str, Sequence[float]]]) -> Scenario:
    """Return the scenario with other gains, as `CascadeDesign.gains` has them.

    They are those of controllers without estimates: in place of any other stands a PD.

    Raises:
        InputError: if the gains of the position controller cannot be designed.
    """
    blocks = {f"control.{name}": getattr(scenario.cascade, name).plain() for name in gains}
    rows = {f"control.{name}.{kind}": tuple(own) for name, block in gains.items() for kind, own in block.items()}
    return updated(updated(scenario, blocks), rows)


def with_autopilot_gains(scenario: Scenario, gains: Mapping[str, Sequence[float]]) -> Scenario:
    """Return the scenario with other gains on board, as `CascadeDesign.autopilot_gains` has them."""
    return updated(scenario, {f"laboratory.autopilot.{name}": tuple(rows) for name, rows in gains.items()})


def default_options(period: float) -> dict[str, LoopOptions]:
    """Return options for the fastest pole pairs with margins of 45°, 6 dB and, for the attitude, two ticks of delay.

    Args:
        period: of the ticks, s.
    """
    pair, outer = PolePair(0.8), Requirements()
    inner = outer._replace(delay=2.0 * period)
    return {axis: LoopOptions(pair, inner if axis in _ANGLES else outer) for axis in (*_SIGNALS, *_TILTS)}


def on_board_options() -> dict[str, LoopOptions]:
    """Return options for the fastest gains of an autopilot's loops with margins of 60° and 10 dB.

    That is more than on the ground, since every packet of the link is a step for these loops: they shall hardly
    overshoot.
    """
    return {
        loop: LoopOptions(Proportional(), Requirements(phase=60.0, gain=10.0))
        for angle in _ANGLES
        for loop in (_rate_of(angle), angle)
    }


def design_cascade(
    scenario: Scenario,
    options: Mapping[str, LoopOptions] | None = None,
    *,
    on_board: bool = False,
    integral: float | None = None,
) -> CascadeDesign:
    """Design the gains of a scenario's cascade for its laboratory and its nominal vehicle.

    With an autopilot only the position loops are designed, around the attitude loops of the autopilot.

    Args:
        scenario: scenario, whose own gains of the designed loops are ignored.
        options: options for each axis; by default `default_options`, and `on_board_options` for an autopilot.
        on_board: True to design the loops of an autopilot of kind `attitude` first.
        integral: share of the phase margin that the integrals of the position loops may cost, between 0 and 1. The PD
            is designed with a phase margin that is larger by this share, and the margins include the integral. None for
            a PD.

    Raises:
        InputError: requirements cannot be met, the scenario contains distributions, or it has no on-board loops to
            design.
    """
    period = scenario.laboratory.command_link.period
    wanted = default_options(period) | (on_board_options() if on_board else {}) | dict(options or {})
    inner: dict[str, LoopDesign] = {}
    if on_board:
        inner = _design_on_board(scenario, wanted)
        scenario = with_autopilot_gains(scenario, CascadeDesign({}, inner).autopilot_gains())
    laboratory = laboratory_plant(scenario)
    loops: dict[str, LoopDesign] = {}

    def add(axis: str, plant: SampledSystem) -> None:
        """Design a loop, unless there is already one like it: an even vehicle's axes are alike."""
        how = wanted[axis]
        required = how.requirements
        if integral is not None and axis in _POSITION:
            how = how._replace(requirements=required._replace(phase=required.phase / (1.0 - integral)))
        for other in loops.values():
            if wanted[other.axis] == wanted[axis] and _alike(other.plant, plant):
                loops[axis] = replace(other, axis=axis)
                return
        loops[axis] = _designed(plant, how, axis)

    on_the_ground = not scenario.laboratory.autopilot.controls_attitude
    for axis in _SIGNALS if on_the_ground else ("z",):
        add(axis, attitude_plant(laboratory, scenario, axis))
    for axis, (tilt, _) in _TILTS.items():
        attitude = loops[tilt].gains if on_the_ground else None
        assert attitude is None or isinstance(attitude, AxisGains)
        add(axis, position_plant(laboratory, scenario, axis, attitude))
    if integral is not None:
        integration = _integrating(scenario).integration
        for axis in _POSITION:
            required = wanted[axis].requirements
            loops[axis] = add_integral(loops[axis], required, cost=integral, integration=integration)
    return CascadeDesign(loops, inner)


def _design_on_board(scenario: Scenario, options: Mapping[str, LoopOptions]) -> dict[str, LoopDesign]:
    """Design the loops of an autopilot: those of the rates, each the fastest within its margins, then those around.

    Args:
        scenario: with an autopilot of kind attitude, whose gains do not matter.
        options: for each loop.

    Raises:
        InputError: requirements cannot be met, or there is no such autopilot.
    """
    if not scenario.laboratory.autopilot.loop_gains:
        kind = scenario.laboratory.autopilot.kind
        raise InputError(f"laboratory.autopilot is of kind {kind}, which has no loops on board that could be designed")
    plant, inertia = on_board_plant(scenario), scenario.nominal.inertia
    loops = {}
    for angle, moment in zip(_ANGLES, inertia, strict=True):
        turned = turned_on_board(plant, angle, moment)
        name = _rate_of(angle)
        inner = turned.between(turned.inputs, turned.outputs[1:]).connected()
        loops[name] = _designed(inner, options[name], name)
        outer = on_board_attitude_plant(turned, _proportional(loops[name]))
        loops[angle] = _designed(outer, options[angle], angle)
    return loops


def turned_on_board(plant: SampledSystem, angle: str, inertia: float) -> SampledSystem:
    """From an angular acceleration that an autopilot commands to an angle and its rate.

    Args:
        plant: of `on_board_plant`.
        angle: roll, pitch or yaw.
        inertia: believed, about the axis of this angle, kg m².
    """
    torque, value, rate = _SIGNALS[angle]
    turned = plant.between([f"wrench.{torque}"], [f"state.{value}", f"state.{rate}"])
    return turned.connected().scaled(inertia, "acceleration_command")


def on_board_attitude_plant(turned: SampledSystem, k_rate: float) -> SampledSystem:
    """From a commanded body rate to the angle, the rate loop closed.

    Args:
        turned: from an angular acceleration to an angle and its rate, over a period of the autopilot.
        k_rate: 1/s.
    """
    closed = turned.with_feedback(np.array([[0.0, k_rate]])).scaled(k_rate, "rate_command")
    return closed.between(closed.inputs, closed.outputs[:1])


def _designed(plant: SampledSystem, how: LoopOptions, axis: str) -> LoopDesign:
    return design_loop(plant, how.family, how.requirements, axis=axis, effort=how.effort)


def _alike(a: SampledSystem, b: SampledSystem) -> bool:
    """True if two plants answer alike from tick to tick, whatever their states are called."""
    return len(a.A) == len(b.A) and np.allclose(_markov(a), _markov(b), rtol=1e-9, atol=1e-12)


def _markov(plant: SampledSystem) -> np.ndarray:
    """Return the answer to an impulse, long enough to tell plants with these many states apart."""
    state, answer = plant.B, []
    for _ in range(2 * len(plant.A)):
        answer.append(plant.C @ state)
        state = plant.A @ state
    return np.array(answer)


def attitude_plant(laboratory: LaboratoryPlant, scenario: Scenario, axis: str) -> SampledSystem:
    """From a commanded angular acceleration (or, for z, a linear one) to the measured value and rate of an axis.

    Args:
        laboratory: of `laboratory_plant`.
        scenario: with the nominal mass and inertia, by which commands become torques.
        axis: roll, pitch, yaw or z; only z if the attitude is controlled on board.
    """
    return _plant(laboratory, scenario, axis, _SIGNALS[axis][1:])


def position_plant(
    laboratory: LaboratoryPlant, scenario: Scenario, axis: str, attitude: AxisGains | None
) -> SampledSystem:
    """From a commanded acceleration on x or y to the measured position and velocity, the attitude loop closed.

    Args:
        laboratory: of `laboratory_plant`.
        scenario: with the nominal vehicle.
        axis: x or y.
        attitude: gains of the tilt that moves along this axis; None if it is controlled on board.
    """
    tilt, sign = _TILTS[axis]
    if attitude is None:
        plant = laboratory.system.between([f"attitude_target.{tilt}"], [f"measurement.{axis}", f"measurement.v_{axis}"])
        return plant.connected().scaled(sign / laboratory.specific_thrust, "acceleration_command")
    whole = _plant(laboratory, scenario, tilt, (*_SIGNALS[tilt][1:], axis, f"v_{axis}"))
    k_p, k_d = attitude
    closed = whole.with_feedback(np.array([[k_p, k_d, 0.0, 0.0]]))
    command = closed.scaled(sign * k_p / laboratory.specific_thrust, "acceleration_command")
    return command.between(command.inputs, command.outputs[2:])


def _plant(laboratory: LaboratoryPlant, scenario: Scenario, axis: str, measured: tuple[str, ...]) -> SampledSystem:
    torque = _SIGNALS[axis][0]
    nominal = scenario.nominal
    inertia = dict(zip(("tau_x", "tau_y", "tau_z"), nominal.inertia, strict=True)) | {"thrust": nominal.mass}
    command = scenario.laboratory.autopilot.command
    plant = laboratory.system.between([f"{command}.{torque}"], [f"measurement.{name}" for name in measured])
    return plant.connected().scaled(inertia[torque], "acceleration_command")
