"""Design of PD gains on the linear model of the laboratory, including its delays, zero-order holds, lags and filters.

The attitude loops are designed first, each for the plant from a commanded angular acceleration to the measured angle
and rate. The position loops around them are designed next: a commanded acceleration a along x demands the pitch a / g,
and along y the roll -a / g. The height has a separate loop, which is designed in the same way as the loop of an angle.

The gains of a family depend on one parameter, the effort. The design uses a given effort, or the largest effort that
meets the required margins. The families are:

- `PolePair`: the two gains place two poles of the sampled loop exactly at exp(s h), s = ω (-ζ ± i √(1 - ζ²)), for a
  bandwidth ω and a damping ratio ζ. These must be the slowest poles of the loop.
- `OutputRegulator`: the two gains with the smallest quadratic cost, for a disturbance at the input of the plant.
  The design includes the ratio to the cost of a full linear-quadratic regulator, which feeds back every state.
- `Proportional`: the single gain of a loop on board.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

import numpy as np
import scipy
from pydrake.systems.controllers import DiscreteTimeLinearQuadraticRegulator

from drake_quad.control.integral import Integration
from drake_quad.errors import InputError
from drake_quad.linear.margins import FastMargins, Margins, fast_margins, frequencies, margins
from drake_quad.linear.sampled_system import SampledSystem

_MIN_BANDWIDTH = 0.05  # rad/s, smallest bandwidth that a design tries
_MAX_BANDWIDTH_RATIO = 1.0 / 3.0  # largest bandwidth that a design tries, relative to the Nyquist frequency
_NUM_EFFORTS = 120  # number of efforts, such as bandwidths, that a design tries before the bisection
# Number of bisections between the largest effort that meets the requirements and the next effort that was tried.
_NUM_BISECTIONS = 12
# Largest corner frequency k_I / k_P of an integral, relative to the crossover frequency of its PD. Common PID rules use
# a reset time of 4 / crossover.
_MAX_INTEGRAL_RATIO = 0.25
# Bandwidths of the pole pairs with which the search for a regulator may start, rad/s. The first stable one is used.
_START_FREQUENCIES = (0.2, 0.05, 0.0125, 0.003)
# The closed-loop matrix is squared repeatedly until all entries of its power are below `_CONVERGED_ENTRY`. The loop
# counts as unstable if an entry exceeds `_DIVERGED_ENTRY`, or if an entry is still not below `_CONVERGED_ENTRY` for the
# exponent 2²⁹. The magnitude of the slowest pole is then above 1 - 1e-7.
_MAX_DOUBLINGS = 29
_CONVERGED_ENTRY = 1e-12  # a matrix power whose entries are all smaller has converged to zero
_DIVERGED_ENTRY = 1e50  # a matrix power with a larger entry has diverged
_UNSTABLE_LOG_COST = 100.0  # far above the logarithm of the cost of any stable loop


class AxisPdGains(NamedTuple):
    """Gains k_P (1/s²) and k_D (1/s) of an axis."""

    k_p: float
    k_d: float


class PidGains(NamedTuple):
    """Gains k_P (1/s²), k_D (1/s) and k_I (1/s³) of an axis."""

    k_p: float
    k_d: float
    k_i: float


class ProportionalGain(NamedTuple):
    """Gain k (1/s) of a proportional loop on board."""

    k: float


Gains = AxisPdGains | PidGains | ProportionalGain

_NO_GAINS = AxisPdGains(math.nan, math.nan)
SLOWER_POLE = "a slower pole"
"""Name of the limit that a faster pole pair would not be the slowest poles of the loop."""
_GAIN_SYMBOLS = {"k_p": "k_P", "k_d": "k_D", "k": "k"}


class Requirements(NamedTuple):
    """Required margins of a loop.

    Attributes:
        phase: smallest phase margin, degrees.
        gain: smallest gain margin, dB.
        delay: smallest delay margin, s.
    """

    phase: float = 45.0
    gain: float = 6.0
    delay: float = 0.0

    def min_ratio(self, margins: FastMargins) -> float:
        """Return the smallest ratio of a margin to its requirement; it is 1 or more if all requirements are met."""
        pairs = ((getattr(margins, name), required) for name, required in self._asdict().items() if required > 0.0)
        return min((float(actual) / required for actual, required in pairs), default=1.0)

    def shortfalls(self, margins: FastMargins) -> dict[str, str]:
        """Return a description of each margin that is too small, by the name of the requirement."""
        units = {"phase": ("°", 1.0), "gain": (" dB", 1.0), "delay": (" ms", 1e3)}
        return {
            f"{name} margin": f"{factor * float(getattr(margins, name)):.1f}{unit}, less than"
            f" {factor * getattr(self, name):g}{unit}"
            for name, (unit, factor) in units.items()
            if not getattr(margins, name) >= getattr(self, name)
        }


@dataclass(frozen=True)
class LoopDesign:
    """Result of the design of one loop.

    Attributes:
        axis: name of the axis.
        gains: gains of the PD, the PID or the proportional law.
        plant: plant from the commanded acceleration to the measured value and rate. A PID's plant has the integral of
            the value as third output. A proportional law's plant leads from the command to the controlled quantity.
        margins: margins of the loop.
        bandwidth: bandwidth of the pole pair, rad/s; None for other families.
        cost_ratio: cost of the PD relative to the cost of the full-state regulator; None for other families.
        limits: requirements that a faster loop of the family would violate; empty if the effort was given.
    """

    axis: str
    gains: Gains
    plant: SampledSystem
    margins: Margins
    bandwidth: float | None = None
    cost_ratio: float | None = None
    limits: tuple[str, ...] = ()


class GainFamily(Protocol):
    """Family of gains that depend on one parameter, the effort, such as the bandwidth of a pole pair."""

    def gains(self, plant: SampledSystem, effort: float) -> AxisPdGains | ProportionalGain:
        """Return the gains of the family for a plant and an effort."""

    def efforts(self, plant: SampledSystem) -> np.ndarray:
        """Return the efforts that the design tries, in ascending order."""


class PolePair(NamedTuple):
    """Gains that place a pair of poles. The effort is the bandwidth ω of the pair, rad/s.

    Attributes:
        damping: damping ratio ζ, between 0 and 1.
    """

    damping: float

    def gains(self, plant: SampledSystem, effort: float) -> AxisPdGains:
        """Return the gains, which solve the linear equation 1 + k_P G_value(z) + k_D G_rate(z) = 0 at the pole."""
        s = effort * complex(-self.damping, math.sqrt(1.0 - self.damping**2))
        value, rate = plant.response(np.array([np.exp(s * plant.period)]))[0, :, 0]
        determinant = value.real * rate.imag - rate.real * value.imag
        if determinant == 0.0:  # the measured value and the measured rate are not independent
            return _NO_GAINS
        return AxisPdGains(-rate.imag / determinant, value.imag / determinant)

    def efforts(self, plant: SampledSystem) -> np.ndarray:
        """Return the bandwidths that the design tries, rad/s."""
        return np.geomspace(_MIN_BANDWIDTH, _MAX_BANDWIDTH_RATIO * math.pi / plant.period, _NUM_EFFORTS)


class Proportional(NamedTuple):
    """Family of proportional controllers. The effort is the gain itself, 1/s."""

    def gains(self, plant: SampledSystem, effort: float) -> ProportionalGain:
        """Return the proportional gain, which is equal to the effort."""
        return ProportionalGain(effort)

    def efforts(self, plant: SampledSystem) -> np.ndarray:
        """Return the gains that the design tries, 1/s.

        Their range is the range of bandwidths in `PolePair`, because the crossover frequency is equal to the gain if
        the plant is an integrator.
        """
        return np.geomspace(_MIN_BANDWIDTH, _MAX_BANDWIDTH_RATIO * math.pi / plant.period, _NUM_EFFORTS)


class OutputRegulator(NamedTuple):
    """Gains that minimise Σ value² + (rate_time · rate)² + (u / effort)² after an impulse at the input of the plant.

    Attributes:
        rate_time: weight of the rate relative to the value, s.
    """

    rate_time: float

    def gains(self, plant: SampledSystem, effort: float) -> AxisPdGains:
        """Return the gains with the smallest cost. The search starts from gains for a slow double integrator."""
        slow = [AxisPdGains(frequency**2, 1.6 * frequency) for frequency in _START_FREQUENCIES]
        start = next((gains for gains in slow if math.isfinite(self.cost(plant, gains, effort))), None)
        if start is None:
            return _NO_GAINS

        def logarithm_of_cost(logs: np.ndarray) -> tuple[float, np.ndarray]:
            gains = np.exp(logs)
            cost, slope = self._cost_and_slope(plant, AxisPdGains(*gains), effort)
            if not math.isfinite(cost):  # the line search returns to stable gains
                return _UNSTABLE_LOG_COST, np.zeros(len(logs))
            return math.log(cost), gains * slope / cost

        best = scipy.optimize.minimize(logarithm_of_cost, np.log(start), method="BFGS", jac=True)
        return AxisPdGains(*(float(gain) for gain in np.exp(best.x)))

    def cost(self, plant: SampledSystem, gains: AxisPdGains, effort: float) -> float:
        """Return the cost of a PD; it is infinite if the loop is unstable."""
        cost, _ = self._cost_and_slope(plant, gains, effort)
        return cost

    def _cost_and_slope(self, plant: SampledSystem, gains: AxisPdGains, effort: float) -> tuple[float, np.ndarray]:
        """Return the cost of a PD, and its derivatives with respect to k_P and k_D.

        The cost is that of the class, Σ value² + (rate_time · rate)² + (u / effort)² after an impulse at the input.
        With W = Cᵀ diag(1, rate_time²) C, the gains K and the closed loop F = A - B K C,

            cost = Bᵀ P B                                    P = Σ Fᵏᵀ (W + Cᵀ Kᵀ K C / effort²) Fᵏ
            d cost / dK = 2 (K C / effort² - Bᵀ P F) Q Cᵀ    Q = Σ Fᵏ B Bᵀ Fᵏᵀ

        (W. S. Levine and M. Athans, "On the determination of the optimal constant output feedback gains for linear
        multivariable systems", IEEE Transactions on Automatic Control, 1970). Each iteration doubles the number of
        terms of the two sums (R. A. Smith, "Matrix equation XA + BX = C", SIAM Journal on Applied Mathematics, 1968).
        """
        feedback = np.array([gains]) @ plant.C
        power = closed = plant.A - plant.B @ feedback
        costs = self._state_weight(plant) + feedback.T @ feedback / effort**2
        states = plant.B @ plant.B.T
        for _ in range(_MAX_DOUBLINGS):
            costs = costs + power.T @ costs @ power
            states = states + power @ states @ power.T
            power = power @ power
            size = np.abs(power).max()
            if size < _CONVERGED_ENTRY:
                adjoint = plant.B.T @ costs
                slope = 2.0 * (feedback / effort**2 - adjoint @ closed) @ states @ plant.C.T
                return (adjoint @ plant.B).item(), slope[0]
            if not size < _DIVERGED_ENTRY:
                break
        return math.inf, np.full(len(gains), math.nan)

    def min_cost(self, plant: SampledSystem, effort: float) -> float:
        """Return the cost of the full linear-quadratic regulator, which feeds back every state."""
        _, S = DiscreteTimeLinearQuadraticRegulator(plant.A, plant.B, self._state_weight(plant), np.eye(1) / effort**2)
        return (plant.B.T @ S @ plant.B).item()

    def efforts(self, plant: SampledSystem) -> np.ndarray:
        """Return the efforts that the design tries."""
        return np.geomspace(1e-2, 1e3, _NUM_EFFORTS // 6)

    def _state_weight(self, plant: SampledSystem) -> np.ndarray:
        return plant.C.T @ np.diag([1.0, self.rate_time**2]) @ plant.C


def pd_loop(plant: SampledSystem, gains: Gains) -> SampledSystem:
    """Return the loop transfer function of a PD, k_P G_value + k_D G_rate, for a plant with these two outputs.

    A PID for a plant from `with_integral` adds k_I G_integral. The loop transfer function of a proportional law is k G,
    for a plant with one output.
    """
    row = np.array([gains])
    return replace(plant, C=row @ plant.C, D=row @ plant.D, outputs=("loop",))


def design_loop(
    plant: SampledSystem,
    family: GainFamily,
    requirements: Requirements,
    *,
    axis: str,
    effort: float | None = None,
) -> LoopDesign:
    """Design the PD, or the proportional law, of one axis.

    Args:
        plant: plant from a commanded acceleration to the measured value and rate; for a proportional law, to one
            output.
        family: family of gains that the design searches.
        requirements: margins that the loop must have.
        axis: name of the axis, for error messages.
        effort: parameter of the family that determines the gains; None for the largest effort that meets the
            requirements.

    Raises:
        InputError: if the requirements cannot be met.
    """
    grid = frequencies(plant.period)
    response = plant.response(np.exp(1j * grid * plant.period))[..., 0]

    def trial(tried: float) -> _GainTrial:
        gains = _rounded(family.gains(plant, tried))
        flaws = _flaws_of(plant, family, tried, gains)
        margins_found = fast_margins(response @ np.array(gains), grid)
        min_ratio = -math.inf if flaws else requirements.min_ratio(margins_found)
        return _GainTrial(tried, gains, flaws or requirements.shortfalls(margins_found), min_ratio)

    def finished(best: _GainTrial, limits: Iterable[str]) -> LoopDesign:
        return _finished(plant, family, axis, best, tuple(limits))

    if effort is not None:
        requested = trial(effort)
        if requested.flaws:
            what = f"a bandwidth of {effort:g} rad/s" if isinstance(family, PolePair) else f"an effort of {effort:g}"
            raise InputError(f"{axis} cannot have {what}: {_listed(requested.flaws)}")
        return finished(requested, ())
    trials: list[_GainTrial] = []
    for tried in family.efforts(plant):
        trials.append(trial(tried))
        if trials[-1].flaws and len(trials) > 1 and not trials[-2].flaws:
            break
    acceptable = [each for each in trials if not each.flaws]
    if not acceptable:
        closest = max(trials, key=lambda each: each.min_ratio)
        raise InputError(
            f"no gains of this family meet the requirements for {axis}; closest result: {_listed(closest.flaws)}"
        )
    best, beyond = acceptable[-1], trials[-1]
    if not beyond.flaws:
        return finished(best, ())
    for _ in range(_NUM_BISECTIONS):
        middle = trial(math.sqrt(best.effort * beyond.effort))
        best, beyond = (best, middle) if middle.flaws else (middle, beyond)
    return finished(best, beyond.flaws)


def with_integral(plant: SampledSystem, integration: Integration = "forward_euler") -> SampledSystem:
    """Return a plant with an additional output: the integral i of the value, as a PID computes it.

    At every tick, i⁺ = i + h value. The output is i for `forward_euler` integration, and i⁺ for `backward_euler`.
    """
    n = len(plant.A)
    value, *_ = plant.C
    direct, *_ = plant.D
    present_weight = plant.period if integration == "backward_euler" else 0.0
    integral = np.append(present_weight * value, 1.0)[np.newaxis]
    return replace(
        plant,
        A=np.block([[plant.A, np.zeros((n, 1))], [plant.period * value, np.ones((1, 1))]]),
        B=np.vstack([plant.B, plant.period * direct]),
        C=np.vstack([np.hstack([plant.C, np.zeros((len(plant.C), 1))]), integral]),
        D=np.vstack([plant.D, present_weight * direct]),
        states=(*plant.states, "integral"),
        outputs=(*plant.outputs, "integral"),
    )


def add_integral(
    design: LoopDesign, requirements: Requirements, *, cost: float, integration: Integration = "forward_euler"
) -> LoopDesign:
    """Add the integral with the largest gain k_I that reduces the phase margin of a PD by at most a given fraction.

    k_I is at most a quarter of k_P times the crossover frequency of the PD loop. A larger integral would let errors
    decay in a slow oscillation, even if the margins at the crossover are large.

    Args:
        design: design of the PD.
        requirements: requirements that the PID must meet.
        cost: largest fraction of the phase margin of the PD that the integral may use up, between 0 and 1.
        integration: integration rule of the PID, see `drake_quad.control.integral`.
    """
    pd, plant = design.gains, with_integral(design.plant, integration)
    assert isinstance(pd, AxisPdGains)
    grid = frequencies(plant.period)
    response = plant.response(np.exp(1j * grid * plant.period))[..., 0]
    required = requirements._replace(phase=max(requirements.phase, (1.0 - cost) * design.margins.phase))

    def pid(fraction: float) -> PidGains:
        return PidGains(*pd, float(f"{fraction * pd.k_p * design.margins.crossover:.4g}"))

    def fits(fraction: float) -> bool:
        gains = np.array(pid(fraction))
        stable = np.abs(plant.with_feedback(gains[np.newaxis]).poles()).max() < 1.0
        return bool(stable and not required.shortfalls(fast_margins(response @ gains, grid)))

    low, high = 0.0, _MAX_INTEGRAL_RATIO
    if fits(high):
        low = high
    for _ in range(_NUM_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if fits(middle) else (low, middle)
    gains = pid(low)
    return replace(design, gains=gains, plant=plant, margins=margins(pd_loop(plant, gains)))


class _GainTrial(NamedTuple):
    """Gains that a design has tried.

    Attributes:
        effort: parameter of the family of gains.
        gains: gains for this effort.
        flaws: description of each reason why the gains are not acceptable, by the name of the violated requirement.
        min_ratio: smallest ratio of a margin to its requirement; -inf if the gains have other flaws.
    """

    effort: float
    gains: AxisPdGains | ProportionalGain
    flaws: dict[str, str]
    min_ratio: float


def _flaws_of(
    plant: SampledSystem, family: GainFamily, effort: float, gains: AxisPdGains | ProportionalGain
) -> dict[str, str]:
    """Return a description of each flaw of a loop, by name. Margins that are too small are not included."""
    if not all(map(math.isfinite, gains)):
        return {"no gains": "none exist for this effort"}
    if not min(gains) > 0.0:
        return {"a negative gain": ", ".join(f"{_GAIN_SYMBOLS[name]} {k:g}" for name, k in gains._asdict().items())}
    size = np.abs(plant.with_feedback(np.array([gains])).poles()).max()
    if not size < 1.0:
        return {"no stability": f"a pole of magnitude {size:.4f}"}
    if isinstance(family, PolePair):
        decay = -math.log(size) / plant.period
        if decay < 0.98 * effort * family.damping:
            return {SLOWER_POLE: f"it decays at {decay:.3g} 1/s, the pair at {effort * family.damping:.3g}"}
    return {}


def _listed(flaws: dict[str, str]) -> str:
    return "; ".join(f"{name}: {value}" for name, value in flaws.items())


def _finished(
    plant: SampledSystem, family: GainFamily, axis: str, best: _GainTrial, limits: tuple[str, ...]
) -> LoopDesign:
    gains, effort = best.gains, best.effort
    ratio = None
    if isinstance(family, OutputRegulator) and isinstance(gains, AxisPdGains):
        ratio = family.cost(plant, gains, effort) / family.min_cost(plant, effort)
    return LoopDesign(
        axis=axis,
        gains=gains,
        plant=plant,
        margins=margins(pd_loop(plant, gains)),
        bandwidth=effort if isinstance(family, PolePair) else None,
        cost_ratio=ratio,
        limits=limits,
    )


def _rounded(gains: AxisPdGains | ProportionalGain) -> AxisPdGains | ProportionalGain:
    """Return the gains rounded to four significant digits, as a scenario file contains them."""
    return type(gains)(*(float(f"{gain:.4g}") for gain in gains))
