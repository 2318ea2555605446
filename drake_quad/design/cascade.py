"""Design of all gains in a scenario's cascade."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from drake_quad.design.gains import (
    AxisPdGains,
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
from drake_quad.scenario.paths import with_values
from drake_quad.scenario.position_controllers.pid import PidPosition

# Signals of each loop: torque, angle and body rate of an attitude loop; thrust, height and vertical velocity of the
# height loop.
_LOOP_SIGNALS = {
    "roll": ("tau_x", "roll", "p"),
    "pitch": ("tau_y", "pitch", "q"),
    "yaw": ("tau_z", "yaw", "r"),
    "z": ("thrust", "z", "v_z"),
}
_ANGLES = ("roll", "pitch", "yaw")
_POSITION_AXES = ("x", "y", "z")
# Tilt angle that accelerates the vehicle along each axis, and the sign of this acceleration; see eq (7) of the paper.
_TILT_OF_AXIS = {"x": ("pitch", 1.0), "y": ("roll", -1.0)}


class LoopOptions(NamedTuple):
    """Design options for one loop.

    Attributes:
        family: family of gains that the design searches.
        requirements: margins that the loop must have.
        effort: parameter of the family that determines the gains, such as the bandwidth of a pole pair; None for the
            largest effort that meets the requirements.
    """

    family: GainFamily
    requirements: Requirements
    effort: float | None = None


@dataclass(frozen=True)
class CascadeDesign:
    """Designed loops of a cascade, by name: roll, pitch, yaw, x, y, z; on board also roll rate, pitch rate, yaw rate.

    Attributes:
        loops: loops on the ground, which are closed over the command link. They include the attitude loops, unless an
            autopilot controls the attitude.
        on_board: loops of an autopilot, if the design includes them.
    """

    loops: Mapping[str, LoopDesign]
    on_board: Mapping[str, LoopDesign] = field(default_factory=dict)

    @property
    def all_loops(self) -> dict[str, LoopDesign]:
        """All loops of the cascade: first the loops on board, then the loops on the ground."""
        return {**self.on_board, **self.loops}

    def gains(self) -> dict[str, dict[str, list[float]]]:
        """Return the gains of the loops on the ground, as fields of the scenario block `control`."""
        blocks = {"position": _POSITION_AXES, "attitude": _ANGLES}
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
        """Return the gains on board, as fields of the block `laboratory.autopilot`; empty if none were designed."""
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
    """Return the scenario with a position controller that has an integral.

    A position controller without an integral becomes a PID with k_I = 0, which `with_gains` can replace.

    Raises:
        InputError: if the gains of the position controller cannot be designed.
    """
    if scenario.cascade.position.has_integral:
        return scenario
    return with_values(scenario, {"control.position": _integrating(scenario)})


def _integrating(scenario: Scenario) -> PidPosition:
    return PidPosition.from_pd(scenario.cascade.position.without_estimator())


def with_gains(scenario: Scenario, gains: Mapping[str, Mapping[str, Sequence[float]]]) -> Scenario:
    """Return the scenario with new gains in the block `control`.

    The gains are for controllers without a disturbance estimator. Each controller is therefore replaced with its
    `without_estimator` form.

    Args:
        scenario: scenario whose control is a cascade.
        gains: gains by controller and field, as in `CascadeDesign.gains`.

    Raises:
        InputError: if the gains of the position controller cannot be designed.
    """
    blocks = {f"control.{name}": getattr(scenario.cascade, name).without_estimator() for name in gains}
    rows = {f"control.{name}.{kind}": tuple(gains) for name, block in gains.items() for kind, gains in block.items()}
    return with_values(with_values(scenario, blocks), rows)


def with_autopilot_gains(scenario: Scenario, gains: Mapping[str, Sequence[float]]) -> Scenario:
    """Return the scenario with new gains in the block `laboratory.autopilot`; see `CascadeDesign.autopilot_gains`."""
    return with_values(scenario, {f"laboratory.autopilot.{name}": tuple(rows) for name, rows in gains.items()})


def hover_offset(scenario: Scenario) -> float:
    """Return the horizontal distance from the reference at which the vehicle hovers if no loop has an integral, m.

    An offset c of the centre of mass causes the torque m g c. The loops on board balance it with an attitude error of m
    g c / (I k_rate k_attitude). This error causes an acceleration of g per rad, which the position loop balances with
    an offset from the reference.

    Args:
        scenario: scenario without distributions, with an autopilot of kind `attitude` and a position controller with
            k_P.
    """
    vehicle, nominal = scenario.vehicle, scenario.nominal
    autopilot: Any = scenario.laboratory.autopilot
    gains: Any = scenario.cascade.position
    offsets = []
    for index, axis in enumerate(_POSITION_AXES[:2]):
        loop = _ANGLES.index(_TILT_OF_AXIS[axis][0])
        stiffness = nominal.inertia[loop] * autopilot.k_rate[loop] * autopilot.k_attitude[loop]
        tilt = vehicle.mass * vehicle.gravity * vehicle.centre_of_mass[index] / stiffness
        offsets.append(vehicle.gravity * tilt / gains.k_p[index])
    return math.hypot(*offsets)


def default_options(period: float) -> dict[str, LoopOptions]:
    """Return options for the fastest pole pairs with the default margins.

    The phase margin is 45° and the gain margin 6 dB. In attitude loops, the delay margin is two ticks.

    Args:
        period: control period, s.
    """
    pair, outer = PolePair(0.8), Requirements()
    inner = outer._replace(delay=2.0 * period)
    return {axis: LoopOptions(pair, inner if axis in _ANGLES else outer) for axis in (*_LOOP_SIGNALS, *_TILT_OF_AXIS)}


def on_board_options() -> dict[str, LoopOptions]:
    """Return options for the fastest autopilot gains whose margins are 60° and 10 dB.

    These margins are larger than on the ground to limit overshoot, because every packet of the link is a step input to
    the loops on board.
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
    """Design the cascade gains of a scenario for its laboratory and its nominal vehicle.

    If the scenario has an autopilot, only the position loops around its attitude loops are designed.

    Args:
        scenario: scenario with a cascade. Its present gains are ignored in the loops that are designed.
        options: options for each axis; by default `default_options`, and `on_board_options` for an autopilot.
        on_board: True to design the loops of an autopilot of kind `attitude` first.
        integral: largest fraction of the phase margin that the integral of a position loop may use up, between 0 and 1.
            The PD is designed for a larger phase margin, so that the PID still meets the requirements. None for a PD.

    Raises:
        InputError: if the requirements cannot be met, the scenario contains distributions, or it has no on-board loops
            to design.
    """
    period = scenario.laboratory.command_link.period
    all_options = default_options(period) | (on_board_options() if on_board else {}) | dict(options or {})
    inner: dict[str, LoopDesign] = {}
    if on_board:
        inner = _design_on_board(scenario, all_options)
        scenario = with_autopilot_gains(scenario, CascadeDesign({}, inner).autopilot_gains())
    laboratory = laboratory_plant(scenario)
    loops: dict[str, LoopDesign] = {}

    def design_axis(axis: str, plant: SampledSystem) -> None:
        """Design a loop. If another axis has the same plant, as in a symmetric vehicle, reuse its design."""
        loop_options = all_options[axis]
        required = loop_options.requirements
        if integral is not None and axis in _POSITION_AXES:
            loop_options = loop_options._replace(
                requirements=required._replace(phase=required.phase / (1.0 - integral))
            )
        for other in loops.values():
            if all_options[other.axis] == all_options[axis] and _has_equal_response(other.plant, plant):
                loops[axis] = replace(other, axis=axis)
                return
        loops[axis] = _designed(plant, loop_options, axis)

    on_the_ground = not scenario.laboratory.autopilot.controls_attitude
    for axis in _LOOP_SIGNALS if on_the_ground else ("z",):
        design_axis(axis, attitude_plant(laboratory, scenario, axis))
    for axis, (tilt, _) in _TILT_OF_AXIS.items():
        attitude = loops[tilt].gains if on_the_ground else None
        assert attitude is None or isinstance(attitude, AxisPdGains)
        design_axis(axis, position_plant(laboratory, scenario, axis, attitude))
    if integral is not None:
        integration = _integrating(scenario).integration
        for axis in _POSITION_AXES:
            required = all_options[axis].requirements
            loops[axis] = add_integral(loops[axis], required, cost=integral, integration=integration)
    return CascadeDesign(loops, inner)


