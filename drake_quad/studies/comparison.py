"""Function that flies selected samples of a study, so that several controllers can fly the same samples."""

from collections.abc import Callable, Sequence

from drake_quad.fleets.study_fleet import StudyFleet
from drake_quad.flight.mission import plan_route
from drake_quad.flight.simulation import fly_with_metrics
from drake_quad.laboratory.metrics import Metrics
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.models import Scenario


def fly_samples(
    scenario: Scenario,
    samples: Sequence[int],
    *,
    compiled: bool = True,
    progress: Callable[[float, float], None] | None = None,
) -> Metrics:
    """Fly samples of a scenario's study in one fleet and return their metrics.

    Args:
        scenario: scenario, with or without distributions.
        samples: indices of N samples.
        compiled: True to compile the diagram to machine code; False to simulate the uncompiled diagram.
        progress: function that is called repeatedly with the simulated time and the duration of the flight, s.

    Returns:
        (N,) values of each metric.

    Raises:
        InputError: if the route contains a distribution, or the rotors are too weak for it.
    """
    fleet = StudyFleet(scenario, plan_route(scenario), len(samples), compiled=compiled)
    return fly_with_metrics(fleet, Batch.draw(scenario, samples), progress)
