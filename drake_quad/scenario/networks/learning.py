"""Learning laws for the weights of a fuzzy network, in the scenario language."""

import math
from abc import abstractmethod
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from drake_quad.control.fuzzy.laws import CovarianceLaw, GradientLaw, LearningLimits, SignLaw
from drake_quad.control.fuzzy.systems import LearningParameters
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.inactive import can_have_effect, needs
from drake_quad.scenario.quantities import NonNegative, Number, Positive, bounds


class _Learning(Model):
    """Fields that all learning laws share."""

    weight_limit: Positive | None = Field(
        default=None, description="largest magnitude of a weight (m/s²); no limit if not given"
    )
    initial_weight: Number = Field(default=0.0, description="initial weight of all rules (m/s²)")
    leakage: NonNegative = Field(default=0.0, description="rate at which the weights decay without an error (1/s)")

    @abstractmethod
    def law(self) -> Any:
        """Return the law as a named tuple of `drake_quad.control.fuzzy.laws`."""

    def can_change_weights(self) -> bool:
        """Return whether any weight of the network can become nonzero."""
        return True

    def parameters(self) -> LearningParameters:
        """Return the parameters of the systems that implement this law."""
        settings: Any = self
        limit = math.inf if settings.weight_limit is None else settings.weight_limit
        return LearningParameters(
            settings.slope,
            self.law(),
            LearningLimits(limit, settings.deadzone, settings.leakage),
            settings.initial_weight,
        )


class _LearningFromEither(_Learning):
    """Fields of the laws that learn either from s_p of eq (15) of the paper or from the feedback command."""

    signal: Literal["surface", "feedback"] = Field(
        default="surface",
        description="signal from which the network learns: s_p of eq (15) (m/s), or the whole feedback of the"
        " controller, the PD command minus any estimated disturbance (m/s²), for which the gains have different units",
    )
    slope: Annotated[Positive, needs("signal", value="surface")] = Field(
        default=1.0, description="λ of eq (15) (1/s); not used with the feedback"
    )
    deadzone: NonNegative = Field(
        default=0.0, description="magnitude of the signal below which the network does not learn (m/s)"
    )


class CovarianceLearning(_LearningFromEither):
    """The paper's learning law, eqs (15) to (17), with optional forgetting and covariance resets."""

    kind: Literal["covariance"]
    gain: Positive = Field(default=1.0, description="gain K_D of eq (16) (1/s)")
    initial_covariance: Positive = Field(default=1.0, description="p₀ of the initial covariance P₀ = p₀ I (1/s)")
    forgetting: Annotated[Number, bounds(gt=0.0, le=1.0)] = Field(
        default=1.0, description="forgetting factor per tick (1); below 1, the covariance grows again, up to p₀"
    )
    reset: Literal["never", "at_segments"] = Field(
        default="never",
        description="time at which the covariance is reset: never, as in the paper, or at the start of every segment",
    )

    def law(self) -> CovarianceLaw:
        """Return the learning law of eqs (15) to (17) of the paper."""
        return CovarianceLaw(self.gain, self.initial_covariance, self.forgetting)


class GradientLearning(_LearningFromEither):
    """Eq (16) with a constant covariance."""

    kind: Literal["gradient"]
    rate: NonNegative = Field(default=1.0, description="rate K_D p (1/s²); with 0, the network stops learning")
    reset: ClassVar = "never"

    def can_change_weights(self) -> bool:
        """Return whether the rate or the initial weight can differ from zero."""
        return can_have_effect((self.rate, self.initial_weight))

    def law(self) -> GradientLaw:
        """Return the learning law with a constant covariance."""
        return GradientLaw(self.rate)


class SignLearning(_Learning):
    """Learning law that uses only the sign of the PD command. The rate of change of the correction grows with time."""

    kind: Literal["sign"]
    rate: Positive = Field(default=1.0, description="growth rate γ of the rate of change of the correction (1/s²)")
    initial_slope: NonNegative = Field(default=0.0, description="initial rate of change of the correction (m/s³)")
    deadzone: NonNegative = Field(
        default=0.0, description="magnitude of the command below which the network does not learn (m/s²)"
    )
    signal: ClassVar = "feedback"
    slope: ClassVar = 0.0
    reset: ClassVar = "never"

    def law(self) -> SignLaw:
        """Return the learning law that uses only the sign of the command."""
        return SignLaw(self.rate, self.initial_slope)


Learning = Annotated[CovarianceLearning | GradientLearning | SignLearning, Field(discriminator="kind")]
