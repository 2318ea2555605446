"""Trained networks in the scenario language."""

import base64
import binascii
import functools
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from drake_quad.control.policy.network import WITH_ALPHA, Activation, Dense, Gru, Network
from drake_quad.framework.symbols import Matrix
from drake_quad.scenario.distributions import Model, Real, omits_defaults, validation_error
from drake_quad.scenario.limits import MAX_CHARACTERS, MAX_NETWORK_BYTES
from drake_quad.scenario.quantities import FixedPositive

# Number of inputs or outputs of a layer. In practice, MAX_NETWORK_BYTES limits the size of a network more tightly.
Rows = Annotated[int, Field(ge=1, le=4096)]
_Precision = Literal["single", "double"]
_DTYPES: dict[_Precision, np.dtype[Any]] = {"single": np.dtype("<f4"), "double": np.dtype("<f8")}


class DenseLayer(Model):
    """Dense layer of neurons, whose output is the activation of W x + b for an input x."""

    kind: Literal["dense"]
    inputs: Rows = Field(description="number of inputs")
    outputs: Rows = Field(description="number of outputs")
    activation: Activation = Field(default="identity", description="activation function of each output")
    alpha: Real | None = Field(
        default=None,
        description="parameter of elu, whose limit is -alpha (1 if not given), or of leaky_relu, the derivative for"
        " negative numbers (0.01 if not given)",
    )

    _serialized = omits_defaults("alpha")

    @model_validator(mode="after")
    def _has_its_parameter(self) -> "DenseLayer":
        if self.alpha is not None and self.activation not in WITH_ALPHA:
            raise self.field_error(f"must be left out with the activation {self.activation}", "alpha")
        return self

    @property
    def num_numbers(self) -> int:
        """Number of weights and biases."""
        return self.outputs * (self.inputs + 1)

    def layer(self, numbers: np.ndarray) -> Dense:
        """Return the layer, given its numbers in this order: the rows of W, then b."""
        weights, biases = np.split(numbers, [self.outputs * self.inputs])
        return Dense(Matrix(weights.reshape(self.outputs, self.inputs), biases), self.activation, self.alpha)


class GruLayer(Model):
    """Gated recurrent units. The reset gate multiplies the product of weights and hidden state."""

    kind: Literal["gru"]
    inputs: Rows = Field(description="number of inputs")
    outputs: Rows = Field(description="number of units")

    @property
    def num_numbers(self) -> int:
        """Number of weights, biases and elements of the initial hidden state."""
        return 3 * self.outputs * (self.inputs + self.outputs + 2) + self.outputs

    def layer(self, numbers: np.ndarray) -> Gru:
        """Return the layer, given its numbers in this order: W, b, U, c and the initial hidden state.

        W and b belong to the input, U and c to the hidden state. Each is stacked in the order reset gate, update gate,
        new gate.
        """
        gates = 3 * self.outputs
        ends = np.cumsum([gates * self.inputs, gates, gates * self.outputs, gates])
        weights, biases, memory_weights, memory_biases, initial = np.split(numbers, ends)
        return Gru(
            Matrix(weights.reshape(gates, -1), biases),
            Matrix(memory_weights.reshape(gates, -1), memory_biases),
            tuple(initial.tolist()),
        )


Layer = Annotated[DenseLayer | GruLayer, Field(discriminator="kind")]
_Numbers = Annotated[tuple[Real, ...], Field(strict=False)]


class TrainedNetwork(Model):
    """A trained network. `policy: FILE` reads it from an .npz or .onnx file."""

    layers: Annotated[tuple[Layer, ...], Field(strict=False, min_length=1, max_length=20)] = Field(
        description="layers in order, from input to output"
    )
    precision: _Precision = Field(default="single", description="precision of the numbers")
    numbers: Annotated[tuple[str, ...], Field(strict=False)] = Field(
        description="weights and biases of all layers in base 64, split into a list of texts"
    )
    offset: _Numbers | None = Field(
        default=None, description="number that is subtracted from each element of the input"
    )
    scale: _Numbers | None = Field(
        default=None, description="factor by which each element of the input is then multiplied"
    )
    limit: FixedPositive | None = Field(
        default=None,
        description="largest magnitude of each input element after scaling (1); null for no limit",
    )

    @classmethod
    def of(cls, layers: tuple[Any, ...], numbers: np.ndarray, **preprocessing: Any) -> "TrainedNetwork":
        """Return a network with given weights and biases, stored in single precision if that is exact.

        Args:
            layers: value of the field `layers`.
            numbers: weights, biases and initial hidden states of all layers, one layer after another.
            preprocessing: `offset`, `scale` and `limit`, if given.
        """
        with np.errstate(over="ignore"):  # numbers that overflow become infinite, and the comparison fails
            precision: _Precision = "single" if (numbers.astype("<f4") == numbers).all() else "double"
        text = base64.b64encode(numbers.astype(_DTYPES[precision]).tobytes()).decode("ascii")
        pieces = tuple([text[k : k + MAX_CHARACTERS] for k in range(0, len(text), MAX_CHARACTERS)])
        return cls(layers=layers, precision=precision, numbers=pieces, **preprocessing)

    @model_validator(mode="after")
    def _is_consistent(self) -> "TrainedNetwork":
        """Raise an error if successive layers do not match, or the number of weights and biases is wrong."""
        for index, (before, after) in enumerate(zip(self.layers[:-1], self.layers[1:], strict=True), start=1):
            if after.inputs != before.outputs:
                demand = f"must be {before.outputs}, the number of outputs of the preceding layer"
                raise self.field_error(demand, "layers", index, "inputs")
        count = sum(layer.num_numbers for layer in self.layers)
        if count * _DTYPES[self.precision].itemsize > MAX_NETWORK_BYTES:
            max_count = MAX_NETWORK_BYTES // _DTYPES[self.precision].itemsize
            raise self.field_error(
                f"must have at most {max_count} numbers in {self.precision} precision, not {count}", "layers"
            )
        try:
            numbers = self._array()
        except (binascii.Error, ValueError):
            raise validation_error("must be numbers in base 64", path=("numbers",)) from None
        if len(numbers) != count:
            raise validation_error(f"must have {count} numbers for these layers, not {len(numbers)}", path=("numbers",))
        if not np.isfinite(numbers).all():
            raise validation_error("must be finite", path=("numbers",))
        for name in ("offset", "scale"):
            rows = getattr(self, name)
            if rows is not None and len(rows) != self.layers[0].inputs:
                raise self.field_error(
                    f"must have {self.layers[0].inputs} numbers, one for each element of the input", name
                )
        return self

    def network(self) -> Network:
        """Return the network as a parameter of the system that computes it."""
        return _network(self)

    def _array(self) -> np.ndarray:
        data = base64.b64decode("".join(self.numbers).encode("ascii"), validate=True)
        return np.frombuffer(data, _DTYPES[self.precision]).astype(float)


@functools.lru_cache(maxsize=16)
def _network(trained: TrainedNetwork) -> Network:
    ends = np.cumsum([layer.num_numbers for layer in trained.layers])
    parts = np.split(trained._array(), ends[:-1])
    return Network(
        tuple([layer.layer(numbers) for layer, numbers in zip(trained.layers, parts, strict=True)]),
        trained.layers[0].inputs,
        trained.offset,
        trained.scale,
        trained.limit,
    )
