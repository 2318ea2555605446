"""Measurement by motion capture alone, in the scenario language."""

from typing import Any, ClassVar, Literal

from drake_quad.framework.recipe import Recipe
from drake_quad.scenario.estimators.estimator import ESTIMATORS, Estimator
from drake_quad.signals import State


@ESTIMATORS.register
class MotionCaptureEstimator(Estimator):
    """No estimator: the measurement is the state that motion capture measures, as in the paper."""

    kind: Literal["motion_capture"]
    reads_motion_capture: ClassVar = True

    def recipe(self, scenario: Any, fleet: Any, start: State) -> Recipe | None:
        """Return None, since motion capture provides the measurement."""
        return None
