"""The gains of a scenario's whole cascade."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from drake_quad.analysis.closed_loop import LaboratoryPlant, laboratory_plant
from drake_quad.analysis.gain_design import AxisGains, Family, LoopDesign, PolePair, Requirements, design_loop
from drake_quad.analysis.sampled_system import SampledSystem
from drake_quad.scenario import Scenario

# Which torque turns which angle at which rate; thrust lifts like a torque turns.
_SIGNALS = {
    "roll": ("tau_x", "roll", "p"),
    "pitch": ("tau_y", "pitch", "q"),
    "yaw": ("tau_z", "yaw", "r"),
    "z": ("thrust", "z", "v_z"),
}
# Which tilt moves the vehicle along which axis, and in which direction, eq (7).
_TILTS = {"x": ("pitch", 1.0), "y": ("roll", -1.0)}


class LoopOptions(NamedTuple):
    """How a loop is to be designed.

    Attributes:
        family: of gains.
        requirements: that it must meet.
        effort: that is asked for; None for the largest that meets them.
    """

    family: Family
    requirements: Requirements
    effort: float | None = None


@dataclass(frozen=True)
class CascadeDesign:
    """The loops of a cascade, by axis: roll, pitch, yaw, x, y, z."""

    loops: Mapping[str, LoopDesign]

    def gains(self) -> dict[str, dict[str, list[float]]]:
        """The gains as the block `control` of a scenario has them."""
        blocks = {"position": ("x", "y", "z"), "attitude": ("roll", "pitch", "yaw")}
        return {
            block: {name: [getattr(self.loops[axis].gains, name) for axis in axes] for name in ("k_p", "k_d")}
            for block, axes in blocks.items()
        }


def with_gains(scenario: Scenario, gains: Mapping[str, Mapping[str, Sequence[float]]]) -> Scenario:
    """The scenario with other gains, as `CascadeDesign.gains` has them."""
    blocks = {
        name: getattr(scenario.control, name).model_copy(update={kind: tuple(rows) for kind, rows in block.items()})
        for name, block in gains.items()
    }
    return scenario.model_copy(update={"control": scenario.control.model_copy(update=blocks)})


def default_options(period: float) -> dict[str, LoopOptions]:
    """The fastest pole pairs within 45°, 6 dB and, for the attitude, two ticks of delay.

    Args:
        period: of the ticks, s.
    """
    pair, outer = PolePair(0.8), Requirements()
    inner = outer._replace(delay=2.0 * period)
    return {
        axis: LoopOptions(pair, inner if axis in ("roll", "pitch", "yaw") else outer) for axis in (*_SIGNALS, *_TILTS)
    }


def design_cascade(scenario: Scenario, options: Mapping[str, LoopOptions] | None = None) -> CascadeDesign:
    """Designs the gains of a scenario's cascade for its laboratory and the vehicle that it believes in.

    Args:
        scenario: whose own gains do not matter.
        options: for each axis; `default_options` where not given.

    Raises:
        InputError: requirements cannot be met, or the scenario holds distributions.
    """
    period = scenario.laboratory.command_link.period
    wanted = default_options(period) | dict(options or {})
    laboratory = laboratory_plant(scenario)
    loops: dict[str, LoopDesign] = {}

    def add(axis: str, plant: SampledSystem) -> None:
        """Designs a loop, unless there is already one like it: an even vehicle's axes are alike."""
        how = wanted[axis]
        for other in loops.values():
            if wanted[other.axis] == how and _alike(other.plant, plant):
                loops[axis] = replace(other, axis=axis)
                return
        loops[axis] = design_loop(plant, how.family, how.requirements, axis=axis, effort=how.effort)

    for axis in _SIGNALS:
        add(axis, attitude_plant(laboratory, scenario, axis))
    for axis, (tilt, _) in _TILTS.items():
        add(axis, position_plant(laboratory, scenario, axis, loops[tilt].gains))
    return CascadeDesign(loops)


def _alike(a: SampledSystem, b: SampledSystem) -> bool:
    """True if two plants answer alike from tick to tick, whatever their states are called."""
    return len(a.A) == len(b.A) and np.allclose(_markov(a), _markov(b), rtol=1e-9, atol=1e-12)


def _markov(plant: SampledSystem) -> np.ndarray:
    """The answer to an impulse, long enough to tell plants with these many states apart."""
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
        axis: roll, pitch, yaw or z.
    """
    return _plant(laboratory, scenario, axis, _SIGNALS[axis][1:])


def position_plant(laboratory: LaboratoryPlant, scenario: Scenario, axis: str, attitude: AxisGains) -> SampledSystem:
    """From a commanded acceleration on x or y to the measured position and velocity, the attitude loop closed.

    Args:
        laboratory: of `laboratory_plant`.
        scenario: with the nominal vehicle.
        axis: x or y.
        attitude: gains of the tilt that moves along this axis.
    """
    tilt, sign = _TILTS[axis]
    whole = _plant(laboratory, scenario, tilt, (*_SIGNALS[tilt][1:], axis, f"v_{axis}"))
    k_p, k_d = attitude
    closed = whole.with_feedback(np.array([[k_p, k_d, 0.0, 0.0]]))
    command = closed.scaled(sign * k_p / laboratory.specific_thrust, "acceleration_command")
    return command.between(command.inputs, command.outputs[2:])


def attitude_plant_in_flight(
    laboratory: LaboratoryPlant, scenario: Scenario, axis: str, position: AxisGains
) -> SampledSystem:
    """From a commanded angular acceleration to the error and the rate of a tilt, the position loop closed.

    Args:
        laboratory: of `laboratory_plant`.
        scenario: with the nominal vehicle.
        axis: x or y, along which the tilt moves the vehicle.
        position: gains on this axis, from which the commanded tilt comes.
    """
    tilt, sign = _TILTS[axis]
    angle, rate = _SIGNALS[tilt][1:]
    whole = _plant(laboratory, scenario, tilt, (angle, rate, axis, f"v_{axis}"))
    k_p, k_d = (sign * gain / laboratory.specific_thrust for gain in position)
    mix = np.array([[1.0, 0.0, k_p, k_d], [0.0, 1.0, 0.0, 0.0]])
    return replace(whole, C=mix @ whole.C, D=mix @ whole.D, outputs=(f"{tilt}_error", rate))


def _plant(laboratory: LaboratoryPlant, scenario: Scenario, axis: str, measured: tuple[str, ...]) -> SampledSystem:
    torque = _SIGNALS[axis][0]
    nominal = scenario.nominal
    inertia = dict(zip(("tau_x", "tau_y", "tau_z"), nominal.inertia, strict=True)) | {"thrust": nominal.mass}
    plant = laboratory.system.between([f"wrench.{torque}"], [f"measurement.{name}" for name in measured])
    return plant.connected().scaled(inertia[torque], "acceleration_command")
