"""Fuzzy networks in the scenario language. They learn a correction to a controller's command during the flight."""

from collections.abc import Iterator, Mapping
from typing import Annotated, Any, ClassVar, Literal, get_args

from pydantic import Field, model_validator

from drake_quad.control.fuzzy.adaptation import AdaptationRates, Part
from drake_quad.control.fuzzy.inference import Antecedents
from drake_quad.control.fuzzy.inputs import InputName
from drake_quad.control.fuzzy.set_learning import AdaptationParameters, SetLearning
from drake_quad.control.fuzzy.systems import FuzzyRules, FuzzyRulesParameters, Lead, WeightLearning, build_fuzzy_network
from drake_quad.framework.recipe import Recipe
from drake_quad.framework.records import layout_of
from drake_quad.reference.plan import Plan
from drake_quad.scenario.distributions import Model, validation_error
from drake_quad.scenario.inactive import FlightConditions, InactiveSetting, is_set
from drake_quad.scenario.networks.inputs import InputSets, NetworkInputs
from drake_quad.scenario.networks.learned import AXES, Axis, LearnedAxis, LearnedNetwork, allow_file_name
from drake_quad.scenario.networks.learning import CovarianceLearning, Learning
from drake_quad.scenario.plausible import PLAUSIBLE_LAG
from drake_quad.scenario.quantities import NonNegative, Number, Positive, Probability, bounds, can_differ_from_zero

Axes = Annotated[tuple[Axis, ...], Field(strict=False, min_length=1)]

# Inputs that a network can predict, so that it uses their values one lead time ahead.
_PREDICTED_INPUTS: tuple[InputName, ...] = ("x", "y", "z", "phase")


class _Network(Model):
    """Fields that type-1 and type-2 networks share."""

    kind: Literal["type_1", "type_2"]
    axes: Axes = Field(default=("x", "y"), description="axes that have a network")
    inputs: NetworkInputs = Field(
        default=NetworkInputs(error=InputSets(), error_rate=InputSets()), description="inputs of the network's rules"
    )
    lead: Annotated[NonNegative, PLAUSIBLE_LAG] = Field(
        default=0.0,
        description="time by which the position and phase inputs are predicted (s); it should be about the delay from a"
        " command to its effect",
    )
    learning: Learning = CovarianceLearning(kind="covariance")
    learned: LearnedNetwork | None = Field(
        default=None,
        description="parameters at the start of the flight: a file written by `fly --save-network`, relative to the"
        " folder of the scenario's file",
        json_schema_extra=allow_file_name,
    )

    @model_validator(mode="after")
    def _learned_parameters_match(self) -> "_Network":
        """Raise an error if the learned parameters come from a network with a different structure."""
        if self.learned is None:
            return self
        expected = {
            "kind": self.kind,
            "inputs": tuple(self.inputs.specified),
            "sets": tuple([len(sets.centres) for sets in self.inputs.specified.values()]),
            "axes": tuple(axis for axis in AXES if axis in self.axes),
        }
        learned = {name: getattr(self.learned, name) for name in ("kind", "inputs", "sets")}
        for name, value in {**learned, "axes": tuple(self.learned.axes)}.items():
            if value != expected[name]:
                values = f"this network has {_listed(expected[name])}, the learned parameters have {_listed(value)}"
                raise self.field_error(f"must come from a network with the same {name}: {values}", "learned")
        return self

    def inactive_settings(self, flight: FlightConditions, path: str) -> Iterator[InactiveSetting]:
        """Yield settings without effect, such as initial weights that learned weights replace."""
        yield from super().inactive_settings(flight, path)
        if is_set(self, "lead") and not {*_PREDICTED_INPUTS} & self.inputs.specified.keys():
            yield InactiveSetting(f"{path}.lead", f"{path}.inputs has none of {', '.join(_PREDICTED_INPUTS)}")
        if self.learned is not None and is_set(self.learning, "initial_weight"):
            yield InactiveSetting(f"{path}.learning.initial_weight", f"{path}.learned is given")
        if self.learned is None and not self.learning.can_change_weights():
            yield InactiveSetting(path, f"{path}.learning.rate and {path}.learning.initial_weight are 0")

    def antecedents(self) -> Antecedents:
        """Return the parameters of the membership functions of all inputs."""
        settings: Any = self
        return Antecedents(
            settings.a1, settings.a2, settings.q, tuple([sets.record() for sets in self.inputs.specified.values()])
        )

    def recipes(self, period: float, plan: Plan) -> dict[str, Recipe]:
        """Return the recipes to build the systems of the network, by their paths in the diagram of the control.

        Args:
            period: period of the control, s.
            plan: plan that is flown. Its laps determine the phase, and its segments determine the covariance resets.
        """
        axes = tuple([axis for axis in AXES if axis in self.axes])
        learned = () if self.learned is None else tuple(self.learned.axes.values())
        sets, initial = self.antecedents(), self._initial_antecedents(learned)
        leads, parameters, inputs = (
            can_differ_from_zero(self.lead),
            self.learning.parameters(),
            tuple(self.inputs.specified),
        )
        timing = {"period": period, "axes": axes, "learns_from": self.learning.signal}
        observed = {"axes": axes, "inputs": inputs, "lap_times": plan.lap_times if "phase" in inputs else ()}
        settings: Any = self
        adaptive: AdaptiveTriangles | None = settings.adaptive
        rules = {**observed, "adaptive": adaptive is not None, "leads": leads}
        learning = {
            **timing,
            "num_rules": sets.num_rules,
            "leads": leads,
            "reset_times": tuple(plan.leg_times[1:]) if self.learning.reset == "at_segments" else (),
            "initial_weights": tuple([each.weights for each in learned]),
        }
        recipes = {
            "network.rules": Recipe(FuzzyRules, rules, FuzzyRulesParameters(initial, Lead(self.lead))),
            "network.learning": Recipe(WeightLearning, learning, parameters),
        }
        if adaptive is not None:
            rates = AdaptationRates(**{part: getattr(adaptive, part) for part in adaptive.parts})
            adaptation = AdaptationParameters(initial * len(axes) if len(initial) == 1 else initial, rates, parameters)
            recipes["network.sets"] = Recipe(SetLearning, {**timing, **observed, "parts": adaptive.parts}, adaptation)
        return recipes

    def build(self, systems: Mapping[str, Any]) -> Any:
        """Return the diagram of the network, from the systems built from its recipes."""
        return build_fuzzy_network(**{name: systems.get(f"network.{name}") for name in ("rules", "learning", "sets")})

    def _initial_antecedents(self, learned: tuple[LearnedAxis, ...]) -> tuple[Antecedents, ...]:
        """Return the initial antecedents: one item for all axes, or one for each axis if they were learned."""
        sets = self.antecedents()
        if all(each.antecedents is None for each in learned):
            return (sets,)
        layout = layout_of(Antecedents, sets)
        return tuple([layout.build(each.antecedents or ()) for each in learned])


