"""Base class of state estimators, and their registry `ESTIMATORS`.

To add an estimator, extend `Estimator` and register the class with `ESTIMATORS.register`. Its system has an output port
`measurement`, and input ports with the names of sensors or `motion_capture`.
"""

from abc import abstractmethod
from typing import Annotated, Any, ClassVar

from drake_quad.framework.recipe import Recipe
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.unions import OpenUnion
from drake_quad.signals import State


class Estimator(Model):
    """State estimator, whose output is the measurement that the control and the autopilot use."""

    kind: str

    @property
    @abstractmethod
    def reads_motion_capture(self) -> bool:
        """True if the estimator uses the frames of motion capture."""

    @abstractmethod
    def recipe(self, scenario: Any, fleet: Any, start: State) -> Recipe | None:
        """Return the recipe for the estimators of a fleet; None if motion capture itself provides the measurement.

        Args:
            scenario: scenario, which determines the structure.
            fleet: scenario of the fleet, from a `Batch`.
            start: true state of the vehicles at time 0.
        """

    integrates_sensors: ClassVar = False
    """True if the measurement is an estimate from sensors on board, False if motion capture measures the state."""

    def names_of_sensors(self, laboratory: Any) -> list[str]:
        """Return the names of the sensors in a laboratory that the estimator reads."""
        return []

    def with_explicit_noise(self, laboratory: Any) -> "Estimator":
        """Return the estimator with its assumptions about sensor noise as settings.

        The estimator then keeps these assumptions if the noise is removed from the laboratory.
        """
        return self

    def in_hover(self) -> "Estimator":
        """Return the estimator without errors of its initial estimate."""
        return self

    def check_fits(self, scenario: Any) -> None:
        """Raise a validation error if the estimator does not fit the sensors of its `Scenario`."""


ESTIMATORS = OpenUnion(Estimator)
"""Registry of the kinds of state estimators."""

AnyEstimator = Annotated[Estimator, ESTIMATORS]
