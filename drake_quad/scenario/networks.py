"""Networks of the scenario language: they stand around a controller and learn what it should have commanded."""

import itertools
import math
from typing import Annotated, Any, Literal, get_args

from pydantic import Field, field_validator, model_validator
from pydantic_core import PydanticCustomError

from drake_quad.control.fuzzy.adaptation import Part
from drake_quad.control.fuzzy.inputs import InputName
from drake_quad.scenario.distributions import Model, Real
from drake_quad.scenario.limits import MOST_RULES, MOST_SETS
from drake_quad.scenario.quantities import NonNegative, Number, Positive, Probability, bounded, extremes

Axis = Literal["x", "y", "z"]
_AXES: tuple[Axis, ...] = get_args(Axis)
Axes = Annotated[tuple[Axis, ...], Field(strict=False, min_length=1)]


_Centres = Annotated[tuple[Real, ...], Field(strict=False, min_length=2, max_length=MOST_SETS)]
_Widths = Annotated[tuple[Positive, ...], Field(strict=False)]


class FuzzySets(Model):
    """The fuzzy sets of one input of a network."""

    scale: Positive = Field(default=1.0, description="that the input is multiplied with (1 over its unit)")
    centres: _Centres = Field(
        default=(-1.0, 0.0, 1.0), description="c of each set, ascending (1); inputs are clamped to the first and last"
    )
    widths: _Widths = Field(default=(1.0, 1.0, 1.0), description="d of each set (1)")

    @field_validator("centres")
    @classmethod
    def _ascending(cls, centres: tuple[float, ...]) -> tuple[float, ...]:
        if any(not low < high for low, high in itertools.pairwise(centres)):
            raise PydanticCustomError("order", "must rise from one to the next")
        return centres

    @model_validator(mode="after")
    def _covered(self) -> "FuzzySets":
        if len(self.widths) != len(self.centres):
            raise self.wrong(
                "widths", kind="widths", demand="must be as many as centres, {count}", count=len(self.centres)
            )
        ends = [(centre, extremes(width)[0]) for centre, width in zip(self.centres, self.widths, strict=True)]
        for i, ((left, reach_right), (right, reach_left)) in enumerate(itertools.pairwise(self._closed(ends))):
            if reach_right is None or reach_left is None or not left + reach_right > right - reach_left:
                raise self.wrong(
                    "widths",
                    i,
                    kind="cover",
                    demand="must be wide enough that the sets at {left} and {right} overlap,"
                    " or no rule fires in between",
                    left=left,
                    right=right,
                )
        return self

    def _closed(self, ends: list[tuple[float, float | None]]) -> list[tuple[float, float | None]]:
        """Centres and least widths of all sets whose neighbours must overlap."""
        return ends


class CircularSets(FuzzySets):
    """The fuzzy sets of an input that goes around a circle: 0 and 1 are one place."""

    scale: Positive = Field(
        default=1.0, description="that the input is multiplied with: centres that far apart are one"
    )
    centres: _Centres = Field(default=(0.0, 0.25, 0.5, 0.75), description="c of each set, ascending, within a turn (1)")
    widths: _Widths = Field(default=(0.25, 0.25, 0.25, 0.25), description="d of each set (1)")

    def _closed(self, ends: list[tuple[float, float | None]]) -> list[tuple[float, float | None]]:
        (first, width), *_ = ends
        (shortest, longest), last = extremes(self.scale), self.centres[-1]
        if shortest is None or longest is None or not last - first < shortest:
            raise self.wrong("centres", kind="turn", demand="must be less than a turn apart, which is the scale")
        return [*ends, (first + longest, width)]