def _listed(value: str | tuple[str | int, ...]) -> str:
    return value if isinstance(value, str) else ", ".join(map(str, value))


class AdaptiveTriangles(Model):
    """Learning rates of triangular membership functions. At least one rate must be given.

    The membership functions learn by gradient descent, from the same signal as the weights.
    """

    centres: Positive | None = Field(
        default=None,
        description="learning rate of the inner centres (s²/m² for signal surface, s³/m² for signal feedback)",
    )
    widths: Positive | None = Field(
        default=None, description="learning rate of the widths (s²/m² for the surface, s³/m² for the feedback)"
    )

    @property
    def parts(self) -> tuple[Part, ...]:
        """Parts of the membership functions for which a learning rate is given."""
        return tuple([part for part in get_args(Part) if getattr(self, part, None) is not None])

    @model_validator(mode="after")
    def _has_a_rate(self) -> "AdaptiveTriangles":
        if not self.parts:
            names = " or ".join(type(self).model_fields)
            raise validation_error(f"must contain at least one learning rate, {names}, or be null")
        return self


class AdaptiveEllipses(AdaptiveTriangles):
    """Learning rates of elliptic (type-2) membership functions."""

    exponents: Positive | None = Field(
        default=None, description="learning rate of a1, a2 and q (s²/m² for the surface, s³/m² for the feedback)"
    )


class Type1Network(_Network):
    """A type-1 fuzzy neural network that learns in flight, with triangular membership functions."""

    kind: Literal["type_1"]
    adaptive: AdaptiveTriangles | None = Field(
        default=None, description="learning rates of the membership functions; they do not learn if not given"
    )
    # With these parameters the upper and the lower membership functions are the same triangle.
    a1: ClassVar = 1.0
    a2: ClassVar = 1.0
    q: ClassVar = 0.0


class Type2Network(_Network):
    """An interval type-2 fuzzy neural network that learns in flight, with elliptic membership functions."""

    kind: Literal["type_2"]
    a1: Annotated[Number, bounds(gt=1.0)] = Field(
        default=1.2, description="exponent of the upper membership functions (1)"
    )
    a2: Annotated[Number, bounds(gt=0.0, lt=1.0)] = Field(
        default=0.8, description="exponent of the lower membership functions (1)"
    )
    q: Probability = Field(default=0.5, description="weight of the lower membership functions in the output (1)")
    adaptive: AdaptiveEllipses | None = Field(
        default=None, description="learning rates of the membership functions; they do not learn if not given"
    )


Network = Annotated[Type1Network | Type2Network, Field(discriminator="kind")]
