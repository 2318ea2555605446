"""Maps of stability and flight performance over two gains."""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np

from drake_quad.design.cascade import on_board_angle_plant
from drake_quad.errors import InputError
from drake_quad.fleets.study_fleet import StudyFleet
from drake_quad.flight.mission import plan_route
from drake_quad.laboratory.metrics import Metrics
from drake_quad.linear.closed_loop import decoupled_loop, on_board_plant
from drake_quad.linear.margins import fast_margins, frequencies
from drake_quad.linear.sampled_system import SampledSystem
from drake_quad.scenario.batch import Batch, draw_sample
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.paths import map_leaves

Loop = Literal["position", "attitude"]
_AUTOPILOT_BLOCK = "laboratory.autopilot"

# Poles of smaller magnitude belong to delay lines, whose damping is meaningless.
_MIN_POLE_MAGNITUDE = 0.05
_NUM_FREQUENCIES = 300  # number of frequencies of the loop response; the delay margin is interpolated
# Change of a gain with which the derivative of the linear model is computed as a difference. The model is affine in the
# gains, so that any change gives the same derivative.
_GAIN_STEP = 1.0
# Relative change, with respect to the largest entry, up to which a matrix entry counts as independent of the gain.
_ROUNDING_TOLERANCE = 1e-9


class MappedGains(NamedTuple):
    """Pair of gains that a map varies.

    Attributes:
        block: path of the scenario block that contains the gains.
        fields: names of the two gains in this block.
        symbols: symbols for display: k_P and k_D, or the names of gains on board.
        units: units of the gains.
    """

    block: str
    fields: tuple[str, str]
    symbols: tuple[str, str]
    units: tuple[str, str]

    @property
    def labels(self) -> tuple[str, str]:
        """Labels of the two mapped gains, with symbol and unit."""
        first, second = (f"{symbol} ({unit})" for symbol, unit in zip(self.symbols, self.units, strict=True))
        return first, second


class StabilityMap(NamedTuple):
    """Stability of the linear loop over a grid of gains, as arrays (k_p, k_d).

    Attributes:
        size: largest magnitude of a closed-loop pole; the loop is stable if it is below 1.
        damping: smallest damping ratio of all poles; NaN where the loop is unstable.
        delay: delay margin, s, interpolated between frequencies with a relative error of about 1e-3; NaN where the loop
            is unstable.
    """

    size: np.ndarray
    damping: np.ndarray
    delay: np.ndarray

    @property
    def stable(self) -> np.ndarray:
        """Mask of the mapped gains: True where all closed-loop poles lie inside the unit circle."""
        return self.size < 1.0 - 1e-9  # rounding moves the pole of an integrator slightly to either side of 1


def mapped_gains(scenario: Scenario, loop: Loop) -> MappedGains:
    """Return the gains that a map varies: the gains of a PD on the ground, or of an autopilot's loops.

    Raises:
        InputError: if the loop is the attitude loop, and the autopilot has no gains.
    """
    autopilot = scenario.laboratory.autopilot
    if loop == "position" or not autopilot.controls_attitude:
        return MappedGains(f"control.{loop}", ("k_p", "k_d"), ("k_P", "k_D"), ("1/s²", "1/s"))
    if autopilot.loop_gains:
        return MappedGains(_AUTOPILOT_BLOCK, autopilot.loop_gains, autopilot.loop_gains, ("1/s", "1/s"))
    raise InputError(
        f"cannot map the attitude: laboratory.autopilot is of kind {autopilot.kind}, which has no gains; use kind"
        " attitude"
    )


def linear_map(scenario: Scenario, loop: Loop, first: np.ndarray, second: np.ndarray) -> StabilityMap:
    """Return the stability map of a scenario's loop, from its linear model; see `mapped_plant`.

    Args:
        scenario: scenario with the loop.
        loop: "position" or "attitude".
        first: (rows,) values of the first of the `mapped_gains`.
        second: (columns,) values of the second of the `mapped_gains`.

    Raises:
        InputError: under the conditions of `mapped_gains` and `mapped_plant`.
    """
    plant, (outer, inner) = mapped_plant(scenario, loop), np.meshgrid(first, second, indexing="ij")
    if mapped_gains(scenario, loop).block == _AUTOPILOT_BLOCK:
        outer = inner * outer  # attitude loop around a rate loop: u = k_rate (k_attitude (θ_r - θ) - q)
    return _map_of(plant, np.stack([outer, inner], axis=-1))


def stability_map(plant: SampledSystem, k_p: np.ndarray, k_d: np.ndarray) -> StabilityMap:
    """Return the stability map of a PD for a plant, from the poles and frequency response of every closed loop.

    Args:
        plant: plant from a commanded acceleration to the measured value and rate.
        k_p: (rows,) values of k_P, 1/s².
        k_d: (columns,) values of k_D, 1/s.
    """
    return _map_of(plant, np.stack(np.meshgrid(k_p, k_d, indexing="ij"), axis=-1))


