"""Inputs of the rules of a fuzzy network, and their fuzzy sets."""

import itertools
import math
from typing import Annotated, get_args

from pydantic import Field, model_validator

from drake_quad.control.fuzzy import inference
from drake_quad.control.fuzzy.inputs import InputName
from drake_quad.scenario.distributions import Model, Real, refused
from drake_quad.scenario.limits import MOST_RULES, MOST_SETS
from drake_quad.scenario.quantities import Positive, extremes

_Centres = Annotated[tuple[Real, ...], Field(strict=False, min_length=2, max_length=MOST_SETS)]
_Widths = Annotated[tuple[Positive, ...], Field(strict=False)]


class InputSets(Model):
    """The fuzzy sets of one input of a network."""

    scale: Positive = Field(default=1.0, description="that the input is multiplied with (1 over its unit)")
    centres: _Centres = Field(
        default=(-1.0, 0.0, 1.0), description="c of each set, ascending (1); inputs are clamped to the first and last"
    )
    widths: _Widths = Field(default=(1.0, 1.0, 1.0), description="d of each set (1)")

    @model_validator(mode="after")
    def _covered(self) -> "InputSets":
        if any(not low < high for low, high in itertools.pairwise(self.centres)):
            raise self.wrong("must rise from one to the next", "centres")
        if len(self.widths) != len(self.centres):
            raise self.wrong(f"must be as many as centres, {len(self.centres)}", "widths")
        ends = [(centre, extremes(width)[0]) for centre, width in zip(self.centres, self.widths, strict=True)]
        for i, ((left, reach_right), (right, reach_left)) in enumerate(itertools.pairwise(self._closed(ends))):
            if reach_right is None or reach_left is None or not left + reach_right > right - reach_left:
                demand = f"must be wide enough that the sets at {left} and {right} overlap, or no rule fires in between"
                raise self.wrong(demand, "widths", i)
        return self

    def record(self) -> inference.Sets:
        """Return the record that the systems of a network take."""
        return inference.FuzzySets(self.scale, tuple(self.centres), tuple(self.widths))

    def _closed(self, ends: list[tuple[float, float | None]]) -> list[tuple[float, float | None]]:
        """Centres and least widths of all sets whose neighbours must overlap."""
        return ends


class CircularInputSets(InputSets):
    """The fuzzy sets of an input that goes around a circle: 0 and 1 are one place."""

    scale: Positive = Field(
        default=1.0, description="that the input is multiplied with: centres that far apart are one"
    )
    centres: _Centres = Field(default=(0.0, 0.25, 0.5, 0.75), description="c of each set, ascending, within a turn (1)")
    widths: _Widths = Field(default=(0.25, 0.25, 0.25, 0.25), description="d of each set (1)")

    def record(self) -> inference.Sets:
        """Return the record that the systems of a network take."""
        return inference.CircularSets(self.scale, tuple(self.centres), tuple(self.widths))

    def _closed(self, ends: list[tuple[float, float | None]]) -> list[tuple[float, float | None]]:
        (first, width), *_ = ends
        (shortest, longest), last = extremes(self.scale), self.centres[-1]
        if shortest is None or longest is None or not last - first < shortest:
            raise self.wrong("must be less than a turn apart, which is the scale", "centres")
        return [*ends, (first + longest, width)]


class NetworkInputs(Model):
    """Inputs of a network, one to four, with their fuzzy sets; there is a rule for every combination of sets."""

    error: InputSets | None = Field(default=None, description="of e on the network's own axis (m)")
    error_rate: InputSets | None = Field(default=None, description="of ė on the network's own axis (m/s)")
    x: InputSets | None = Field(default=None, description="of the measured position along X of W (m)")
    y: InputSets | None = Field(default=None, description="along Y (m)")
    z: InputSets | None = Field(default=None, description="along Z (m)")
    v_x: InputSets | None = Field(default=None, description="of the measured velocity along X of W (m/s)")
    v_y: InputSets | None = Field(default=None, description="along Y (m/s)")
    v_z: InputSets | None = Field(default=None, description="along Z (m/s)")
    phase: CircularInputSets | None = Field(
        default=None,
        description="of the share of the lap, or of a route without laps, that should be over, 0 to 1 (1); these are"
        " one place",
    )
    disturbance: InputSets | None = Field(
        default=None, description="of the disturbance on the network's own axis that the controller estimates (m/s²)"
    )

    @property
    def given(self) -> dict[InputName, InputSets]:
        """The inputs that there are, in the order in which rules take them."""
        return {name: sets for name in _INPUT_NAMES if (sets := getattr(self, name)) is not None}

    @model_validator(mode="after")
    def _some(self) -> "NetworkInputs":
        given = self.given
        if not 1 <= len(given) <= 4:
            raise refused("must be one to four of " + ", ".join(_INPUT_NAMES))
        rules = math.prod(len(sets.centres) for sets in given.values())
        if rules > MOST_RULES:
            raise refused(f"must make at most {MOST_RULES} rules, not {rules}")
        return self


_INPUT_NAMES: tuple[InputName, ...] = get_args(InputName)
