"""Laws by which the weights of a fuzzy network learn."""

import math
from abc import abstractmethod
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from drake_quad.control.fuzzy.laws import CovarianceLaw, GradientLaw, LearningLimits, SignLaw
from drake_quad.control.fuzzy.systems import LearningNumbers
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.quantities import NonNegative, Number, Positive, bounded


class _Learning(Model):
    """Fields of all learning laws."""

    weight_limit: Positive | None = Field(
        default=None, description="largest size of a weight (m/s²); none if not given"
    )
    initial_weight: Number = Field(default=0.0, description="of all rules (m/s²)")
    leakage: NonNegative = Field(default=0.0, description="rate at which the weights decay by themselves (1/s)")

    @abstractmethod
    def law(self) -> Any:
        """Return a record of `drake_quad.control.fuzzy.laws`."""

    def numbers(self) -> LearningNumbers:
        """Return the numbers of the systems that learn by this law."""
        own: Any = self
        limit = math.inf if own.weight_limit is None else own.weight_limit
        return LearningNumbers(
            own.slope, self.law(), LearningLimits(limit, own.deadzone, own.leakage), own.initial_weight
        )


class _LearningFromEither(_Learning):
    """Fields of the laws that learn from s_p of eq (15) or from the feedback."""

    signal: Literal["surface", "feedback"] = Field(
        default="surface",
        description="what is learned from: s_p of eq (15) (m/s), or all feedback that the controller commands, its PD"
        " less the disturbance that it estimates, if any (m/s²), for which gains have other units",
    )
    slope: Positive = Field(default=1.0, description="λ of eq (15) (1/s); of no meaning with the feedback")
    deadzone: NonNegative = Field(default=0.0, description="size of the signal below which nothing is learned (m/s)")


class CovarianceLearning(_LearningFromEither):
    """The paper's law, eqs (15) to (17), with forgetting and resets as options."""

    kind: Literal["covariance"]
    gain: Positive = Field(default=1.0, description="K_D of eq (16) (1/s)")
    initial_covariance: Positive = Field(default=1.0, description="p₀ of P₀ = p₀ I (1/s)")
    forgetting: Annotated[Number, bounded(above=0.0, most=1.0)] = Field(
        default=1.0, description="factor for a tick (1); with less than 1 the covariance grows back, up to p₀"
    )
    reset: Literal["never", "at_segments"] = Field(
        default="never", description="when the covariance begins anew: never, as in the paper, or with every segment"
    )

    def law(self) -> CovarianceLaw:
        """Return the law of eqs (15) to (17)."""
        return CovarianceLaw(self.gain, self.initial_covariance, self.forgetting)


class GradientLearning(_LearningFromEither):
    """Eq (16) with a constant covariance."""

    kind: Literal["gradient"]
    rate: NonNegative = Field(default=1.0, description="K_D p (1/s²); with 0 what has been learned stays as it is")
    reset: ClassVar = "never"

    def law(self) -> GradientLaw:
        """Return the law with a constant covariance."""
        return GradientLaw(self.rate)


class SignLearning(_Learning):
    """Learning law that uses only the sign of the PD's command, with a slope that grows."""

    kind: Literal["sign"]
    rate: Positive = Field(default=1.0, description="γ by which the slope grows (1/s²)")
    initial_slope: NonNegative = Field(default=0.0, description="of the correction at the beginning (m/s³)")
    deadzone: NonNegative = Field(default=0.0, description="command below which nothing is learned (m/s²)")
    signal: ClassVar = "feedback"
    slope: ClassVar = 0.0
    reset: ClassVar = "never"

    def law(self) -> SignLaw:
        """Return the law with a slope that grows."""
        return SignLaw(self.rate, self.initial_slope)


Learning = Annotated[CovarianceLearning | GradientLearning | SignLearning, Field(discriminator="kind")]
