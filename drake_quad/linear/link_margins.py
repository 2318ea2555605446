"""Margins of any control, broken where it goes over the link.

Whatever makes the command of a vehicle, a cascade, an optimal controller or a user's own, what goes over the link is
thrust and roll, pitch and yaw: torques, or the angles that an autopilot is told. With something added to one of these,

    what goes over the link = S (what is added),    S = 1 / (1 + L)

is exact from the linear model of the whole loop, all other signals as they are in flight, and L = 1/S - 1 is the
transfer function of the loop broken there.
"""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from drake_quad.errors import InputError
from drake_quad.linear.closed_loop import loop_with_injection
from drake_quad.linear.margins import Margins, fast_margins, frequencies, margins
from drake_quad.linear.sampled_system import SampledSystem
from drake_quad.scenario.models import Scenario
from drake_quad.signals import AttitudeTarget, Wrench

_MIN_ECHO = 1e-9  # a signal whose closed loop differs from 1 by less is not fed back
# On this grid `fast_link_margins` is accurate to 2e-5 in the peaks of the shipped loops, and to 2e-4 in delay margins.
_NUM_FREQUENCIES = 240
_MIN_FREQUENCY = 0.3  # rad/s
_NUM_NEAR_PEAK = 17  # frequencies between the neighbours of the largest point


class FastLinkMargins(NamedTuple):
    """Peak of |1 / (1 + L)| and delay margin (s) of what goes over the link, (signals with a loop around them,)."""

    sensitivity: np.ndarray
    delay: np.ndarray


def link_margins(
    scenario: Scenario, *, position_controller: Any = None, control: Any = None
) -> dict[str, Margins | None]:
    """Return the margins of thrust, roll, pitch and yaw as they go over the link, by the names of the signals.

    These are `thrust`, `tau_x`, `tau_y` and `tau_z` of a `wrench` or `thrust`, `roll`, `pitch` and `yaw` of an
    `attitude_target`. A signal without feedback has None, for example a yaw that only an autopilot controls.

    Args:
        scenario: scenario, of which `at_rest` is linearised, so that gusts and noise do not matter.
        position_controller: system that replaces the scenario's position controller; see `build_tracking_diagram`.
        control: system that replaces the whole control; see `build_tracking_diagram`.

    Raises:
        InputError: if the loop is unstable, or has no equilibrium or no linear model.
    """
    loops = link_loops(scenario, position_controller=position_controller, control=control)
    return {name: None if loop is None else margins(loop) for name, loop in loops.items()}


def link_loops(
    scenario: Scenario, *, position_controller: Any = None, control: Any = None
) -> dict[str, SampledSystem | None]:
    """Return the loop transfer functions L of `link_margins`; arguments and errors are as there."""
    whole = _stable_loop(scenario, position_controller, control)
    return {name: _opened(whole, row) for row, name in enumerate(_signals(scenario))}


def fast_link_margins(scenario: Scenario) -> FastLinkMargins:
    """Return the margins that a search needs, ten times as fast as `link_margins`; errors are the same."""
    whole = _stable_loop(scenario, None, None)
    rows = range(len(_signals(scenario)))
    loops = whole.between([f"injection.{row}" for row in rows], [f"injected.{row}" for row in rows]).connected()
    grid = frequencies(loops.period, points=_NUM_FREQUENCIES, lowest=_MIN_FREQUENCY)
    S = _diagonal(loops, grid)
    looped = np.flatnonzero(np.abs(S - 1.0).max(axis=1) > _MIN_ECHO)
    return FastLinkMargins(_peaks(loops, looped, grid, S[looped]), fast_margins(1.0 / S[looped] - 1.0, grid).delay)


def _peaks(loops: SampledSystem, rows: np.ndarray, grid: np.ndarray, S: np.ndarray) -> np.ndarray:
    """Return the largest |S| (rows,) of some signals, refined around the largest value on a grid.

    Args:
        loops: closed loop from an addition to each signal to the signals.
        rows: (rows,) indices of the signals.
        grid: (frequencies,) frequencies of the grid, rad/s.
        S: (rows, frequencies) sensitivity of these signals on the grid.
    """
    top = np.argmax(np.abs(S), axis=1)
    ends = grid[np.maximum(top - 1, 0)], grid[np.minimum(top + 1, len(grid) - 1)]
    places = np.linspace(*ends, _NUM_NEAR_PEAK, axis=1)
    # All signals are evaluated at the frequencies of all signals; only those of the signal itself are used.
    closer = _diagonal(loops, places.ravel())[rows].reshape(len(rows), *places.shape)
    return np.maximum(np.abs(S).max(axis=1), np.abs(np.einsum("iij->ij", closer)).max(axis=1))


def _diagonal(loops: SampledSystem, grid: np.ndarray) -> np.ndarray:
    """Return the response (signals, frequencies) of each signal to an addition to itself, at frequencies in rad/s."""
    return np.diagonal(loops.response(np.exp(1j * grid * loops.period)), axis1=1, axis2=2).T


def _stable_loop(scenario: Scenario, position_controller: Any, control: Any) -> SampledSystem:
    """Return the loop of `loop_with_injection`; an InputError if it is unstable."""
    whole = loop_with_injection(scenario, position_controller=position_controller, control=control).system
    size = float(np.abs(whole.poles()).max())
    if not size < 1.0:
        raise InputError(f"the loop of {scenario.name} is unstable in hover: a pole of size {size:.4f} has no margins")
    return whole


def _signals(scenario: Scenario) -> list[str]:
    """Return the names of what goes over the link, but for body rates, which only follow."""
    signal = Wrench if scenario.laboratory.autopilot.command == "wrench" else AttitudeTarget
    return [name for name in signal._fields if name not in ("p", "q", "r")]


def _opened(whole: SampledSystem, row: int) -> SampledSystem | None:
    """Return L = -C (zI - A + B C)⁻¹ B of a row, given S = 1 + C (zI - A)⁻¹ B; None if the row is not fed back."""
    answer = whole.between([f"injection.{row}"], [f"injected.{row}"]).connected()
    if not len(answer.A) or np.abs(answer.response(np.exp(1j * np.geomspace(0.01, 3.0, 50))) - 1.0).max() < _MIN_ECHO:
        return None
    opened = replace(answer, A=answer.A - answer.B @ answer.C, C=-answer.C, D=np.zeros((1, 1)))
    return replace(opened, inputs=("u",), outputs=("loop",))
