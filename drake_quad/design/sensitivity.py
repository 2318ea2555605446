"""Derivatives of the metrics of a flight with respect to a scenario's numbers.

A number of a scenario ends in numeric parameters and in the initial state of the diagram's context. From their
derivatives on, Drake's simulator carries the flight on AutoDiffXd: through every step, filter and delay to the metrics.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.autodiffutils import AutoDiffXd, ExtractGradient, InitializeAutoDiff
from pydrake.systems.analysis import Simulator_
from pydrake.systems.framework import Diagram

from drake_quad.assembly.laboratory import jump_times
from drake_quad.errors import InputError
from drake_quad.fleets.fleet_simulation import fly, read_metrics
from drake_quad.flight.mission import build_tracking_diagram, plan_route
from drake_quad.framework.wiring import subsystem
from drake_quad.laboratory.metrics import METRICS
from drake_quad.linear.context_vector import ContextVector, leaf_paths
from drake_quad.linear.sampled_system import to_autodiff
from drake_quad.planning.duration import flight_duration
from drake_quad.reference.plan import Plan
from drake_quad.scenario.batch import Batch, draw_sample
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.numbers import number_at, with_number
from drake_quad.scenario.paths import distributions_in, refuse_distributions

# The metrics that depend on a flight smoothly, as long as it does not crash.
DIFFERENTIABLE = tuple(name for name, metric in METRICS.items() if metric.differentiable)
# Metrics are sizes: what is less than this, in SI units, is nothing but rounding.
_NO_ERROR = 1e-12
# Numbers that are only compared with others.
_COMPARED = ("loss_rate", "dropout_rate", "rotor_failure.time", "payload.time")
# Relative step of the five-point differences from a scenario's number to the context, which is polynomial or nearly so:
# around the number or, where it may only rise or only fall, to one side of it.
_STEP = 1e-3
_AROUND = {-2: 1.0 / 12.0, -1: -2.0 / 3.0, 1: 2.0 / 3.0, 2: -1.0 / 12.0}
_ABOVE = {1: 4.0, 2: -3.0, 3: 4.0 / 3.0, 4: -0.25}
_BELOW = {-steps: -weight for steps, weight in _ABOVE.items()}


@dataclass(frozen=True)
class Sensitivities:
    """Metrics of a flight and their derivatives.

    Attributes:
        fields: of the scenario, by path.
        values: (fields,) of them.
        metrics: the flight's, by name.
        crash_time: s; infinite for a vehicle that did not crash. After a crash they are those of the flight until then.
        gradients: (fields,) derivatives of each metric, by name; NaN for one that is zero, where it has a kink.
    """

    fields: tuple[str, ...]
    values: np.ndarray
    metrics: Mapping[str, float]
    crash_time: float
    gradients: Mapping[str, np.ndarray]


def flight_sensitivities(scenario: Scenario, fields: Sequence[str], *, sample: int | None = None) -> Sensitivities:
    """Simulate one vehicle with AutoDiffXd and return the derivatives of its metrics.

    Args:
        scenario: scenario without distributions, unless a sample is given.
        fields: paths of numbers in the scenario, as in `--set`: `vehicle.mass`, `control.position.k_p.0`.
        sample: index of the sample of the scenario's study to fly.

    Raises:
        InputError: a field is not a number, or the flight does not depend smoothly on it.
    """
    if not fields:
        raise InputError("there is no field to differentiate by")
    sample = scenario.sample if sample is None else sample
    if sample is None:
        refuse_distributions(distributions_in(scenario))
    scenario = draw_sample(scenario, sample or 0)
    plan = plan_route(scenario)
    values = np.array([number_at(scenario, field) for field in fields])
    diagram = build_tracking_diagram(scenario, plan=plan)
    start = diagram.CreateDefaultContext()
    layout = ContextVector(diagram, parameters=True)
    nominal = layout.read(diagram, start)
    seeds = np.stack([_seed(scenario, plan, field, layout, nominal) for field in fields])

    converted = to_autodiff(diagram)
    simulator = Simulator_[AutoDiffXd](converted)
    context = simulator.get_mutable_context()
    context.SetTimeStateAndParametersFrom(start)
    layout.write(converted, context, InitializeAutoDiff(nominal, gradient=seeds.T).ravel())
    # The floating-point flags that arithmetic on objects leaves behind mean nothing.
    with np.errstate(all="ignore"):
        fly(simulator, flight_duration(scenario, plan), jumps=jump_times(Batch.draw(scenario, [0])))
        metrics = read_metrics(converted, context)
    found = {name: getattr(metrics, name)[0] for name in DIFFERENTIABLE}
    (crash,) = metrics.crash_time
    crash_time = crash.value()
    if np.isnan(found["rmse"].value()):
        raise InputError(f"crashed at {crash_time:.2f} s, before a tick counted for the metrics")
    return Sensitivities(
        tuple(fields),
        values,
        {name: value.value() for name, value in found.items()},
        crash_time,
        {name: _gradient(value, len(fields)) for name, value in found.items()},
    )


def _structure(diagram: Diagram) -> list[Any]:
    """Return the structure of a diagram: its leaf systems, with their options and sizes."""
    found = []
    for path in sorted(leaf_paths(diagram)):
        given = getattr(subsystem(diagram, path), "structure", {})
        found.append((path, {name: value for name, value in given.items() if isinstance(value, bool | int | str)}))
    return found


def _seed(scenario: Scenario, plan: Plan, field: str, layout: ContextVector, nominal: np.ndarray) -> np.ndarray:
    """Return the derivative of all numbers of the default context with respect to a field."""
    if field.startswith("route."):
        raise InputError(f"{field} changes the plan, which is not differentiated")
    if field.endswith(_COMPARED):
        raise InputError(f"{field} decides when something happens; a flight depends on it in jumps")
    value = number_at(scenario, field)
    step = _STEP * (abs(value) or 1.0)
    seed, structure = np.zeros_like(nominal), _structure(build_tracking_diagram(scenario, plan=plan))
    for neighbour, weight in _neighbours(scenario, field, value, step):
        diagram = build_tracking_diagram(neighbour, plan=plan)
        if _structure(diagram) != structure or ContextVector(diagram, parameters=True).names != layout.names:
            raise InputError(f"{field} changes the structure of the diagram at {value:g}; it has no derivative there")
        numbers = layout.read(diagram, diagram.CreateDefaultContext())
        moved = np.subtract(numbers, nominal, out=np.zeros_like(nominal), where=numbers != nominal)
        seed += weight / step * moved
    if not seed.any():
        raise InputError(f"{field} is not a number that the flight depends on smoothly")
    return seed


def _neighbours(scenario: Scenario, field: str, value: float, step: float) -> list[tuple[Scenario, float]]:
    """Scenarios with a field a few steps away, and the weights of differences to the scenario itself."""
    refusals = []
    for weights in (_AROUND, _ABOVE, _BELOW):
        try:
            return [(with_number(scenario, field, value + k * step), weight) for k, weight in weights.items()]
        except InputError as error:
            refusals.append(error)
    raise refusals[0]


def _gradient(value: Any, size: int) -> np.ndarray:
    if value.value() < _NO_ERROR:
        return np.full(size, np.nan)
    gradient = ExtractGradient(np.array([value]))
    return gradient[0] if gradient.shape[1] else np.zeros(size)