class Inputs(Model):
    """What the rules of a network look at: the fuzzy sets of one to four inputs; there is a rule for every choice."""

    error: FuzzySets | None = Field(default=None, description="of e on the network's own axis (m)")
    error_rate: FuzzySets | None = Field(default=None, description="of ė on the network's own axis (m/s)")
    x: FuzzySets | None = Field(default=None, description="of the measured position along X of W (m)")
    y: FuzzySets | None = Field(default=None, description="along Y (m)")
    z: FuzzySets | None = Field(default=None, description="along Z (m)")
    v_x: FuzzySets | None = Field(default=None, description="of the measured velocity along X of W (m/s)")
    v_y: FuzzySets | None = Field(default=None, description="along Y (m/s)")
    v_z: FuzzySets | None = Field(default=None, description="along Z (m/s)")
    phase: CircularSets | None = Field(
        default=None,
        description="of the share of the lap, or of a route without laps, that should be over, 0 to 1 (1); these are"
        " one place",
    )
    disturbance: FuzzySets | None = Field(
        default=None, description="of the disturbance on the network's own axis that the controller estimates (m/s²)"
    )

    @property
    def given(self) -> dict[InputName, FuzzySets]:
        """The inputs that there are, in the order in which rules take them."""
        return {name: sets for name in _INPUT_NAMES if (sets := getattr(self, name)) is not None}

    @model_validator(mode="after")
    def _some(self) -> "Inputs":
        given = self.given
        if not 1 <= len(given) <= 4:
            demand = "must be one to four of {names}"
            raise PydanticCustomError("inputs", demand, {"names": ", ".join(_INPUT_NAMES)})
        rules = math.prod(len(sets.centres) for sets in given.values())
        if rules > MOST_RULES:
            numbers = {"most": MOST_RULES, "rules": rules}
            raise PydanticCustomError("rules", "must make at most {most} rules, not {rules}", numbers)
        return self


_INPUT_NAMES: tuple[InputName, ...] = get_args(InputName)


class _Learning(Model):
    """What all laws have in common."""

    weight_limit: Positive | None = Field(
        default=None, description="largest size of a weight (m/s²); none if not given"
    )
    initial_weight: Number = Field(default=0.0, description="of all rules (m/s²)")
    leakage: NonNegative = Field(default=0.0, description="rate at which the weights decay by themselves (1/s)")


class _LearningFromEither(_Learning):
    """What the laws have in common that learn from s_p of eq (15), or from the feedback."""

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


class GradientLearning(_LearningFromEither):
    """Eq (16) with a constant covariance."""

    kind: Literal["gradient"]
    rate: NonNegative = Field(default=1.0, description="K_D p (1/s²); with 0 what has been learned stays as it is")


class SignLearning(_Learning):
    """By the sign of the PD's command, with a slope that grows."""

    kind: Literal["sign"]
    rate: Positive = Field(default=1.0, description="γ by which the slope grows (1/s²)")
    initial_slope: NonNegative = Field(default=0.0, description="of the correction at the beginning (m/s³)")
    deadzone: NonNegative = Field(default=0.0, description="command below which nothing is learned (m/s²)")


Learning = Annotated[CovarianceLearning | GradientLearning | SignLearning, Field(discriminator="kind")]


class LearnedAxis(Model):
    """What a network has learned on one axis."""

    weights: Annotated[tuple[Real, ...], Field(strict=False)] = Field(description="F, one a rule (m/s²)")
    antecedents: Annotated[tuple[Real, ...], Field(strict=False)] | None = Field(
        default=None, description="numbers of the sets, if they have learned, as the signal of that name has them (1)"
    )


class LearnedNetwork(Model):
    """What a network has learned in a flight; `learned: FILE` reads it from what `simulate.py --save-network` wrote."""

    kind: Literal["type_1", "type_2"] = Field(description="type of the network")
    inputs: Annotated[tuple[InputName, ...], Field(strict=False)] = Field(description="what its rules look at")
    sets: Annotated[tuple[int, ...], Field(strict=False)] = Field(description="number of sets of each input")
    x: LearnedAxis | None = Field(default=None, description="on X")
    y: LearnedAxis | None = Field(default=None, description="on Y")
    z: LearnedAxis | None = Field(default=None, description="on Z")

    @property
    def axes(self) -> dict[Axis, LearnedAxis]:
        """What has been learned, by axis."""
        return {axis: known for axis in _AXES if (known := getattr(self, axis)) is not None}

    @model_validator(mode="after")
    def _complete(self) -> "LearnedNetwork":
        rules, numbers = math.prod(self.sets), 3 + sum(1 + 2 * count for count in self.sets)
        for axis, known in self.axes.items():
            if len(known.weights) != rules:
                raise self.wrong(axis, "weights", kind="learned", demand="must be {rules} numbers", rules=rules)
            if known.antecedents is not None and len(known.antecedents) != numbers:
                raise self.wrong(axis, "antecedents", kind="learned", demand="must be {count} numbers", count=numbers)
        if len({known.antecedents is None for known in self.axes.values()}) > 1:
            raise PydanticCustomError("learned", "must have antecedents on all axes or on none")
        return self


