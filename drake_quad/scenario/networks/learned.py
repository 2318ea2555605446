"""Learned parameters of a fuzzy network."""

import math
from typing import Annotated, Any, Literal, get_args

from pydantic import Field, model_validator

from drake_quad.control.fuzzy.inputs import InputName
from drake_quad.scenario.distributions import Model, Real, refused

Axis = Literal["x", "y", "z"]
AXES: tuple[Axis, ...] = get_args(Axis)


class LearnedAxis(Model):
    """Learned parameters of a network on one axis."""

    weights: Annotated[tuple[Real, ...], Field(strict=False)] = Field(description="F, one a rule (m/s²)")
    antecedents: Annotated[tuple[Real, ...], Field(strict=False)] | None = Field(
        default=None, description="numbers of the sets, if they have learned, as the signal of that name has them (1)"
    )


class LearnedNetwork(Model):
    """Parameters that a network learned in a flight; `learned: FILE` reads a file that `fly --save-network` wrote."""

    kind: Literal["type_1", "type_2"] = Field(description="type of the network")
    inputs: Annotated[tuple[InputName, ...], Field(strict=False)] = Field(description="what its rules look at")
    sets: Annotated[tuple[int, ...], Field(strict=False)] = Field(description="number of sets of each input")
    x: LearnedAxis | None = Field(default=None, description="on X")
    y: LearnedAxis | None = Field(default=None, description="on Y")
    z: LearnedAxis | None = Field(default=None, description="on Z")

    @property
    def axes(self) -> dict[Axis, LearnedAxis]:
        """Learned parameters by axis."""
        return {axis: known for axis in AXES if (known := getattr(self, axis)) is not None}

    @model_validator(mode="after")
    def _complete(self) -> "LearnedNetwork":
        rules, numbers = math.prod(self.sets), 3 + sum(1 + 2 * count for count in self.sets)
        for axis, known in self.axes.items():
            if len(known.weights) != rules:
                raise self.wrong(f"must be {rules} numbers", axis, "weights")
            if known.antecedents is not None and len(known.antecedents) != numbers:
                raise self.wrong(f"must be {numbers} numbers", axis, "antecedents")
        if len({known.antecedents is None for known in self.axes.values()}) > 1:
            raise refused("must have antecedents on all axes or on none")
        return self


def or_file(schema: dict[str, Any]) -> None:
    """Add to a schema that the name of a file may stand for its content, which loading inserts."""
    schema["anyOf"].insert(0, {"type": "string"})
