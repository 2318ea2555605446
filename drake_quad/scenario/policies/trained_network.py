"""Trained networks of the scenario language."""

import base64
import binascii
import functools
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from drake_quad.control.policy.network import WITH_ALPHA, Activation, Dense, Gru, Network
from drake_quad.framework.symbols import Matrix
from drake_quad.scenario.distributions import Model, Real, omits_defaults, refused
from drake_quad.scenario.limits import MOST_CHARACTERS, MOST_NETWORK_BYTES
from drake_quad.scenario.quantities import PlainPositive

# Largest number of rows. The effective limit of a network is MOST_NETWORK_BYTES.
Rows = Annotated[int, Field(ge=1, le=4096)]
_Precision = Literal["single", "double"]
_DTYPES: dict[_Precision, np.dtype[Any]] = {"single": np.dtype("<f4"), "double": np.dtype("<f8")}


class DenseLayer(Model):
    """Neurons: the activation of W x + b."""

    kind: Literal["dense"]
    inputs: Rows = Field(description="rows that come in")
    outputs: Rows = Field(description="rows that go out")
    activation: Activation = Field(default="identity", description="of each row that goes out")
    alpha: Real | None = Field(
        default=None,
        description="of elu, which goes to -alpha, 1 if not given; or of leaky_relu, its slope for negative numbers,"
        " 0.01 if not given (1)",
    )

    _written = omits_defaults("alpha")

    @model_validator(mode="after")
    def _has_its_parameter(self) -> "DenseLayer":
        if self.alpha is not None and self.activation not in WITH_ALPHA:
            raise self.wrong(f"must be left out with the activation {self.activation}", "alpha")
        return self

    @property
    def num_numbers(self) -> int:
        """Weights and biases."""
        return self.outputs * (self.inputs + 1)

    def layer(self, numbers: np.ndarray) -> Dense:
        """Return the layer with given numbers: the rows of W, then b."""
        weights, biases = np.split(numbers, [self.outputs * self.inputs])
        return Dense(Matrix(weights.reshape(self.outputs, self.inputs), biases), self.activation, self.alpha)


class GruLayer(Model):
    """Gated recurrent units, with the reset gate behind the product with what they remember."""

    kind: Literal["gru"]
    inputs: Rows = Field(description="rows that come in")
    outputs: Rows = Field(description="units")

    @property
    def num_numbers(self) -> int:
        """Weights, biases, and what is remembered at the beginning."""
        return 3 * self.outputs * (self.inputs + self.outputs + 2) + self.outputs

    def layer(self, numbers: np.ndarray) -> Gru:
        """The layer of these numbers: W, b, U, c, those of r, z and n one after another; then the initial memory."""
        gates = 3 * self.outputs
        ends = np.cumsum([gates * self.inputs, gates, gates * self.outputs, gates])
        weights, biases, of_memory, memory_biases, initial = np.split(numbers, ends)
        return Gru(
            Matrix(weights.reshape(gates, -1), biases),
            Matrix(of_memory.reshape(gates, -1), memory_biases),
            tuple(initial.tolist()),
        )


Layer = Annotated[DenseLayer | GruLayer, Field(discriminator="kind")]
_Numbers = Annotated[tuple[Real, ...], Field(strict=False)]


class TrainedNetwork(Model):
    """A network that was trained; `policy: FILE` reads it from an .npz or .onnx file."""

    layers: Annotated[tuple[Layer, ...], Field(strict=False, min_length=1, max_length=20)] = Field(
        description="from the input on"
    )
    precision: _Precision = Field(default="single", description="of the numbers")
    numbers: Annotated[tuple[str, ...], Field(strict=False)] = Field(
        description="weights and biases of all layers, in base 64, in pieces"
    )
    offset: _Numbers | None = Field(default=None, description="that is taken from each row of the input, if any")
    scale: _Numbers | None = Field(default=None, description="by which each row is multiplied then, if any")
    limit: PlainPositive | None = Field(
        default=None, description="to which the input is held then, on both sides of zero; null for none (1)"
    )

    @classmethod
    def of(cls, layers: tuple[Any, ...], numbers: np.ndarray, **prepared: Any) -> "TrainedNetwork":
        """Return a network with given numbers, stored in single precision if that is exact.

        Args:
            layers: value of the field `layers`.
            numbers: numbers of all layers, one layer after another.
            prepared: `offset`, `scale` and `limit`, if given.
        """
        with np.errstate(over="ignore"):  # numbers beyond single precision become infinite, so the test below fails
            precision: _Precision = "single" if (numbers.astype("<f4") == numbers).all() else "double"
        text = base64.b64encode(numbers.astype(_DTYPES[precision]).tobytes()).decode("ascii")
        pieces = tuple([text[k : k + MOST_CHARACTERS] for k in range(0, len(text), MOST_CHARACTERS)])
        return cls(layers=layers, precision=precision, numbers=pieces, **prepared)

    @model_validator(mode="after")
    def _fits(self) -> "TrainedNetwork":
        """One layer takes what the one before gives, and there are as many numbers as they have."""
        for place, (before, after) in enumerate(zip(self.layers[:-1], self.layers[1:], strict=True), start=1):
            if after.inputs != before.outputs:
                demand = f"must be {before.outputs}, which is what the layer before gives"
                raise self.wrong(demand, "layers", place, "inputs")
        count = sum(layer.num_numbers for layer in self.layers)
        if count * _DTYPES[self.precision].itemsize > MOST_NETWORK_BYTES:
            most = MOST_NETWORK_BYTES // _DTYPES[self.precision].itemsize
            raise self.wrong(f"may have {most} numbers of {self.precision} precision, not {count}", "layers")
        try:
            numbers = self._array()
        except (binascii.Error, ValueError):
            raise refused("must be numbers in base 64", path=("numbers",)) from None
        if len(numbers) != count:
            raise refused(f"must be {count} numbers for these layers, not {len(numbers)}", path=("numbers",))
        if not np.isfinite(numbers).all():
            raise refused("must be finite", path=("numbers",))
        for name in ("offset", "scale"):
            rows = getattr(self, name)
            if rows is not None and len(rows) != self.layers[0].inputs:
                raise self.wrong(f"must be {self.layers[0].inputs} numbers, one for each row of the input", name)
        return self

    def network(self) -> Network:
        """Return the network."""
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