def or_file(schema: dict[str, Any]) -> None:
    """Tells editors that the name of a file stands for what is in it; loading puts that in its place."""
    schema["anyOf"].insert(0, {"type": "string"})


class _Network(Model):
    """What networks of both types have in common."""

    kind: Literal["type_1", "type_2"]
    axes: Axes = Field(default=("x", "y"), description="on which there is a network")
    inputs: Inputs = Field(
        default=Inputs(error=FuzzySets(), error_rate=FuzzySets()), description="what its rules look at"
    )
    lead: NonNegative = Field(
        default=0.0,
        description="time by which the correction is that of the place, and of the phase, where the vehicle will be:"
        " about the time from a command to what it does (s)",
    )
    learning: Learning = CovarianceLearning(kind="covariance")
    learned: LearnedNetwork | None = Field(
        default=None,
        description="file of what was learned before, beside the one that names it: where the flight begins from",
        json_schema_extra=or_file,
    )

    @model_validator(mode="after")
    def _fits(self) -> "_Network":
        """What was learned before is of a network like this one."""
        if self.learned is None:
            return self
        own = {
            "kind": self.kind,
            "inputs": tuple(self.inputs.given),
            "sets": tuple([len(sets.centres) for sets in self.inputs.given.values()]),
            "axes": tuple(axis for axis in _AXES if axis in self.axes),
        }
        known = {name: getattr(self.learned, name) for name in ("kind", "inputs", "sets")}
        for name, value in {**known, "axes": tuple(self.learned.axes)}.items():
            if value != own[name]:
                words = {"name": name, "own": _words(own[name]), "learned": _words(value)}
                demand = "must be of a network of the same {name}: this one's are {own}, those learned on {learned}"
                raise self.wrong("learned", kind="learned", demand=demand, **words)
        return self


def _words(value: str | tuple[str | int, ...]) -> str:
    return value if isinstance(value, str) else ", ".join(map(str, value))


class AdaptiveTriangles(Model):
    """Rates at which membership functions learn, by the gradient of what the weights learn from; one at least."""

    centres: Positive | None = Field(
        default=None, description="of the inner centres (s²/m² for the surface, s³/m² for the feedback)"
    )
    widths: Positive | None = Field(default=None, description="of the widths (likewise)")

    @property
    def parts(self) -> tuple[Part, ...]:
        """What learns."""
        return tuple([part for part in get_args(Part) if getattr(self, part, None) is not None])

    @model_validator(mode="after")
    def _some(self) -> "AdaptiveTriangles":
        if not self.parts:
            names = " or ".join(type(self).model_fields)
            raise PydanticCustomError("parts", "must have a rate of {names}, or be null", {"names": names})
        return self


class AdaptiveEllipses(AdaptiveTriangles):
    """Rates at which membership functions of type 2 learn."""

    exponents: Positive | None = Field(default=None, description="of a1, a2 and q (likewise)")


class Type1Network(_Network):
    """A type-1 fuzzy neural network that learns in flight: its antecedents are triangles."""

    kind: Literal["type_1"]
    adaptive: AdaptiveTriangles | None = Field(default=None, description="how its memberships learn, if they do")


class Type2Network(_Network):
    """An interval type-2 fuzzy neural network that learns in flight: its antecedents lie between two ellipses."""

    kind: Literal["type_2"]
    a1: Annotated[Number, bounded(above=1.0)] = Field(default=1.2, description="exponent of the upper memberships (1)")
    a2: Annotated[Number, bounded(above=0.0, below=1.0)] = Field(
        default=0.8, description="exponent of the lower memberships (1)"
    )
    q: Probability = Field(default=0.5, description="share of the lower memberships in the output (1)")
    adaptive: AdaptiveEllipses | None = Field(default=None, description="how its memberships learn, if they do")


Network = Annotated[Type1Network | Type2Network, Field(discriminator="kind")]
