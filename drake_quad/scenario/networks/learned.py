"""Learned parameters of a fuzzy network, in the scenario language."""

import math
from typing import Annotated, Any, Literal, get_args

from pydantic import Field, model_validator

from drake_quad.control.fuzzy.inputs import InputName
from drake_quad.scenario.distributions import Model, Real, validation_error

Axis = Literal["x", "y", "z"]
AXES: tuple[Axis, ...] = get_args(Axis)


class LearnedAxis(Model):
    """Learned parameters of a network on one axis."""

    weights: Annotated[tuple[Real, ...], Field(strict=False)] = Field(description="weight F of each rule (m/s²)")
    antecedents: Annotated[tuple[Real, ...], Field(strict=False)] | None = Field(
        default=None,
        description="parameters of the membership functions, if they were learned, in the order of the signal"
        " `antecedents` (1)",
    )


class LearnedNetwork(Model):
    """Parameters that a network learned in a flight. `learned: FILE` reads a file written by `fly --save-network`."""

    kind: Literal["type_1", "type_2"] = Field(description="type of the network")
    inputs: Annotated[tuple[InputName, ...], Field(strict=False)] = Field(description="inputs of the network's rules")
    sets: Annotated[tuple[int, ...], Field(strict=False)] = Field(description="number of fuzzy sets of each input")
    x: LearnedAxis | None = Field(default=None, description="learned parameters on X")
    y: LearnedAxis | None = Field(default=None, description="learned parameters on Y")
    z: LearnedAxis | None = Field(default=None, description="learned parameters on Z")

    @property
    def axes(self) -> dict[Axis, LearnedAxis]:
        """Learned parameters of each axis that has a network."""
        return {axis: learned for axis in AXES if (learned := getattr(self, axis)) is not None}

    @model_validator(mode="after")
    def _is_complete(self) -> "LearnedNetwork":
        rules, parameters = math.prod(self.sets), 3 + sum(1 + 2 * count for count in self.sets)
        for axis, learned in self.axes.items():
            if len(learned.weights) != rules:
                raise self.field_error(f"must have {rules} numbers, one for each rule", axis, "weights")
            if learned.antecedents is not None and len(learned.antecedents) != parameters:
                raise self.field_error(f"must have {parameters} numbers", axis, "antecedents")
        if len({learned.antecedents is None for learned in self.axes.values()}) > 1:
            raise validation_error("must have antecedents on all axes or on none")
        return self


def allow_file_name(schema: dict[str, Any]) -> None:
    """Allow a file name in the JSON schema of a field, since its content can be read from a file."""
    if "anyOf" not in schema:
        schema["anyOf"] = [{key: schema.pop(key) for key in ("type", "items") if key in schema}]
    schema["anyOf"].insert(0, {"type": "string"})
