"""Stability margins of any controller, with its loops broken at the command link.

Every controller (a cascade, an optimal controller or a user's controller) sends the thrust over the radio link, and
either three torques or the angles that an autopilot follows. If an offset is added to one of these signals,

    signal on the link = S (offset),    S = 1 / (1 + L)

follows exactly from the linear model of the closed loop, in which all other signals are fed back. L = 1/S - 1 is the
transfer function of the loop broken at this signal. If a sensor or the controller is slower than the link, the loop is
periodic, and has margins but no transfer function (see `drake_quad.linear.periodic_margins`).
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from drake_quad.errors import InputError
from drake_quad.linear.closed_loop import loop_with_injection
from drake_quad.linear.margins import Margins, fast_margins, frequencies, margins
from drake_quad.linear.periodic_margins import periodic_margins
from drake_quad.linear.sampled_system import SampledSystem
from drake_quad.linear.structured_singular_value import Block, mu_bound
from drake_quad.scenario.models import Scenario
from drake_quad.signals import AttitudeTarget, Wrench

_MIN_FEEDBACK = 1e-9  # a signal has no feedback if |S - 1| is smaller than this value at all frequencies
# Number of grid frequencies in `fast_link_margins`. For the shipped loops, peaks are accurate to 2e-5 and delay margins
# to 2e-4.
_NUM_FREQUENCIES = 240
_MIN_FREQUENCY = 0.3  # rad/s, smallest frequency of the grid
_NUM_DISK_FREQUENCIES = 400  # number of grid frequencies in `joint_disk_margin`
_NUM_NEAR_PEAK = 17  # number of frequencies that refine the two grid steps around a peak


class FastLinkMargins(NamedTuple):
    """Margins of the loops at the command link, from a fast computation.

    A signal without feedback has no entry in the arrays.

    Attributes:
        sensitivity: (signals,) peaks of |1 / (1 + L)|.
        delay: (signals,) delay margins, s.
    """

    sensitivity: np.ndarray
    delay: np.ndarray


def link_margins(
    scenario: Scenario, *, position_controller: Any = None, control: Any = None
) -> dict[str, Margins | None]:
    """Return the margins of the thrust, roll, pitch and yaw loops at the command link, by signal name.

    The names are `thrust`, `tau_x`, `tau_y` and `tau_z` of a `wrench`, or `thrust`, `roll`, `pitch` and `yaw` of an
    `attitude_target`. The value is None for a signal without feedback, such as a yaw that only an autopilot controls.

    Args:
        scenario: scenario, which is linearised in hover without gusts and noise (see `at_rest`).
        position_controller: system that replaces the scenario's position controller; see `build_tracking_diagram`.
        control: system that replaces the whole control; see `build_tracking_diagram`.

    Raises:
        InputError: if the loop is unstable, or has no equilibrium or no linear model.
    """
    closed = _stable_loop(scenario, position_controller, control)
    if _num_ticks(closed) > 1:
        return {name: periodic_margins(_offset_loop(closed, [row])) for row, name in enumerate(_signals(scenario))}
    loops = {name: _open_loop(closed, row) for row, name in enumerate(_signals(scenario))}
    return {name: None if loop is None else margins(loop) for name, loop in loops.items()}


def link_loops(
    scenario: Scenario, *, position_controller: Any = None, control: Any = None
) -> dict[str, SampledSystem | None]:
    """Return the loop transfer functions L of `link_margins`, with the same arguments and errors.

    Raises:
        InputError: also if a period is longer than the control period, since such a loop has no transfer function.
    """
    closed = _stable_loop(scenario, position_controller, control)
    if _num_ticks(closed) > 1:
        raise InputError(
            f"the loop of {scenario.name} has no transfer function, since some of its periods are longer than"
            f" {scenario.laboratory.command_link.period:g} s, the period of the command link"
        )
    return {name: _open_loop(closed, row) for row, name in enumerate(_signals(scenario))}


def fast_link_margins(scenario: Scenario) -> FastLinkMargins:
    """Return sensitivity peaks and delay margins for a search; the errors are as in `link_margins`.

    The computation is ten times as fast as `link_margins`, except for a loop in which a period is longer than the
    control period.
    """
    closed, rows = _stable_loop(scenario, None, None), range(len(_signals(scenario)))
    if _num_ticks(closed) > 1:
        each = [periodic_margins(_offset_loop(closed, [row]), points=_NUM_FREQUENCIES) for row in rows]
        found = [margins for margins in each if margins is not None]
        return FastLinkMargins(np.array([m.sensitivity for m in found]), np.array([m.delay for m in found]))
    loops = _offset_loop(closed, rows)
    grid = frequencies(loops.period, points=_NUM_FREQUENCIES, lowest=_MIN_FREQUENCY)
    S = _diagonal(loops, grid)
    fed_back = np.flatnonzero(np.abs(S - 1.0).max(axis=1) > _MIN_FEEDBACK)
    return FastLinkMargins(
        _peaks(loops, fed_back, grid, S[fed_back]), fast_margins(1.0 / S[fed_back] - 1.0, grid).delay
    )


class JointDiskMargin(NamedTuple):
    """Disk margin for simultaneous changes of all signals on the command link.

    All signals may change at the same time, each by its own factor in the disk of the margin α, see `Margins.disk`.

    Attributes:
        disk: disk margin α, a lower bound by the structured singular value.
        gain: change of all gains that is tolerated in both directions, dB.
        phase: change of all phases that is tolerated in both directions, degrees.
    """

    disk: float
    gain: float
    phase: float


def joint_disk_margin(scenario: Scenario, *, position_controller: Any = None, control: Any = None) -> JointDiskMargin:
    """Return the disk margin for simultaneous changes of all of a scenario's loops at the command link.

    The margin of a single loop is never smaller. The difference shows how much the loops act on each other (P. Seiler,
    A. Packard and P. Gahinet, "An introduction to disk margins", 2020). The arguments and errors are those of
    `link_margins`.
    """
    closed = _stable_loop(scenario, position_controller, control)
    num_signals = len(_signals(scenario))
    return _joint_disk_margin(_offset_loop(closed, range(num_signals)), num_signals)


def _joint_disk_margin(loops: SampledSystem, num_signals: int) -> JointDiskMargin:
    """Return the disk margin for simultaneous changes of all signals.

    Args:
        loops: result of `_offset_loop` for all signals.
        num_signals: number of signals.
    """
    num_ticks = len(loops.inputs) // num_signals
    blocks = [Block(num_ticks, is_real=False)] * num_signals
    grid = frequencies(loops.period, points=_NUM_DISK_FREQUENCIES, lowest=_MIN_FREQUENCY)
    peak = 0.0
    for _ in range(2):
        S = loops.response(np.exp(1j * grid * loops.period))
        matrices = S - 0.5 * np.eye(len(loops.inputs))
        coarse_bounds = _scaled_norms(matrices, num_ticks)
        top = 0
        for i in np.argsort(-coarse_bounds):
            if coarse_bounds[i] <= peak:
                break
            bound = mu_bound(matrices[i], blocks, stop=peak).value
            if bound > peak:
                peak, top = bound, int(i)
        grid = np.linspace(grid[max(top - 1, 0)], grid[min(top + 1, len(grid) - 1)], _NUM_NEAR_PEAK)
    disk = 1.0 / peak
    gain = 20.0 * math.log10((2.0 + disk) / (2.0 - disk)) if disk < 2.0 else math.inf
    return JointDiskMargin(disk, gain, math.degrees(2.0 * math.atan(0.5 * disk)))


def _scaled_norms(matrices: np.ndarray, size: int) -> np.ndarray:
    """Return upper bounds (points,) of the structured singular values of matrices with blocks of equal size.

    The bound is the norm after a scaling of the blocks by the Perron vectors of the matrix of their norms (M. G.
    Safonov, "Stability margins of diagonally perturbed multivariable feedback systems", IEE Proceedings D 129(6),
    1982).
    """
    points, n, _ = matrices.shape
    blocks = matrices.reshape(points, n // size, size, n // size, size).swapaxes(2, 3)
    norms = np.linalg.norm(blocks, 2, axis=(3, 4)) + 1e-12  # positive, so that the Perron vectors are positive
    right, left = (_perron_vector(each) for each in (norms, norms.swapaxes(1, 2)))
    scale = np.repeat(np.sqrt(left / right), size, axis=1)
    return np.linalg.norm(matrices * scale[:, :, np.newaxis] / scale[:, np.newaxis, :], 2, axis=(1, 2))


def _perron_vector(matrices: np.ndarray) -> np.ndarray:
    """Return the positive eigenvectors (points, r) of positive matrices (points, r, r)."""
    values, vectors = np.linalg.eig(matrices)
    largest = np.argmax(values.real, axis=1)
    return np.abs(np.take_along_axis(vectors, largest[:, np.newaxis, np.newaxis], axis=2)[:, :, 0])


def _peaks(loops: SampledSystem, signals: np.ndarray, grid: np.ndarray, S: np.ndarray) -> np.ndarray:
    """Return the largest |S| of some signals, (signals,), refined around the largest value on a grid.

    Args:
        loops: closed loop whose inputs are offsets on the signals, and whose outputs are the signals.
        signals: indices of the signals.
        grid: (frequencies,) frequencies of the grid, rad/s.
        S: (signals, frequencies) sensitivity of these signals on the grid.
    """
    top = np.argmax(np.abs(S), axis=1)
    ends = grid[np.maximum(top - 1, 0)], grid[np.minimum(top + 1, len(grid) - 1)]
    points = np.linspace(*ends, _NUM_NEAR_PEAK, axis=1)
    # All responses are computed around the peaks of all signals. Each signal uses only the values around its own peak.
    refined = _diagonal(loops, points.ravel())[signals].reshape(len(signals), *points.shape)
    return np.maximum(np.abs(S).max(axis=1), np.abs(np.einsum("iij->ij", refined)).max(axis=1))


def _diagonal(loops: SampledSystem, grid: np.ndarray) -> np.ndarray:
    """Return the response (signals, frequencies) of each signal to its own offset, at frequencies in rad/s."""
    return np.diagonal(loops.response(np.exp(1j * grid * loops.period)), axis1=1, axis2=2).T


def _stable_loop(scenario: Scenario, position_controller: Any, control: Any) -> SampledSystem:
    """Return the loop of `loop_with_injection`, and raise InputError if it is unstable."""
    closed = loop_with_injection(scenario, position_controller=position_controller, control=control).system
    size = float(np.abs(closed.without_hidden_modes().poles()).max())
    if not size < 1.0:
        raise InputError(
            f"the loop of {scenario.name} is unstable in hover (its largest pole has magnitude {size:.4f}), so it has"
            " no margins; reduce the gains or the delays"
        )
    return closed


def _signals(scenario: Scenario) -> list[str]:
    """Return the names of the command link's signals without the body rates, which are feedforward only."""
    signal = Wrench if scenario.laboratory.autopilot.command == "wrench" else AttitudeTarget
    return [name for name in signal._fields if name not in ("p", "q", "r")]


