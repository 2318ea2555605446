"""Exact linearisation of a sampled diagram: the Jacobian of its map over one period.

A diagram with cameras, links, filters and a vehicle with a time step maps its state from one tick to the next:

    x⁺ = Φ(x, u)        y = g(x, u)

where x is the state just before the events of a tick, u is constant over the following period, and y is the output just
before the events. `linearize` lets Drake's simulator advance the diagram by one period with AutoDiffXd, so that

    A = ∂Φ/∂x    B = ∂Φ/∂u    C = ∂g/∂x    D = ∂g/∂u

contain the exact effect of every delay, hold, filter and step. A of a closed loop is the monodromy matrix, whose
eigenvalues are the Floquet multipliers.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy
from pydrake.autodiffutils import AutoDiffXd, ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.systems.analysis import InitializeParams, Simulator, Simulator_
from pydrake.systems.framework import Context, Diagram

from drake_quad.errors import InputError
from drake_quad.framework.wiring import subsystem
from drake_quad.linear.context_vector import ContextVector, leaf_paths, port_rows, scheduled_groups, without_dots
from drake_quad.process_settings import single_threaded_blas

if TYPE_CHECKING:
    import control


# Number of periods that are simulated before a diagram is linearised. In the first periods, rounding errors separate
# events with different periods that should coincide.
_NUM_SETTLING_PERIODS = 4
# A mode counts as neutral if the magnitude of its pole is larger than 1 minus this tolerance. Double poles at 1
# have rounding errors of about 1e-8.
_NEUTRAL_TOLERANCE = 1e-6
_HIDDEN_TOLERANCE = 1e-6  # largest impulse response through hidden modes, for input and output in the same unit
_SETTLING_TIME = 60.0  # s, in which the covariances of Kalman filters settle in hover


@dataclass(frozen=True)
class SampledSystem:
    """Linear discrete-time system x⁺ = A x + B u, y = C x + D u, where x, u, y are deviations from an operating point.

    Attributes:
        A: (n, n) system matrix.
        B: (n, m) input matrix.
        C: (p, n) output matrix.
        D: (p, m) feedthrough matrix.
        period: sampling period, s.
        states: names of the n states.
        inputs: names of the m inputs.
        outputs: names of the p outputs.
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    period: float
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]

    def __repr__(self) -> str:
        """Return the sizes and the period, since the matrices of a loop can have 200 rows."""
        (n, m), p = self.B.shape, len(self.C)
        return f"<SampledSystem with {n} states, {m} inputs, {p} outputs and period {self.period:g} s>"

    def to_control(self) -> "control.StateSpace":
        """Return the system as python-control's StateSpace; in names, "_" replaces "."."""
        import control

        names = {
            "states": without_dots(self.states),
            "inputs": without_dots(self.inputs),
            "outputs": without_dots(self.outputs),
        }
        return control.ss(self.A, self.B, self.C, self.D, self.period, **names)

    to_state_space = to_control
    """Alias of `to_control`, with the name that `drake_quad.linear.vehicle_model` uses for continuous systems."""

    def to_scipy(self) -> "scipy.signal.StateSpace":
        """Return the system as SciPy's StateSpace.

        SciPy's systems have no names. States, inputs and outputs are in the order of this system.
        """
        return scipy.signal.StateSpace(self.A, self.B, self.C, self.D, dt=self.period)

    def poles(self) -> np.ndarray:
        """Return the eigenvalues (n,) of A, which for a closed loop are its Floquet multipliers."""
        return np.linalg.eigvals(self.A)

    def response(self, z: np.ndarray) -> np.ndarray:
        """Return the transfer matrix (points, p, m) at points of the z-plane.

        The method is back substitution in the Schur form of the balanced A. It is ten times as fast as an elimination
        at each point, for dozens of states and thousands of points.

        Raises:
            LinAlgError: if one of the points is a pole.
        """
        triangular, basis, scale = self._schur_form
        inputs = basis.conj().T @ (self.B / scale)
        gaps = np.asarray(z)[:, np.newaxis] - np.diag(triangular)
        if not gaps.all():
            raise np.linalg.LinAlgError("one of the points is a pole of the system")
        states = np.empty((len(self.A), *np.shape(z), self.B.shape[1]), dtype=complex)
        with single_threaded_blas():
            for i in reversed(range(len(self.A))):
                above = np.tensordot(triangular[i, i + 1 :], states[i + 1 :], 1)
                states[i] = (inputs[i] + above) / gaps[:, i, np.newaxis]
        return np.moveaxis(np.tensordot(self.C * scale.T @ basis, states, 1), 0, 1) + self.D

    @cached_property
    def _schur_form(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Schur form of the balanced A: upper triangular matrix, basis, and scales (n, 1) of the states."""
        balanced, scales = scipy.linalg.matrix_balance(self.A, permute=False, separate=True)
        # The complex Schur algorithm does not always converge for entries as small as 1e-150.
        triangular, basis = scipy.linalg.rsf2csf(*scipy.linalg.schur(balanced, output="real"))
        return triangular, basis, scales[0][:, np.newaxis]

    def between(self, inputs: Sequence[str], outputs: Sequence[str]) -> "SampledSystem":
        """Return the system from some of the inputs to some of the outputs, with all states."""
        columns, rows = [self.inputs.index(name) for name in inputs], [self.outputs.index(name) for name in outputs]
        return replace(
            self,
            B=self.B[:, columns],
            C=self.C[rows],
            D=self.D[np.ix_(rows, columns)],
            inputs=tuple(inputs),
            outputs=tuple(outputs),
        )

    def transformed(self, rows: Sequence[int], matrix: np.ndarray, names: Sequence[str]) -> "SampledSystem":
        """Return the system with other state coordinates: some components of the state are multiplied by a matrix.

        Args:
            rows: indices of the k state components that are transformed.
            matrix: (k, k) matrix that multiplies these components.
            names: new names of these components.
        """
        T = np.eye(len(self.A))
        T[np.ix_(rows, rows)] = matrix
        inverse = np.linalg.inv(T)
        states = list(self.states)
        for row, name in zip(rows, names, strict=True):
            states[row] = name
        return replace(self, A=T @ self.A @ inverse, B=T @ self.B, C=self.C @ inverse, states=tuple(states))

    def connected(self, *, tolerance: float = 1e-12) -> "SampledSystem":
        """Return the system without states that no input can reach, or that no output can observe.

        Args:
            tolerance: threshold below which matrix entries count as rounding errors. It is relative to the largest
                entry in the same row of A or C, or in the same column of B.
        """
        couples = _is_significant(self.A, tolerance)
        reached = _closure(couples, _is_significant(self.B.T, tolerance).any(axis=0))
        observed = _closure(couples.T, _is_significant(self.C, tolerance).any(axis=0))
        indices = np.flatnonzero(reached & observed)
        states = tuple(self.states[i] for i in indices)
        return replace(self, A=self.A[np.ix_(indices, indices)], B=self.B[indices], C=self.C[:, indices], states=states)

    def without_hidden_modes(self) -> "SampledSystem":
        """Return the system without its neutral and unstable modes, if no input affects an output through them.

        An example is the drift of a position that no sensor measures. The system is returned unchanged if an input
        affects an output through one of these modes. Otherwise, the states of the result are linear combinations of the
        original states, with the names `mode.0`, `mode.1`, ...
        """
        balanced, scales = scipy.linalg.matrix_balance(self.A, permute=False, separate=True)
        T, basis, k = scipy.linalg.schur(balanced, sort=lambda re, im: math.hypot(re, im) > 1.0 - _NEUTRAL_TOLERANCE)
        if k == 0:
            return self
        coupling = scipy.linalg.solve_sylvester(T[:k, :k], -T[k:, k:], -T[:k, k:])
        B, C = basis.T @ (self.B / scales[0][:, np.newaxis]), self.C * scales[0] @ basis
        hidden_inputs, hidden_outputs = B[:k] - coupling @ B[k:], C[:, :k]
        for _ in range(k):
            if (np.abs(hidden_outputs @ hidden_inputs) > _HIDDEN_TOLERANCE).any():
                return self
            hidden_outputs = hidden_outputs @ T[:k, :k]
        names = tuple(f"mode.{i}" for i in range(len(self.A) - k))
        return replace(self, A=T[k:, k:], B=B[k:], C=C[:, k:] + C[:, :k] @ coupling, states=names)

    def with_feedback(self, gain: np.ndarray) -> "SampledSystem":
        """Return the closed loop from v to y, where u = v - gain y; the system must have D = 0.

        Args:
            gain: (m, p) feedback gain.
        """
        return replace(self, A=self.A - self.B @ gain @ self.C)

    def scaled(self, factor: float, name: str) -> "SampledSystem":
        """Return the system with its single input multiplied by a factor and renamed."""
        return replace(self, B=self.B * factor, D=self.D * factor, inputs=(name,))


def _is_significant(matrix: np.ndarray, tolerance: float) -> np.ndarray:
    """Return a mask of the entries that are not negligible compared with the largest entry in their row."""
    sizes = np.abs(matrix)
    return sizes > tolerance * sizes.max(axis=1, keepdims=True)


def _closure(couples: np.ndarray, reachable: np.ndarray) -> np.ndarray:
    """Return a mask (n,) of the states reachable from given ones; `couples[i, j]` is True if j acts on i."""
    while True:
        extended = reachable | (couples & reachable).any(axis=1)
        if (extended == reachable).all():
            return reachable
        reachable = extended


def linearize(
    diagram: Diagram,
    context: Context,
    *,
    period: float,
    inputs: Sequence[str] = (),
    outputs: Sequence[str] = (),
    excluded_systems: Sequence[str] = (),
) -> tuple[SampledSystem, np.ndarray]:
    """Linearise a diagram's map over a period, and return the linear system and the state change over a period.

    Args:
        diagram: diagram of systems that support AutoDiffXd.
        context: context of the diagram at a tick later than zero, before the events of that tick. It contains state,
            parameters and fixed inputs.
        period: multiple of the periods of all events, s.
        inputs: names of the input ports that make up u, all fixed in the context.
        outputs: names of the output ports that make up y.
        excluded_systems: names of subsystems whose state is left out, since they only observe the loop.

    Returns:
        The system, and Φ(x, u) - x (n,), which is zero at an equilibrium.

    Raises:
        InputError: if a system does not support AutoDiffXd, or has an abstract state.
    """
    (system,), change = linearize_ticks(
        diagram, context, period=period, num_ticks=1, inputs=inputs, outputs=outputs, excluded_systems=excluded_systems
    )
    return system, change


def linearize_ticks(
    diagram: Diagram,
    context: Context,
    *,
    period: float,
    num_ticks: int,
    inputs: Sequence[str] = (),
    outputs: Sequence[str] = (),
    excluded_systems: Sequence[str] = (),
) -> tuple[list[SampledSystem], np.ndarray]:
    """Linearise a diagram's maps from each of several consecutive ticks to the next.

    The arguments and errors are those of `linearize`, except that `period` is the time between two ticks. Only
    `num_ticks * period` must be a multiple of the periods of all events.

    Returns:
        The linear system from each tick to the next, and the state change (n,) over all ticks.
    """
    layout = ContextVector(diagram, excluded_systems=excluded_systems)
    converted = to_autodiff(diagram)
    state = layout.read(diagram, context)
    ports = [diagram.GetInputPort(name) for name in inputs]
    fixed = [port.Eval(context) for port in ports]
    n, m = len(state), sum(map(len, fixed))

    root = converted.CreateDefaultContext()
    root.SetTimeStateAndParametersFrom(context)
    converted.FixInputPortsFrom(diagram, context, root)
    simulator = initialize_without_events(Simulator_[AutoDiffXd](converted, root))
    systems, x, first_tick = [], state, round(context.get_time() / period)
    for tick in range(first_tick, first_tick + num_ticks):
        point = InitializeAutoDiff(np.concatenate([x, *fixed])).ravel()
        layout.write(converted, root, point[:n])
        first = n
        for name, port in zip(inputs, ports, strict=True):
            converted.GetInputPort(name).FixValue(root, point[first : first + port.size()])
            first += port.size()
        y = [np.asarray(converted.GetOutputPort(name).Eval(root)) for name in outputs]
        # NumPy warns about meaningless floating-point flags after arithmetic on arrays of objects.
        with np.errstate(all="ignore"):
            simulator.AdvanceTo(tick_after(0.0, period, tick + 1))
        after = layout.read(converted, root)
        state_gradient = _gradient(after, n + m)
        output_gradient = _gradient(np.concatenate([*y, np.empty(0)]), n + m)
        x = ExtractValue(after).ravel()
        systems.append(
            SampledSystem(
                state_gradient[:, :n],
                state_gradient[:, n:],
                output_gradient[:, :n],
                output_gradient[:, n:],
                period,
                layout.names,
                tuple(name for port in ports for name in port_rows(port.get_name(), port.size())),
                tuple(name for port in outputs for name in port_rows(port, diagram.GetOutputPort(port).size())),
            )
        )
    return systems, x - state


def lifted(systems: Sequence[SampledSystem]) -> SampledSystem:
    """Return a periodic system as a time-invariant system over the common period of its rates.

    The method is lifting (P. P. Khargonekar, K. Poolla and A. Tannenbaum, "Robust control of linear time-invariant
    plants using periodic compensation", IEEE Transactions on Automatic Control 30(11), 1985). Inputs and outputs at
    different ticks are different inputs and outputs: `u` becomes `u@0`, `u@1`, …

    Args:
        systems: system from each tick of the common period to the next tick.
    """
    first = systems[0]
    n, m = first.B.shape
    p = len(first.C)
    A, B = np.eye(n), np.zeros((n, m * len(systems)))
    C, D = np.zeros((p * len(systems), n)), np.zeros((p * len(systems), m * len(systems)))
    for tick, system in enumerate(systems):
        rows, columns = slice(p * tick, p * (tick + 1)), slice(m * tick, m * (tick + 1))
        C[rows], D[rows] = system.C @ A, system.C @ B
        D[rows, columns] = system.D
        A, B = system.A @ A, system.A @ B
        B[:, columns] = system.B
    return replace(
        first,
        A=A,
        B=B,
        C=C,
        D=D,
        period=first.period * len(systems),
        inputs=tuple(f"{name}@{tick}" for tick in range(len(systems)) for name in first.inputs),
        outputs=tuple(f"{name}@{tick}" for tick in range(len(systems)) for name in first.outputs),
    )


def at_tick(diagram: Diagram, time: float, context: Context | None = None) -> Context:
    """Advance a diagram to a tick and return its context before the events of that tick, as `linearize` requires."""
    simulator = Simulator(diagram) if context is None else Simulator(diagram, context)
    simulator.AdvanceTo(time)
    return simulator.get_mutable_context()


def settle(diagram: Diagram, context: Context, period: float) -> None:
    """Advance a context to a tick shortly after time zero, and set Kalman filters to their steady covariance in hover.

    Args:
        diagram: diagram.
        context: context of the diagram at time zero.
        period: multiple of the periods of all events, s.
    """
    at_tick(diagram, _NUM_SETTLING_PERIODS * period, context)
    num_periods = round(_SETTLING_TIME / period)
    for path in leaf_paths(diagram):
        system = subsystem(diagram, path)
        if groups := scheduled_groups(system):
            settled = _after_constant_inputs(system, system.GetMyContextFromRoot(context), num_periods * period)
            state = system.GetMyMutableContextFromRoot(context).get_mutable_discrete_state()
            for group in groups:
                state.get_mutable_vector(group).SetFromVector(settled.get_discrete_state(group).CopyToVector())


def _after_constant_inputs(system: Any, context: Context, time: float) -> Context:
    """Return the context of a leaf system after a time (s) with constant inputs, given its initial context."""
    later = system.CreateDefaultContext()
    later.SetTimeStateAndParametersFrom(context)
    for port in map(system.get_input_port, range(system.num_input_ports())):
        if port.HasValue(context):
            port.FixValue(later, port.Eval(context))
    (update,) = system.updates
    for _ in range(round(time / update.period)):
        later.SetDiscreteState(system.EvalUniquePeriodicDiscreteUpdate(later).Clone())
    return later


def initialize_without_events(simulator: Simulator) -> Simulator:
    """Return a simulator that is initialised without the start-up events, to continue a flight."""
    keep = InitializeParams()
    keep.suppress_initialization_events = True
    simulator.Initialize(keep)
    return simulator


def _gradient(values: np.ndarray, size: int) -> np.ndarray:
    """Return the derivatives (values, size) of AutoDiffXd values; zero for values without derivatives."""
    if not len(values):
        return np.empty((0, size))
    gradient = ExtractGradient(values)
    return gradient if gradient.shape[1] else np.zeros((len(values), size))


def tick_after(time: float, period: float, ticks: int = 1) -> float:
    """Return the time of a later tick (s), with the same rounding as in Drake.

    If the time were later by a rounding error, a simulation to this time would also execute the events of that tick.
    """
    return period * (round(time / period) + ticks)


def to_autodiff(diagram: Diagram) -> Any:
    """Return the diagram for AutoDiffXd.

    Raises:
        InputError: if a system does not support AutoDiffXd; the message names all such systems.
    """
    converted = diagram.ToAutoDiffXdMaybe()
    if converted is not None:
        return converted
    culprits = [path for path in leaf_paths(diagram) if subsystem(diagram, path).ToAutoDiffXdMaybe() is None]
    names = ", ".join(".".join(path) for path in culprits) or diagram.get_name()
    raise InputError(f"{names} does not support AutoDiffXd, so the loop cannot be linearised")
