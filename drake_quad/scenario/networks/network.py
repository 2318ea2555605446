"""Fuzzy networks of the scenario language: they stand around a controller and learn what it should have commanded."""

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal, get_args

from pydantic import Field, model_validator

from drake_quad.control.fuzzy.adaptation import AdaptationRates, Part
from drake_quad.control.fuzzy.inference import Antecedents
from drake_quad.control.fuzzy.set_learning import AdaptationNumbers, SetLearning
from drake_quad.control.fuzzy.systems import FuzzyRules, Lead, RulesNumbers, WeightLearning, build_fuzzy_network
from drake_quad.framework.recipe import Recipe
from drake_quad.framework.records import layout_of
from drake_quad.reference.plan import Plan
from drake_quad.scenario.distributions import Model, refused
from drake_quad.scenario.networks.inputs import InputSets, NetworkInputs
from drake_quad.scenario.networks.learned import AXES, Axis, LearnedAxis, LearnedNetwork, or_file
from drake_quad.scenario.networks.learning import CovarianceLearning, Learning
from drake_quad.scenario.quantities import NonNegative, Number, Positive, Probability, bounded, can_differ_from_zero

Axes = Annotated[tuple[Axis, ...], Field(strict=False, min_length=1)]


class _Network(Model):
    """Fields of networks of both types."""

    kind: Literal["type_1", "type_2"]
    axes: Axes = Field(default=("x", "y"), description="on which there is a network")
    inputs: NetworkInputs = Field(
        default=NetworkInputs(error=InputSets(), error_rate=InputSets()), description="what its rules look at"
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
        """Raise an error if the parameters were learned by a network with another structure."""
        if self.learned is None:
            return self
        own = {
            "kind": self.kind,
            "inputs": tuple(self.inputs.given),
            "sets": tuple([len(sets.centres) for sets in self.inputs.given.values()]),
            "axes": tuple(axis for axis in AXES if axis in self.axes),
        }
        known = {name: getattr(self.learned, name) for name in ("kind", "inputs", "sets")}
        for name, value in {**known, "axes": tuple(self.learned.axes)}.items():
            if value != own[name]:
                words = f"this one's are {_words(own[name])}, those learned on {_words(value)}"
                raise self.wrong(f"must be of a network of the same {name}: {words}", "learned")
        return self

    def antecedents(self) -> Antecedents:
        """Return the sets of all inputs, and the exponents of their memberships."""
        own: Any = self
        return Antecedents(own.a1, own.a2, own.q, tuple([sets.record() for sets in self.inputs.given.values()]))

    def recipes(self, period: float, plan: Plan) -> dict[str, Recipe]:
        """Return the recipes for the systems of the network, by their paths in the diagram of the control.

        Args:
            period: period of the control, s.
            plan: plan that is flown, whose laps and segments the network may know.
        """
        axes = tuple([axis for axis in AXES if axis in self.axes])
        known = () if self.learned is None else tuple(self.learned.axes.values())
        sets, begun = self.antecedents(), self._begun(known)
        leads, numbers, inputs = can_differ_from_zero(self.lead), self.learning.numbers(), tuple(self.inputs.given)
        timing = {"period": period, "axes": axes, "learns_from": self.learning.signal}
        looks_at = {"axes": axes, "inputs": inputs, "lap_times": plan.lap_times if "phase" in inputs else ()}
        own: Any = self
        adaptive: AdaptiveTriangles | None = own.adaptive
        rules = {**looks_at, "adaptive": adaptive is not None, "leads": leads}
        learning = {
            **timing,
            "num_rules": sets.num_rules,
            "leads": leads,
            "reset_times": tuple(plan.leg_times[1:]) if self.learning.reset == "at_segments" else (),
            "initial_weights": tuple([each.weights for each in known]),
        }
        recipes = {
            "network.rules": Recipe(FuzzyRules, rules, RulesNumbers(begun, Lead(self.lead))),
            "network.learning": Recipe(WeightLearning, learning, numbers),
        }
        if adaptive is not None:
            rates = AdaptationRates(**{part: getattr(adaptive, part) for part in adaptive.parts})
            adaptation = AdaptationNumbers(begun * len(axes) if len(begun) == 1 else begun, rates, numbers)
            recipes["network.sets"] = Recipe(SetLearning, {**timing, **looks_at, "parts": adaptive.parts}, adaptation)
        return recipes

    def build(self, systems: Mapping[str, Any]) -> Any:
        """Return the diagram of the systems that the recipes made."""
        return build_fuzzy_network(**{name: systems.get(f"network.{name}") for name in ("rules", "learning", "sets")})

    def _begun(self, known: tuple[LearnedAxis, ...]) -> tuple[Antecedents, ...]:
        """Return the antecedents at the beginning: one for all axes, or for each axis if its sets have learned."""
        sets = self.antecedents()
        if all(each.antecedents is None for each in known):
            return (sets,)
        layout = layout_of(Antecedents, sets)
        return tuple([layout.build(each.antecedents or ()) for each in known])


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
        """Parts of the membership functions that learn."""
        return tuple([part for part in get_args(Part) if getattr(self, part, None) is not None])

    @model_validator(mode="after")
    def _some(self) -> "AdaptiveTriangles":
        if not self.parts:
            names = " or ".join(type(self).model_fields)
            raise refused(f"must have a rate of {names}, or be null")
        return self


class AdaptiveEllipses(AdaptiveTriangles):
    """Rates at which membership functions of type 2 learn."""

    exponents: Positive | None = Field(default=None, description="of a1, a2 and q (likewise)")


class Type1Network(_Network):
    """A type-1 fuzzy neural network that learns in flight: its antecedents are triangles."""

    kind: Literal["type_1"]
    adaptive: AdaptiveTriangles | None = Field(
        default=None, description="how its memberships learn, if they do"
    )  # Triangles, of which upper and lower ones are the same.
    a1: ClassVar = 1.0
    a2: ClassVar = 1.0
    q: ClassVar = 0.0


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