def _design_on_board(scenario: Scenario, options: Mapping[str, LoopOptions]) -> dict[str, LoopDesign]:
    """Design the body rate loops and then the attitude loops of an autopilot, each as fast as its margins allow.

    Args:
        scenario: scenario with an autopilot of kind `attitude`, whose gains are ignored.
        options: options for each loop.

    Raises:
        InputError: if the requirements cannot be met, or the autopilot is of another kind.
    """
    if not scenario.laboratory.autopilot.loop_gains:
        kind = scenario.laboratory.autopilot.kind
        raise InputError(
            f"cannot design loops on board: laboratory.autopilot is of kind {kind}, which has no gains; use kind"
            " attitude"
        )
    plant, inertia = on_board_plant(scenario), scenario.nominal.inertia
    loops = {}
    for angle, moment in zip(_ANGLES, inertia, strict=True):
        angle_plant = on_board_angle_plant(plant, angle, moment)
        name = _rate_of(angle)
        inner = angle_plant.between(angle_plant.inputs, angle_plant.outputs[1:]).connected()
        loops[name] = _designed(inner, options[name], name)
        outer = on_board_attitude_plant(angle_plant, _proportional(loops[name]))
        loops[angle] = _designed(outer, options[angle], angle)
    return loops


def on_board_angle_plant(plant: SampledSystem, angle: str, inertia: float) -> SampledSystem:
    """Return the plant from an autopilot's commanded angular acceleration to an angle and its rate.

    Args:
        plant: plant from `on_board_plant`.
        angle: roll, pitch or yaw.
        inertia: nominal moment of inertia about the axis of this angle, kg m².
    """
    torque, value, rate = _LOOP_SIGNALS[angle]
    angle_plant = plant.between([f"wrench.{torque}"], [f"state.{value}", f"state.{rate}"])
    return angle_plant.connected().scaled(inertia, "acceleration_command")


