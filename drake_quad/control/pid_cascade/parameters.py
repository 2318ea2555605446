"""Parameters and state of cascades of PIDs, and PID loops on three axes."""

from typing import Annotated, NamedTuple

from drake_quad.geometry.axes import Vector
from drake_quad.geometry.per_axis import PerAxis
from drake_quad.pid.loop import Memory, Terms, pid
from drake_quad.signals import ForceB, Number, Quantity, Row, Time, VelocityW


class PidLoopGains(NamedTuple):
    """Gains of a loop on three axes.

    Attributes:
        k_p: proportional gains.
        terms: integral, derivative and feed-forward terms on each axis; None for a proportional loop.
    """

    k_p: PerAxis
    terms: tuple[Terms, Terms, Terms] | None = None


class TiltParameters(NamedTuple):
    """Thrust parameters of a cascade that commands roll and pitch.

    Attributes:
        hover_thrust: thrust when the output of the vertical velocity loop is zero.
        min_thrust: smallest thrust.
        max_thrust: largest thrust.
    """

    hover_thrust: ForceB
    min_thrust: ForceB
    max_thrust: ForceB


class AccelerationParameters(NamedTuple):
    """Feed-forward and limits of a cascade that commands an acceleration.

    Attributes:
        feed_forward: factor on the acceleration of the reference.
        max_speed: largest commanded horizontal speed.
        max_ascent: largest commanded velocity upwards.
        max_descent: largest commanded velocity downwards.
        tan_max_tilt: tangent of the largest tilt.
        min_thrust: smallest thrust.
        max_thrust: largest thrust.
        horizontal_margin: horizontal thrust that remains available when the vertical thrust saturates.
    """

    feed_forward: Number
    max_speed: VelocityW
    max_ascent: VelocityW
    max_descent: VelocityW
    tan_max_tilt: Number
    min_thrust: ForceB
    max_thrust: ForceB
    horizontal_margin: ForceB


class CascadeParameters(NamedTuple):
    """Parameters of a cascade of PIDs.

    Attributes:
        position: gains of the position loop, from m to m/s.
        velocity: gains of the velocity loop, from m/s to m/s²; on the two horizontal axes from m/s to rad if the loop
            commands a tilt.
        velocity_feed_forward: factor by which the velocity of the reference is multiplied before it is added to the
            commanded velocity.
        mass: mass of the nominal vehicle.
        gravity: g of the nominal model.
        command: parameters of the law of the velocity loop. The type of this record selects the law.
    """

    position: PidLoopGains
    velocity: PidLoopGains
    velocity_feed_forward: Number
    mass: Annotated[Row, Quantity("kg")]
    gravity: Annotated[Row, Quantity("m/s²")]
    command: TiltParameters | AccelerationParameters


class CascadeRules(NamedTuple):
    """Options in which the control laws of firmwares differ.

    Attributes:
        position_integrates_first: True if the integral in the output of the position loop includes the error of the
            current tick.
        velocity_integrates_first: True if the integral in the output of the velocity loop includes the error of the
            current tick; only for a velocity loop that commands a tilt.
        decouples_vertical: True if the commanded vertical acceleration does not change the tilt.
    """

    position_integrates_first: bool = False
    velocity_integrates_first: bool = False
    decouples_vertical: bool = True


Memories = tuple[Memory, Memory, Memory]


class CascadeMemory(NamedTuple):
    """State of the position loop and of the velocity loop."""

    position: Memories
    velocity: Memories


def _memories(gains: PidLoopGains) -> Memories:
    first, second, third = (Memory.of(terms) for terms in gains.terms or (None, None, None))
    return first, second, third


def empty_memory(parameters: CascadeParameters) -> CascadeMemory:
    """Return the state of a PID cascade before its first tick."""
    return CascadeMemory(_memories(parameters.position), _memories(parameters.velocity))


def step_loops(
    setpoint: Vector, measured: Vector, gains: PidLoopGains, memories: Memories, period: Time, integrates_first: bool
) -> tuple[Vector, Memories]:
    """Return the outputs of a loop on three axes, and its next state.

    Args:
        setpoint: setpoints.
        measured: measurements.
        gains: gains of the loop.
        memories: state of the loop.
        period: period of the loop, s.
        integrates_first: True if the integral in the output includes the error of the current tick.
    """
    terms = gains.terms or (None, None, None)
    axes = zip(setpoint, measured, gains.k_p, terms, memories, strict=True)
    (x, first), (y, second), (z, third) = (pid(*axis, period, integrates_first=integrates_first) for axis in axes)
    return Vector(x, y, z), (first, second, third)
