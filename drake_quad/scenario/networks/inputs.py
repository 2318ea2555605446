"""Inputs of a fuzzy network's rules, and their fuzzy sets."""

import itertools
import math
from typing import Annotated, get_args

from pydantic import Field, model_validator

from drake_quad.control.fuzzy import inference
from drake_quad.control.fuzzy.inputs import InputName
from drake_quad.scenario.distributions import Model, Real, validation_error
from drake_quad.scenario.limits import MAX_RULES, MAX_SETS
from drake_quad.scenario.quantities import Positive, extremes

_Centres = Annotated[tuple[Real, ...], Field(strict=False, min_length=2, max_length=MAX_SETS)]
_Widths = Annotated[tuple[Positive, ...], Field(strict=False)]


class InputSets(Model):
    """The fuzzy sets of one input of a network."""

    scale: Positive = Field(default=1.0, description="factor by which the input is multiplied (1 over its unit)")
    centres: _Centres = Field(
        default=(-1.0, 0.0, 1.0),
        description="centre c of each fuzzy set, ascending (1); inputs are clipped to the range of the centres",
    )
    widths: _Widths = Field(default=(1.0, 1.0, 1.0), description="width d of each fuzzy set (1)")

    @model_validator(mode="after")
    def _sets_overlap(self) -> "InputSets":
        if any(not low < high for low, high in itertools.pairwise(self.centres)):
            raise self.field_error("must be ascending", "centres")
        if len(self.widths) != len(self.centres):
            raise self.field_error(f"must have {len(self.centres)} numbers, one for each centre", "widths")
        sets = [(centre, extremes(width)[0]) for centre, width in zip(self.centres, self.widths, strict=True)]
        for i, ((left, reach_right), (right, reach_left)) in enumerate(itertools.pairwise(self._neighbours(sets))):
            if reach_right is None or reach_left is None or not left + reach_right > right - reach_left:
                demand = f"must be larger, so that the sets at {left} and {right} overlap and a rule fires in between"
                raise self.field_error(demand, "widths", i)
        return self

    def record(self) -> inference.Sets:
        """Return the fuzzy sets as parameters for the systems of a network."""
        return inference.FuzzySets(self.scale, tuple(self.centres), tuple(self.widths))

    def _neighbours(self, sets: list[tuple[float, float | None]]) -> list[tuple[float, float | None]]:
        """Return the sets in an order in which each must overlap the next.

        Args:
            sets: centre and smallest width of each set.
        """
        return sets


class CircularInputSets(InputSets):
    """The fuzzy sets of a periodic input, for which 0 and 1 are equivalent."""

    scale: Positive = Field(
        default=1.0, description="factor by which the input is multiplied; it is also the period of the centres"
    )
    centres: _Centres = Field(
        default=(0.0, 0.25, 0.5, 0.75), description="centre c of each fuzzy set, ascending, within one period (1)"
    )
    widths: _Widths = Field(default=(0.25, 0.25, 0.25, 0.25), description="width d of each fuzzy set (1)")

    def record(self) -> inference.Sets:
        """Return the fuzzy sets as parameters for the systems of a network."""
        return inference.CircularSets(self.scale, tuple(self.centres), tuple(self.widths))

    def _neighbours(self, sets: list[tuple[float, float | None]]) -> list[tuple[float, float | None]]:
        (first, width), *_ = sets
        (shortest, longest), last = extremes(self.scale), self.centres[-1]
        if shortest is None or longest is None or not last - first < shortest:
            raise self.field_error("must span less than one period, which is the value of scale", "centres")
        return [*sets, (first + longest, width)]


class NetworkInputs(Model):
    """One to four inputs of a network with their fuzzy sets. Each combination of sets has a rule."""

    error: InputSets | None = Field(default=None, description="position error e on the axis of the network (m)")
    error_rate: InputSets | None = Field(default=None, description="velocity error ė on the axis of the network (m/s)")
    x: InputSets | None = Field(default=None, description="measured position along X of W (m)")
    y: InputSets | None = Field(default=None, description="measured position along Y of W (m)")
    z: InputSets | None = Field(default=None, description="measured position along Z of W (m)")
    v_x: InputSets | None = Field(default=None, description="measured velocity along X of W (m/s)")
    v_y: InputSets | None = Field(default=None, description="measured velocity along Y of W (m/s)")
    v_z: InputSets | None = Field(default=None, description="measured velocity along Z of W (m/s)")
    phase: CircularInputSets | None = Field(
        default=None,
        description="fraction of the lap, or of a route without laps, that has passed according to the plan (1); 0 and"
        " 1 are equivalent",
    )
    disturbance: InputSets | None = Field(
        default=None, description="disturbance estimated by the controller on the axis of the network (m/s²)"
    )

    @property
    def specified(self) -> dict[InputName, InputSets]:
        """Inputs of the network, in the order in which its rules use them."""
        return {name: sets for name in _INPUT_NAMES if (sets := getattr(self, name)) is not None}

    @model_validator(mode="after")
    def _has_one_to_four_inputs(self) -> "NetworkInputs":
        specified = self.specified
        if not 1 <= len(specified) <= 4:
            raise validation_error("must have one to four of the inputs " + ", ".join(_INPUT_NAMES))
        rules = math.prod(len(sets.centres) for sets in specified.values())
        if rules > MAX_RULES:
            raise validation_error(f"must result in at most {MAX_RULES} rules, not {rules}; use fewer sets")
        return self


_INPUT_NAMES: tuple[InputName, ...] = get_args(InputName)