def on_board_attitude_plant(angle_plant: SampledSystem, k_rate: float) -> SampledSystem:
    """Return the plant from a commanded body rate to the angle, with a closed rate loop.

    Args:
        angle_plant: plant from an angular acceleration to an angle and its rate, over a period of the autopilot.
        k_rate: gain of the rate loop, 1/s.
    """
    closed = angle_plant.with_feedback(np.array([[0.0, k_rate]])).scaled(k_rate, "rate_command")
    return closed.between(closed.inputs, closed.outputs[:1])


def _designed(plant: SampledSystem, loop_options: LoopOptions, axis: str) -> LoopDesign:
    return design_loop(plant, loop_options.family, loop_options.requirements, axis=axis, effort=loop_options.effort)


def _has_equal_response(a: SampledSystem, b: SampledSystem) -> bool:
    """Return True if two plants have the same impulse response; the names of their states do not matter."""
    return len(a.A) == len(b.A) and np.allclose(_impulse_response(a), _impulse_response(b), rtol=1e-9, atol=1e-12)


def _impulse_response(plant: SampledSystem) -> np.ndarray:
    """Return the impulse response of a plant, long enough to distinguish it from any plant with as many states."""
    state, response = plant.B, []
    for _ in range(2 * len(plant.A)):
        response.append(plant.C @ state)
        state = plant.A @ state
    return np.array(response)


def attitude_plant(laboratory: LaboratoryPlant, scenario: Scenario, axis: str) -> SampledSystem:
    """Return the plant from a commanded angular acceleration to the measured angle and rate of an axis.

    The plant of the axis z leads from a commanded acceleration to the measured height and its rate.

    Args:
        laboratory: plant from `laboratory_plant`.
        scenario: scenario with the nominal mass and inertia, which convert accelerations to thrust and torques.
        axis: roll, pitch, yaw or z; only z if the attitude is controlled on board.
    """
    return _plant(laboratory, scenario, axis, _LOOP_SIGNALS[axis][1:])


def position_plant(
    laboratory: LaboratoryPlant, scenario: Scenario, axis: str, attitude: AxisPdGains | None
) -> SampledSystem:
    """Return the plant from a commanded acceleration on x or y to position and velocity, with a closed attitude loop.

    Args:
        laboratory: plant from `laboratory_plant`.
        scenario: scenario that determines the nominal vehicle.
        axis: x or y.
        attitude: gains of the attitude loop that tilts the vehicle along this axis; None if an autopilot controls the
            attitude.
    """
    tilt, sign = _TILT_OF_AXIS[axis]
    if attitude is None:
        plant = laboratory.system.between([f"attitude_target.{tilt}"], [f"measurement.{axis}", f"measurement.v_{axis}"])
        return plant.connected().scaled(sign / laboratory.specific_thrust, "acceleration_command")
    open_loop = _plant(laboratory, scenario, tilt, (*_LOOP_SIGNALS[tilt][1:], axis, f"v_{axis}"))
    k_p, k_d = attitude
    closed = open_loop.with_feedback(np.array([[k_p, k_d, 0.0, 0.0]]))
    command = closed.scaled(sign * k_p / laboratory.specific_thrust, "acceleration_command")
    return command.between(command.inputs, command.outputs[2:])


def _plant(laboratory: LaboratoryPlant, scenario: Scenario, axis: str, measured: tuple[str, ...]) -> SampledSystem:
    torque = _LOOP_SIGNALS[axis][0]
    nominal = scenario.nominal
    inertia = dict(zip(("tau_x", "tau_y", "tau_z"), nominal.inertia, strict=True)) | {"thrust": nominal.mass}
    command = scenario.laboratory.autopilot.command
    plant = laboratory.system.between([f"{command}.{torque}"], [f"measurement.{name}" for name in measured])
    return plant.connected().scaled(inertia[torque], "acceleration_command")
