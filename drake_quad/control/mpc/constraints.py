"""Constraints of a model predictive controller over its horizon.

A constraint bounds the deviation y of a state or of a command from the reference, at each tick. The bound is a limit
minus the value on the reference:

    snap        ±(u_ff + y) <= max                     y is a horizontal command; only if torques are sent
    tilt        n·(a_r - τ_f + y) <= g tan θ cos(π/m)  y is the horizontal specific thrust, if torques are sent
                n·(u_ff - τ_f + y) <= g tan θ cos(π/m) y is the horizontal command, with an autopilot
    thrust      -(u_ff - τ_f + y) <= g - F_min / M     y is the vertical command
                u_ff - τ_f + y <= √(F_max² / M² - a_rx² - a_ry²) - g
    corridor    ±(p_r + y) <= ±wall                    y is the position, if the walls are fixed in W
                ±y <= ±wall                            y is the position, if the walls follow the reference

n are the m unit normals of a regular polygon inside the circle of the largest tilt, and M is the mass. The corridor,
and the tilt if torques are sent, are constraints on states, which a disturbance can push beyond the bound. For these
constraints, a slack ε at each tick relaxes the bound, and ζ ε² is added to the cost of the regulator.
Constraints on commands can always be satisfied. A solution therefore always exists (P. O. M. Scokaert and J. B.
Rawlings, "Feasibility issues in linear model predictive control", AIChE Journal 45(8), 1999).
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from drake_quad.control.lqg.design import Regulator
from drake_quad.control.lqg.laws import ChainCommands, LqgParameters, feed_forward_commands
from drake_quad.control.mpc.prediction import Prediction, Response
from drake_quad.geometry.per_axis import PerAxis
from drake_quad.signals import Acceleration, Jerk, Reference, Snap

# Number m of sides of the polygon that limits the tilt. With 16 sides, at least 98 % of the largest tilt is allowed in
# every direction.
_NUM_POLYGON_SIDES = 16


class Corridor(NamedTuple):
    """Walls on both sides of the vehicle along each axis.

    Attributes:
        lower: lower walls along X, Y and Z, m; minus infinity for none.
        upper: upper walls along X, Y and Z, m; infinity for none.
        follows_reference: True if the walls are distances from the reference, False if they are positions in W.
        weight: ζ, weight of the squared distance beyond a wall, relative to the regulator's cost p².
    """

    lower: PerAxis
    upper: PerAxis
    follows_reference: bool
    weight: float


class Preview(NamedTuple):
    """Reference and its higher derivatives at a tick of the horizon.

    Attributes:
        reference: reference at the tick.
        jerk: jerk of the reference at the tick.
        snap: snap of the reference at the tick.
        before: snap of the reference at the previous tick.
    """

    reference: Reference
    jerk: Jerk
    snap: Snap
    before: Snap


class SharedSlack(NamedTuple):
    """Slack ε at each tick, shared by all constraints of the same name.

    Attributes:
        name: name of the relaxed limit.
        weight: ζ in the cost ζ ε².
    """

    name: str
    weight: float


class Constraint(NamedTuple):
    """Bound at every tick of the horizon: free ξ + forced c - ε <= bound + shift·τ_f.

    Attributes:
        free: (ticks, n) gains on the deviations ξ of all axes of a programme, one axis after another.
        forced: (ticks, commands) gains on the perturbations c of the commands of its axes, one axis after another.
        bound: (ticks of the preview,) limit minus reference.
        shift: (3,) row vector that is multiplied by the correction τ_f.
        starts_next_tick: True if the first row applies to the next tick, as for states; False if it applies to the
            current tick, as for commands.
        slack: slack of the constraint; None for a hard constraint.
    """

    free: np.ndarray
    forced: np.ndarray
    bound: np.ndarray
    shift: np.ndarray
    starts_next_tick: bool
    slack: SharedSlack | None


class Horizon(NamedTuple):
    """Preview and limits over the prediction horizon.

    Attributes:
        parameters: parameters of the controller.
        preview: reference at all ticks; its values are arrays with one element for each tick.
        corridor: corridor for the vehicle.
        tilt_weight: weight ζ of the tilt slack, which is in units of g.
        num_ticks: length of the horizon in ticks.
        tick: control period, s.
    """

    parameters: LqgParameters
    preview: Preview
    corridor: Corridor
    tilt_weight: float
    num_ticks: int
    tick: float


def horizontal_constraints(regulator: Regulator, horizon: Horizon) -> Iterator[Constraint]:
    """Yield the constraints along X and Y.

    Snaps are relative to the largest snap. Accelerations are in units of g, positions in m.
    """
    limits, torques, reference = horizon.parameters.thrust, horizon.parameters.torques, horizon.preview.reference
    axis, forward = Prediction(regulator, horizon.num_ticks), _feed_forward(horizon)
    if torques is None:
        response, feed_forward, slack = axis.command(), (forward.x, forward.y), None
    else:
        fields = type(horizon.parameters.lateral.K)._fields
        response, feed_forward = axis.state(fields.index("thrust")), (reference.a_x, reference.a_y)
        slack = SharedSlack("tilt", horizon.tilt_weight)
        for direction, snap in (((1.0, 0.0), forward.x), ((0.0, 1.0), forward.y)):
            for coefficient in (1.0 / torques.max_snap, -1.0 / torques.max_snap):
                coefficients = [coefficient * component for component in direction]
                yield _combined(axis.command(), coefficients, bound=1.0 - np.multiply(coefficient, snap))
    a_x, a_y = feed_forward
    for angle in np.linspace(0.0, 2.0 * np.pi, _NUM_POLYGON_SIDES, endpoint=False):
        n_x, n_y = np.cos(angle) / limits.gravity, np.sin(angle) / limits.gravity
        bound = limits.tan_max_tilt * np.cos(np.pi / _NUM_POLYGON_SIDES) - n_x * a_x - n_y * a_y
        yield _combined(response, (n_x, n_y), bound=bound, shift=(n_x, n_y, 0.0), slack=slack)
    yield from _wall_constraints(axis, (1.0, 0.0), "x", horizon)
    yield from _wall_constraints(axis, (0.0, 1.0), "y", horizon)


def vertical_constraints(regulator: Regulator, horizon: Horizon) -> Iterator[Constraint]:
    """Yield the constraints along Z; arguments and units are as in `horizontal_constraints`."""
    limits, reference = horizon.parameters.thrust, horizon.preview.reference
    axis, forward = Prediction(regulator, horizon.num_ticks), _feed_forward(horizon)
    min_specific_thrust, max_specific_thrust = limits.min_thrust / limits.mass, limits.max_thrust / limits.mass
    horizontal_squared = reference.a_x**2 + reference.a_y**2
    max_vertical = np.sqrt(np.maximum(max_specific_thrust**2 - horizontal_squared, min_specific_thrust**2))
    for sign, limit in ((1.0, max_vertical - limits.gravity), (-1.0, limits.gravity - min_specific_thrust)):
        coefficient = sign / limits.gravity
        bound = np.subtract(limit / limits.gravity, coefficient * forward.z)
        yield _combined(axis.command(), (coefficient,), bound=bound, shift=(0.0, 0.0, coefficient))
    yield from _wall_constraints(axis, (1.0,), "z", horizon)


def _wall_constraints(
    axis: Prediction, direction: Sequence[float], name: str, horizon: Horizon
) -> Iterator[Constraint]:
    """Yield the constraints of the corridor's walls across one axis."""
    corridor = horizon.corridor
    position = float(not corridor.follows_reference) * getattr(horizon.preview.reference, name)
    response = axis.state(type(horizon.parameters.vertical.K)._fields.index("position"))
    for sign, walls in ((1.0, corridor.upper), (-1.0, corridor.lower)):
        if np.isfinite(wall := getattr(walls, name)):
            bound, slack = np.multiply(sign, wall - position), SharedSlack(f"corridor along {name}", corridor.weight)
            yield _combined(response, [sign * component for component in direction], bound=bound, slack=slack)


def _feed_forward(horizon: Horizon) -> ChainCommands:
    """Return the feed-forward commands, as arrays with one element for each tick of the preview."""
    reference, jerk, snap, before = horizon.preview
    acceleration = Acceleration(reference.a_x, reference.a_y, reference.a_z)
    return feed_forward_commands(acceleration, jerk, snap, before, horizon.parameters, horizon.tick)


def _combined(
    response: Response,
    coefficients: Sequence[float],
    *,
    bound: np.ndarray,
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0),
    slack: SharedSlack | None = None,
) -> Constraint:
    """Return the constraint on a weighted sum over axes, all of which have the same response."""
    free, forced = (
        np.hstack([coefficient * part for coefficient in coefficients]) for part in (response.free, response.forced)
    )
    return Constraint(free, forced, bound, np.array(shift), response.starts_next_tick, slack)
