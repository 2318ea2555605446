"""Derivatives of flight metrics with respect to numeric fields of a scenario.

A numeric field affects numeric parameters and the initial state in the diagram's context. Drake's simulator with
AutoDiffXd propagates the derivatives of these values through every step, filter and delay to the metrics.
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
from drake_quad.laboratory.metrics import metric_definitions
from drake_quad.linear.context_vector import ContextVector, leaf_paths
from drake_quad.linear.sampled_system import to_autodiff
from drake_quad.planning.duration import flight_duration
from drake_quad.reference.plan import Plan
from drake_quad.scenario.batch import Batch, draw_sample
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.numbers import number_at, with_number
from drake_quad.scenario.paths import distributions_in, refuse_distributions

# Metrics of a smaller magnitude, in SI units, are rounding errors around zero. Most metrics cannot be negative, so they
# have a kink at zero.
_MIN_METRIC = 1e-12
# Fields that the simulation compares with a random number or with the time. Metrics are not differentiable with respect
# to these fields.
_COMPARED_FIELDS = ("loss_rate", "dropout_rate", "rotor_failure.time", "payload.time")
# Relative step of the five-point finite differences. The differences are nearly exact, since the parameters of a
# diagram are nearly polynomials of a field's value.
_RELATIVE_STEP = 1e-3
# Weights of five-point differences, by the number of steps. One-sided differences are used for values at the end of
# their allowed range.
_CENTRAL_WEIGHTS = {-2: 1.0 / 12.0, -1: -2.0 / 3.0, 1: 2.0 / 3.0, 2: -1.0 / 12.0}
_FORWARD_WEIGHTS = {1: 4.0, 2: -3.0, 3: 4.0 / 3.0, 4: -0.25}
_BACKWARD_WEIGHTS = {-steps: -weight for steps, weight in _FORWARD_WEIGHTS.items()}


@dataclass(frozen=True)
class Sensitivities:
    """Metrics of a flight and their derivatives.

    Attributes:
        fields: paths of the scenario fields.
        values: (fields,) values of the fields.
        metrics: metrics of the flight, by name. After a crash they cover the flight until the crash.
        crash_time: time of the crash, s; infinite without a crash.
        gradients: (fields,) derivatives of each metric, by name; NaN where a metric is zero and therefore has a kink.
    """

    fields: tuple[str, ...]
    values: np.ndarray
    metrics: Mapping[str, float]
    crash_time: float
    gradients: Mapping[str, np.ndarray]


def differentiable_metrics(scenario: Scenario) -> list[str]:
    """Return the names of the metrics that are differentiable as long as the vehicle does not crash."""
    return [name for name, metric in metric_definitions(scenario.metrics_type).items() if metric.differentiable]


def flight_sensitivities(scenario: Scenario, fields: Sequence[str], *, sample: int | None = None) -> Sensitivities:
    """Simulate one vehicle with AutoDiffXd and return the derivatives of its metrics.

    Args:
        scenario: scenario without distributions, unless a sample is given.
        fields: paths of numeric scenario fields, as in `--set`: `vehicle.mass`, `control.position.k_p.0`.
        sample: index of the study sample to fly.

    Raises:
        InputError: if a field is not a number, or the flight does not depend smoothly on it.
    """
    if not fields:
        raise InputError("cannot compute sensitivities: no field is given; name at least one, such as vehicle.mass")
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
    # After arithmetic on arrays of Python objects, NumPy may warn about floating-point errors that did not occur.
    with np.errstate(all="ignore"):
        fly(simulator, flight_duration(scenario, plan), jumps=jump_times(Batch.draw(scenario, [0])))
        metrics = read_metrics(converted, context)
    values_by_name = {name: getattr(metrics, name)[0] for name in differentiable_metrics(scenario)}
    (crash,) = metrics.crash_time
    crash_time = crash.value()
    if np.isnan(values_by_name["rmse"].value()):
        raise InputError(f"the vehicle crashed at {crash_time:.2f} s, before the first tick that the metrics include")
    return Sensitivities(
        tuple(fields),
        values,
        {name: value.value() for name, value in values_by_name.items()},
        crash_time,
        {name: _gradient(value, len(fields)) for name, value in values_by_name.items()},
    )


def _structure(diagram: Diagram) -> list[Any]:
    """Return the structure of a diagram: the options and sizes of its leaf systems."""
    leaves = []
    for path in sorted(leaf_paths(diagram)):
        options = getattr(subsystem(diagram, path), "structure", {})
        leaves.append((path, {name: value for name, value in options.items() if isinstance(value, bool | int | str)}))
    return leaves


def _seed(scenario: Scenario, plan: Plan, field: str, layout: ContextVector, nominal: np.ndarray) -> np.ndarray:
    """Return the derivative of all values in the default context with respect to a field."""
    if field.startswith("route."):
        raise InputError(f"cannot differentiate with respect to {field}: it changes the plan")
    if field.endswith(_COMPARED_FIELDS):
        raise InputError(f"cannot differentiate with respect to {field}: the flight depends on it discontinuously")
    value = number_at(scenario, field)
    step = _RELATIVE_STEP * (abs(value) or 1.0)
    seed, structure = np.zeros_like(nominal), _structure(build_tracking_diagram(scenario, plan=plan))
    for neighbour, weight in _neighbours(scenario, field, value, step):
        diagram = build_tracking_diagram(neighbour, plan=plan)
        if _structure(diagram) != structure or ContextVector(diagram, parameters=True).names != layout.names:
            raise InputError(
                f"cannot differentiate with respect to {field}: the structure of the diagram changes at {value:g}"
            )
        numbers = layout.read(diagram, diagram.CreateDefaultContext())
        change = np.subtract(numbers, nominal, out=np.zeros_like(nominal), where=numbers != nominal)
        seed += weight / step * change
    if not seed.any():
        raise InputError(f"cannot differentiate with respect to {field}: the flight does not depend on it smoothly")
    return seed


def _neighbours(scenario: Scenario, field: str, value: float, step: float) -> list[tuple[Scenario, float]]:
    """Return scenarios in which a field differs by a few steps, and the finite-difference weight of each."""
    refusals = []
    for weights in (_CENTRAL_WEIGHTS, _FORWARD_WEIGHTS, _BACKWARD_WEIGHTS):
        try:
            return [(with_number(scenario, field, value + k * step), weight) for k, weight in weights.items()]
        except InputError as error:
            refusals.append(error)
    raise refusals[0]


def _gradient(value: Any, size: int) -> np.ndarray:
    if abs(value.value()) < _MIN_METRIC:
        return np.full(size, np.nan)
    gradient = ExtractGradient(np.array([value]))
    return gradient[0] if gradient.shape[1] else np.zeros(size)