def _num_ticks(closed: SampledSystem) -> int:
    """Return the number of ticks in the common period of a loop of `loop_with_injection`; 1 if it is not lifted."""
    return sum(name.partition("@")[0] == "injection.0" for name in closed.inputs)


def _offset_loop(closed: SampledSystem, rows: Sequence[int]) -> SampledSystem:
    """Return the loop from offsets on some signals to these signals, with all ticks of a signal one after another."""

    def of_signals(names: Sequence[str], port: str) -> list[str]:
        return [name for row in rows for name in names if name.partition("@")[0] == f"{port}.{row}"]

    inputs, outputs = of_signals(closed.inputs, "injection"), of_signals(closed.outputs, "injected")
    return closed.between(inputs, outputs).connected().without_hidden_modes()


def _open_loop(closed: SampledSystem, row: int) -> SampledSystem | None:
    """Return L = -C (zI - A + B C)⁻¹ B of a signal, given S = 1 + C (zI - A)⁻¹ B; None if it is not fed back."""
    sensitivity = _offset_loop(closed, [row])
    if (
        not len(sensitivity.A)
        or np.abs(sensitivity.response(np.exp(1j * np.geomspace(0.01, 3.0, 50))) - 1.0).max() < _MIN_FEEDBACK
    ):
        return None
    opened = replace(sensitivity, A=sensitivity.A - sensitivity.B @ sensitivity.C, C=-sensitivity.C, D=np.zeros((1, 1)))
    return replace(opened, inputs=("u",), outputs=("loop",))
