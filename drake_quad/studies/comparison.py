"""Controllers side by side, on the same samples."""

from collections.abc import Callable, Sequence

from drake_quad.fleets.study_fleet import StudyFleet
from drake_quad.flight.mission import plan_route
from drake_quad.laboratory.metrics import Metrics
from drake_quad.scenario.models import Scenario


def fly_samples(
    scenario: Scenario,
    samples: Sequence[int],
    *,
    compiled: bool = True,
    progress: Callable[[float, float], None] | None = None,
) -> Metrics:
    """Flies samples of a scenario's study in one fleet and returns their metrics.

    Args:
        scenario: with or without distributions.
        samples: N numbers of samples.
        compiled: whether the diagram is compiled to machine code; else it flies as it is wired.
        progress: called now and then with the time flown and the time to fly, s.

    Returns:
        (N,) arrays of each metric.

    Raises:
        InputError: the route holds a distribution, or the rotors cannot fly it.
    """
    return StudyFleet(scenario, plan_route(scenario), len(samples), compiled=compiled).fly(samples, progress=progress)
