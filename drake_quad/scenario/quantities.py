"""Physical quantities of the scenario language: numbers with bounds, or distributions within them."""

from typing import Annotated

from pydantic import AfterValidator, Field
from pydantic_core import PydanticCustomError

from drake_quad.scenario.distributions import NumberOrDistribution


def bounded(*, above: float | None = None, least: float | None = None, below: float | None = None) -> AfterValidator:
    """A validator that holds a number, or all that a distribution can give, to bounds."""
    demands = [
        f"{words} {bound:g}"
        for words, bound in (("larger than", above), ("at least", least), ("smaller than", below))
        if bound is not None
    ]

    def check(value: NumberOrDistribution) -> NumberOrDistribution:
        lowest, highest = (value, value) if isinstance(value, float) else value.extremes()
        fits = (
            (above is None or (lowest is not None and lowest > above))
            and (least is None or (lowest is not None and lowest >= least))
            and (below is None or (highest is not None and highest < below))
        )
        if not fits:
            raise PydanticCustomError("bounds", "must be {demands}", {"demands": " and ".join(demands)})
        return value

    return AfterValidator(check)


Number = NumberOrDistribution
Positive = Annotated[NumberOrDistribution, bounded(above=0.0)]
NonNegative = Annotated[NumberOrDistribution, bounded(least=0.0)]
Period = Annotated[float, Field(gt=0.0)]
Position = Annotated[tuple[Number, Number, Number], Field(strict=False)]
Gains = Annotated[tuple[NonNegative, NonNegative, NonNegative], Field(strict=False)]