def _map_of(plant: SampledSystem, gains: np.ndarray) -> StabilityMap:
    """Return the stability map for pairs of gains (rows, columns, 2) on the two outputs of a plant, value and rate."""
    closed = plant.A - plant.B @ (gains[..., np.newaxis, :] @ plant.C)
    poles = np.linalg.eigvals(closed)
    clipped_poles = np.where(np.abs(poles) > _MIN_POLE_MAGNITUDE, poles, _MIN_POLE_MAGNITUDE)
    rates = np.log(clipped_poles.astype(complex))
    damping = np.where(np.abs(poles) > _MIN_POLE_MAGNITUDE, -rates.real / np.maximum(np.abs(rates), 1e-12), 1.0).min(
        axis=-1
    )
    grid = frequencies(plant.period, points=_NUM_FREQUENCIES)
    response = plant.response(np.exp(1j * grid * plant.period))[..., 0]
    delay = fast_margins(gains @ response.T, grid).delay
    result = StabilityMap(np.abs(poles).max(axis=-1), damping, delay)
    return StabilityMap(result.size, *(np.where(result.stable, values, np.nan) for values in result[1:]))


def mapped_plant(scenario: Scenario, loop: Loop) -> SampledSystem:
    """Return the plant along x that the gains of one loop act on, with all other loops of the scenario closed.

    The plant of a PD on the ground follows from linear models of the whole closed loop, whose matrix over a tick is A -
    b (k_P c_P + k_D c_D). It therefore contains everything around the PD: the other loop of the cascade, integrals and
    estimators. It does not contain a network, since a learning network has no linear model. The plant of an attitude
    loop on board is the autopilot's plant over one of its periods. It does not contain the position loop, whose period
    is longer.

    Raises:
        InputError: if the scenario has no such plant, or the attitude loop has no gains; see `mapped_gains`.
    """
    mapped = mapped_gains(scenario, loop)
    scenario = draw_sample(scenario, scenario.sample) if scenario.sample is not None else scenario
    if mapped.block == _AUTOPILOT_BLOCK:
        on_board = on_board_plant(scenario, vehicle="actual")
        return on_board_angle_plant(on_board, "pitch", scenario.nominal.inertia[1])
    control = scenario.cascade.model_copy(update={"network": None})
    axis = 0 if loop == "position" else 1
    gains = [float(getattr(getattr(control, loop), name)[axis]) for name in mapped.fields]

    def model(pair: Sequence[float]) -> SampledSystem:
        values = {f"{mapped.block}.{name}.{axis}": value for name, value in zip(mapped.fields, pair, strict=True)}
        with_gains = scenario.model_copy(update={"control": control})
        return decoupled_loop(map_leaves(with_gains, lambda path, value: values.get(path, value)))

    base = model(gains)
    derivatives = [(base.A - model(np.add(gains, step)).A) / _GAIN_STEP for step in _GAIN_STEP * np.eye(2)]
    outer, sizes, rows = np.linalg.svd(np.hstack(derivatives), full_matrices=False)
    b, c = (
        np.where(np.abs(x) > _ROUNDING_TOLERANCE * np.abs(x).max(), x, 0.0) for x in (outer[:, :1], sizes[0] * rows[0])
    )
    c = c.reshape(2, -1)
    outputs = tuple(f"{mapped.block}.{name}" for name in mapped.fields)
    A_without_pd = base.A + b @ np.atleast_2d(gains) @ c
    return SampledSystem(
        A_without_pd, b, c, np.zeros((2, 1)), base.period, base.states, ("command",), outputs
    ).connected()


def simulated_map(
    scenario: Scenario, loop: Loop, first: np.ndarray, second: np.ndarray, *, sample: int = 0, compiled: bool = True
) -> Metrics:
    """Simulate a fleet with one vehicle for every pair of gains, all with the same wind and noise.

    Args:
        scenario: scenario to fly, with the route.
        loop: loop whose gains vary: the position loop on x and y, or the attitude loop on roll and pitch.
        first: (rows,) values of the first of the `mapped_gains`.
        second: (columns,) values of the second of the `mapped_gains`.
        sample: index of the study sample that determines wind and noise.
        compiled: True to simulate with machine code, False for the uncompiled diagram.

    Returns:
        (rows, columns) arrays of each metric.
    """
    scenario = draw_sample(scenario, sample)
    mapped = mapped_gains(scenario, loop)
    pairs = [grid.ravel() for grid in np.meshgrid(first, second, indexing="ij")]
    varying = {
        f"{mapped.block}.{name}.{axis}": values
        for name, values in zip(mapped.fields, pairs, strict=True)
        for axis in (0, 1)
    }
    batch = Batch(scenario, (sample,) * len(pairs[0]), varying)
    metrics = StudyFleet(scenario, plan_route(scenario), len(batch), compiled=compiled).fly_batch(batch)
    return metrics.with_values(values.reshape(len(first), len(second)) for values in metrics)
