"""Map of the flights over two fields of a scenario, such as two components of the initial state."""

from typing import NamedTuple

import numpy as np

from drake_quad.errors import InputError, join_names
from drake_quad.laboratory.metrics import Metrics
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.paths import distributions_in
from drake_quad.studies.evaluator import Evaluator

_MAX_VEHICLES = 1024  # largest number of vehicles that fly at the same time


class FieldMap(NamedTuple):
    """Flights of a scenario over a grid of two of its fields.

    Attributes:
        x: (columns,) values of the field on the horizontal axis.
        y: (rows,) values of the field on the vertical axis.
        metrics: metrics of the flights, as arrays (rows, columns).
        requirements: names of the requirements of the scenario.
    """

    x: np.ndarray
    y: np.ndarray
    metrics: Metrics
    requirements: tuple[str, ...]

    @property
    def satisfied(self) -> np.ndarray:
        """True for flights (rows, columns) without a crash that violate no requirement."""
        result: np.ndarray = ~self.metrics.crashed
        for name in self.requirements:
            result = result & ~(getattr(self.metrics, name) < 0.0)
        return result


def field_map(scenario: Scenario, x: str, y: str, *, size: int, compiled: bool = True) -> FieldMap:
    """Fly a scenario over a grid of two of its fields.

    The cells of the grid divide the distributions of the two fields equally. All other distributions are replaced by
    their medians. All flights have the wind and noise of the same sample.

    Args:
        scenario: scenario in which both fields are distributions, usually uniform ones.
        x: path of the field on the horizontal axis.
        y: path of the field on the vertical axis.
        size: number of cells along each axis.
        compiled: True to simulate with machine code, False for the uncompiled diagram.

    Raises:
        InputError: if the paths are equal, or a field is not a distribution.
    """
    distributions = distributions_in(scenario)
    if x == y:
        raise InputError(f"both axes of the map are {x}; name two different fields")
    for path in (x, y):
        if path not in distributions:
            names = join_names([*distributions])
            raise InputError(f"{path} is not a distribution of {scenario.name}; its distributions are {names}")
    evaluator = Evaluator(scenario, num_vehicles=min(size * size, _MAX_VEHICLES), compiled=compiled)
    centres = (np.arange(size) + 0.5) / size
    points = np.full((size * size, len(evaluator.names)), 0.5)
    points[:, evaluator.names.index(x)] = np.tile(centres, size)
    points[:, evaluator.names.index(y)] = np.repeat(centres, size)
    metrics = evaluator(points, scenario.sample or 0)
    columns, rows = (np.array([distributions[path].quantile(each) for each in centres]) for path in (x, y))
    grid = metrics.with_values(np.reshape(values, (size, size)) for values in metrics)
    return FieldMap(columns, rows, grid, tuple(scenario.requirements))
