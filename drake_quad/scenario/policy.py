"""Policies in the scenario language: a trained network, what it sees, and what its actions mean."""

import base64
import binascii
import functools
import math
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, SerializerFunctionWrapHandler, model_serializer, model_validator
from pydantic_core import PydanticCustomError

from drake_quad.control.policy.actuation import ROWS
from drake_quad.control.policy.frames import LevelFrame
from drake_quad.control.policy.network import WITH_ALPHA, Activation, Dense, Gru, Network
from drake_quad.control.policy.observation import SIGNALS_SEEN, Frame, ObservationSpec, num_observed
from drake_quad.framework.symbols import Matrix
from drake_quad.scenario.controllers import AttitudeControl, ThrustVectoring
from drake_quad.scenario.distributions import Model, Real
from drake_quad.scenario.limits import MOST_CHARACTERS, MOST_NETWORK_BYTES
from drake_quad.scenario.networks import or_file
from drake_quad.scenario.quantities import (
    Gains,
    HalfTurn,
    PlainMoment,
    PlainNonNegative,
    PlainPositive,
    PlainPositives,
    PlainTilt,
    radians,
)

# Bounds of rows, layers, ticks and moments, which no small network comes near; MOST_NETWORK_BYTES is what counts.
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

    @model_serializer(mode="wrap")
    def _written(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Serialise the layer without the parameter if it is not given."""
        fields: dict[str, Any] = write(self)
        return {name: value for name, value in fields.items() if name != "alpha" or value is not None}

    @model_validator(mode="after")
    def _has_its_parameter(self) -> "DenseLayer":
        if self.alpha is not None and self.activation not in WITH_ALPHA:
            demand = "must be left out with the activation {activation}"
            raise self.wrong("alpha", kind="alpha", demand=demand, activation=self.activation)
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
                demand = "must be {outputs}, which is what the layer before gives"
                raise self.wrong("layers", place, "inputs", kind="layers", demand=demand, outputs=before.outputs)
        count = sum(layer.num_numbers for layer in self.layers)
        if count * _DTYPES[self.precision].itemsize > MOST_NETWORK_BYTES:
            most = MOST_NETWORK_BYTES // _DTYPES[self.precision].itemsize
            demand = "may have {most} numbers of {precision} precision, not {count}"
            raise self.wrong("layers", kind="numbers", demand=demand, most=most, precision=self.precision, count=count)
        try:
            numbers = self._array()
        except (binascii.Error, ValueError):
            raise PydanticCustomError("numbers", "must be numbers in base 64", {"path": ("numbers",)}) from None
        if len(numbers) != count:
            demand = "must be {count} numbers for these layers, not {found}"
            raise PydanticCustomError("numbers", demand, {"count": count, "found": len(numbers), "path": ("numbers",)})
        if not np.isfinite(numbers).all():
            raise PydanticCustomError("numbers", "must be finite", {"path": ("numbers",)})
        for name in ("offset", "scale"):
            rows = getattr(self, name)
            if rows is not None and len(rows) != self.layers[0].inputs:
                demand = "must be {count} numbers, one for each row of the input"
                raise self.wrong(name, kind="rows", demand=demand, count=self.layers[0].inputs)
        return self

    def network(self) -> Network:
        """The network."""
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


# What actions of 1 mean if nothing is said is ours: several times what the figure eight needs (0.7 m/s², a tilt of 4°),
# for gusts and for flights that begin beside the path; the tilt is that of the other controllers, and the paper's
# rotors have 2.2 times the weight.


class AccelerationAction(Model):
    """An acceleration, which the cascade makes thrust and attitude of."""

    kind: Literal["acceleration"]
    most: PlainPositives = Field(default=(5.0, 5.0, 5.0), description="of an action of 1 (m/s²)")
    frame: LevelFrame = Field(
        default="world", description="axes along which the acceleration is commanded, named as in `observation.frame`"
    )


class _ThrustAction(Model):
    min_thrust: PlainNonNegative = Field(default=0.0, description="of an action of -1, as a share of the weight (1)")
    max_thrust: PlainPositive = Field(default=2.0, description="of an action of 1, as a share of the weight (1)")

    @model_validator(mode="after")
    def _has_room(self) -> "_ThrustAction":
        if not self.min_thrust < self.max_thrust:
            demand = "must be larger than min_thrust, {least}"
            raise self.wrong("max_thrust", kind="thrust", demand=demand, least=self.min_thrust)
        return self


class AttitudeAction(_ThrustAction):
    """Thrust, roll, pitch, and how far to look away from the reference's yaw."""

    kind: Literal["attitude"]
    max_tilt: PlainTilt = Field(default=0.6, description="roll and pitch of an action of 1 (rad)")
    max_yaw: Annotated[float, Field(ge=0.0, le=math.pi), radians(math.pi)] = Field(
        default=0.5, description="angle from the reference's yaw of an action of 1 (rad)"
    )


class RatesAction(_ThrustAction):
    """Thrust and body rates."""

    kind: Literal["rates"]
    max_rates: PlainPositives = Field(default=(6.0, 6.0, 3.0), description="p, q, r of an action of 1 (rad/s)")
    k_rate: Gains | None = Field(
        default=None,
        description="angular acceleration over the error of the rates, without an autopilot (1/s); k_d of the attitude"
        " control if not given",
    )


class RotorSpeedsAction(Model):
    """Speeds of the rotors, from idle to the top speed."""

    kind: Literal["rotor_speeds"]
    least: PlainNonNegative | None = Field(
        default=None, description="of an action of -1 (rad/s); min_rotor_speed in `nominal` if not given"
    )
    order: Annotated[tuple[int, int, int, int], Field(strict=False)] = Field(
        default=(1, 2, 3, 4), description="which rotor each row of the action is for"
    )

    @model_validator(mode="after")
    def _each_once(self) -> "RotorSpeedsAction":
        if sorted(self.order) != [1, 2, 3, 4]:
            raise self.wrong("order", kind="order", demand="must name each rotor from 1 to 4 once")
        return self


AnyAction = Annotated[
    AccelerationAction | AttitudeAction | RatesAction | RotorSpeedsAction, Field(discriminator="kind")
]
SignalName = Literal[tuple(SIGNALS_SEEN)]  # type: ignore[valid-type] # the names of a table


class Observation(Model):
    """What a policy sees at each tick of the control."""

    signals: Annotated[tuple[SignalName, ...], Field(strict=False, min_length=1)] = Field(  # type: ignore[valid-type]
        default=("position_error", "velocity_error", "rotation", "body_rates", "reference_acceleration", "action"),
        description="in the order of the rows; the page of systems has their rows and units",
    )
    sees: Literal["measurement", "state"] = Field(
        default="measurement",
        description="what position, velocity, attitude and rates are those of: the cameras', with their noise and"
        " delay, or the vehicle's own",
    )
    frame: Frame = Field(
        default="world",
        description="axes along which vectors are seen: those of W; those of W turned about Z by the vehicle's yaw"
        " (`heading`) or by the reference's yaw (`reference_heading`); those of B",
    )
    history: Annotated[int, Field(ge=1, le=100)] = Field(
        default=1, description="ticks that are seen, with the present one"
    )
    ahead: Annotated[tuple[PlainMoment, ...], Field(strict=False, max_length=50)] = Field(
        default=(), description="times from now of `reference_ahead`: where the reference will be, seen from here (s)"
    )
    turn: HalfTurn = Field(
        default=0.0,
        description="angle about z from x_B to the policy's front (rad); the axes of all frames but W are turned by it,"
        " too, so that a policy in W which looks along X flies at a yaw of -turn",
    )

    @model_validator(mode="after")
    def _complete(self) -> "Observation":
        if len(set(self.signals)) < len(self.signals):
            raise self.wrong("signals", kind="signals", demand="must name each signal once")
        if ("reference_ahead" in self.signals) != bool(self.ahead):
            raise self.wrong(
                "ahead", kind="ahead", demand="must be given with the signal reference_ahead, and only then"
            )
        if self.turn and "attitude" in self.signals:
            raise self.wrong("turn", kind="turn", demand="must be 0 with the signal attitude; rotation is seen turned")
        return self

    def spec(self) -> ObservationSpec:
        """What is seen."""
        return ObservationSpec(self.signals, self.frame, self.history, self.turn)

    def num_rows(self, action: Any) -> int:
        """Rows of an observation, given the action that belongs to it."""
        return self.history * num_observed(self.spec(), num_actions=ROWS[action.kind], num_ahead=len(self.ahead))


class PolicyControl(Model):
    """A trained network in place of the position controller, of the cascade, or of all that is not on board."""

    # There is no fuzzy network around it.
    network: ClassVar[None] = None

    kind: Literal["policy"]
    policy: TrainedNetwork | None = Field(
        default=None,
        description="file of the network, .npz or .onnx, beside the one that names it; FILE.onnx:NAME takes one of"
        " several outputs; without a network there is no flying but in drake_quad.gym",
        json_schema_extra=or_file,
    )
    action: AnyAction = Field(description="what the network's output means")
    observation: Observation = Field(default=Observation(), description="what the network sees")
    thrust_vectoring: ThrustVectoring = Field(
        default=ThrustVectoring(), description="limits, where the action is an acceleration"
    )
    attitude: AttitudeControl | None = Field(
        default=None, description="on the ground; needed without an autopilot for accelerations and attitudes"
    )

    @property
    def commands_attitude(self) -> bool:
        """Whether there is something for an attitude control to do."""
        return self.action.kind in ("acceleration", "attitude")

    @model_validator(mode="after")
    def _fits(self) -> "PolicyControl":
        if self.policy is None:
            return self
        last = len(self.policy.layers) - 1
        for place, rows, wanted in (
            (0, "inputs", self.observation.num_rows(self.action)),
            (last, "outputs", ROWS[self.action.kind]),
        ):
            if getattr(self.policy.layers[place], rows) != wanted:
                demand = "must be {wanted}, as many as this observation and action have"
                raise self.wrong("policy", "layers", place, rows, kind="network", demand=demand, wanted=wanted)
        return self
