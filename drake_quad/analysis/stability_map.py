"""Maps which PD gains stabilise a loop, and how well they fly."""

from typing import Literal, NamedTuple

import numpy as np

from drake_quad.analysis.cascade_design import attitude_plant_in_flight, position_plant
from drake_quad.analysis.closed_loop import laboratory_plant
from drake_quad.analysis.gain_design import AxisGains
from drake_quad.analysis.margins import fast_margins, frequencies
from drake_quad.analysis.sampled_system import SampledSystem
from drake_quad.errors import InputError
from drake_quad.flight import StudyFleet
from drake_quad.laboratory.metrics import Metrics
from drake_quad.scenario import Batch, Scenario, draw_sample

Loop = Literal["position", "attitude"]

# Modes that die faster than this within a tick are delay lines, whose damping means nothing.
_FAST = 0.05
_POINTS = 300


class StabilityMap(NamedTuple):
    """What a grid of gains does to the linear loop; arrays (k_p, k_d).

    Attributes:
        size: of the largest pole; the loop is stable below 1.
        damping: the least of all poles; NaN where the loop is not stable.
        delay: delay margin, s; NaN where the loop is not stable.
    """

    size: np.ndarray
    damping: np.ndarray
    delay: np.ndarray

    @property
    def stable(self) -> np.ndarray:
        """True where all poles lie inside the unit circle."""
        return self.size < 1.0 - 1e-9  # an integrator that is left alone is found on either side of 1


def stability_map(plant: SampledSystem, k_p: np.ndarray, k_d: np.ndarray) -> StabilityMap:
    """The map of a PD around a plant, from the poles and the frequency response of every loop.

    Args:
        plant: from a commanded acceleration to the measured value and rate.
        k_p: (rows,) 1/s².
        k_d: (columns,) 1/s.
    """
    gains = np.stack(np.meshgrid(k_p, k_d, indexing="ij"), axis=-1)
    closed = plant.A - plant.B @ (gains[..., np.newaxis, :] @ plant.C)
    poles = np.linalg.eigvals(closed)
    lasting = np.where(np.abs(poles) > _FAST, poles, _FAST)
    rates = np.log(lasting.astype(complex))
    damping = np.where(np.abs(poles) > _FAST, -rates.real / np.maximum(np.abs(rates), 1e-12), 1.0).min(axis=-1)
    grid = frequencies(plant.period, points=_POINTS)
    response = plant.response(np.exp(1j * grid * plant.period))[..., 0]
    delay = fast_margins(gains @ response.T, grid).delay
    whole = StabilityMap(np.abs(poles).max(axis=-1), damping, delay)
    return StabilityMap(whole.size, *(np.where(whole.stable, values, np.nan) for values in whole[1:]))


def mapped_plant(scenario: Scenario, loop: Loop) -> SampledSystem:
    """What the gains of one of a scenario's loops act on along x, with the vehicle "as it is" of `laboratory_plant`.

    For the position that is the plant around its own attitude loop, or around that on board. For the attitude it is the
    plant with its own position loop closed: u = -k_P (θ - θ_r) - k_D q with θ_r = -(K_P x + K_D v) over the
    specific thrust, eq (7), is a PD in θ - θ_r and q.

    Raises:
        InputError: the attitude loop is asked for and runs on board, or the laboratory has no plant.
    """
    kind = scenario.laboratory.autopilot.kind
    if loop == "attitude" and kind != "none":
        raise InputError(f"with laboratory.autopilot of kind {kind} there is no attitude loop to map on the ground")
    scenario = draw_sample(scenario, scenario.sample) if scenario.sample is not None else scenario
    laboratory = laboratory_plant(scenario, vehicle="as it is")
    if loop == "position":
        return position_plant(laboratory, scenario, "x", _gains(scenario, "attitude", 1) if kind == "none" else None)
    return attitude_plant_in_flight(laboratory, scenario, "x", _gains(scenario, "position", 0))


def _gains(scenario: Scenario, loop: Loop, axis: int) -> AxisGains:
    block = getattr(scenario.cascade, loop)
    return AxisGains(float(block.k_p[axis]), float(block.k_d[axis]))


def flown_map(
    scenario: Scenario, loop: Loop, k_p: np.ndarray, k_d: np.ndarray, *, sample: int = 0, compiled: bool = True
) -> Metrics:
    """Flies a scenario with every pair of gains in one fleet, all in the same wind and noise.

    Args:
        scenario: whose route is flown.
        loop: whose gains differ: on x and y of the position, or on roll and pitch.
        k_p: (rows,) 1/s².
        k_d: (columns,) 1/s.
        sample: of the scenario's study.
        compiled: whether the diagram is compiled to machine code; else it flies as it is wired.

    Returns:
        (rows, columns) arrays of each metric.
    """
    scenario = draw_sample(scenario, sample)
    pairs = [grid.ravel() for grid in np.meshgrid(k_p, k_d, indexing="ij")]
    varying = {
        f"control.{loop}.{name}.{axis}": values
        for name, values in zip(("k_p", "k_d"), pairs, strict=True)
        for axis in (0, 1)
    }
    batch = Batch(scenario, (sample,) * len(pairs[0]), varying)
    metrics = StudyFleet(scenario, len(batch), compiled=compiled).fly_batch(batch)
    return Metrics(*(values.reshape(len(k_p), len(k_d)) for values in metrics))
