"""What a model predictive controller keeps to over its horizon.

A constraint holds a sum y of rows of the axes below what the reference leaves of a limit at each tick:

    snap        ±(u_ff + y) <= most                    of the commands, torques over the link
    tilt        n·(a_r - τ_f + y) <= g tan θ cos(π/m)  of the specific thrust; of the commands with an autopilot
    thrust      -(u_ff - τ_f + y) <= g - F_min / M,    u_ff - τ_f + y <= √(F_max² / M² - a_rx² - a_ry²) - g
    corridor    ±(p_r + y) <= ±walls                   or ±y <= half its width

with the m directions n of a regular polygon in the circle of the tilt, and the mass M. Tilt with torques and corridor
are held by states, which a disturbance can throw out: there a slack ε for each tick gives way, at a cost of ζ ε² beside
the regulator's. Commands can always be kept. So there is always a solution (P. O. M. Scokaert and J. B. Rawlings,
"Feasibility issues in linear model predictive control", AIChE Journal 45(8), 1999).
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from drake_quad.control.lqg.design import Regulator
from drake_quad.control.lqg.laws import ChainCommands, LqgNumbers, fed_forward
from drake_quad.control.mpc.prediction import Prediction, Response
from drake_quad.geometry.per_axis import PerAxis
from drake_quad.signals import Acceleration, Jerk, Reference, Snap

# Sides m of the polygon, which leave 98 % of the tilt everywhere.
_SIDES = 16


class Corridor(NamedTuple):
    """Walls on both sides.

    Attributes:
        lower: across X, Y and Z, m; minus infinity for none.
        upper: the same on the other side.
        moves: whether these are distances from the reference, and not places in W.
        weight: ζ of being beyond, 1 where p² costs p².
    """

    lower: PerAxis
    upper: PerAxis
    moves: bool
    weight: float


class Preview(NamedTuple):
    """The reference at a tick.

    Attributes:
        reference: then.
        jerk: then.
        snap: then.
        before: the snap a tick before.
    """

    reference: Reference
    jerk: Jerk
    snap: Snap
    before: Snap


class SharedSlack(NamedTuple):
    """An ε for each tick, which constraints of the same name share.

    Attributes:
        name: of what it is beyond.
        weight: ζ of its cost ζ ε².
    """

    name: str
    weight: float


class Constraint(NamedTuple):
    """A bound at every tick of the horizon: free ξ + forced c - ε <= left + shift·τ_f.

    Attributes:
        free: (ticks, n) by the deviations ξ of all axes of a programme, one after another.
        forced: (ticks, commands) by what is added to the commands of its axes, one after another.
        left: (ticks of the preview,) by the reference.
        shift: (3,) by the correction τ_f.
        later: whether it begins at the next tick, as what holds states does, and not at this one.
        slack: what gives way; None if it is hard.
    """

    free: np.ndarray
    forced: np.ndarray
    left: np.ndarray
    shift: np.ndarray
    later: bool
    slack: SharedSlack | None


class Horizon(NamedTuple):
    """Over what a controller looks ahead.

    Attributes:
        numbers: of the controller.
        preview: of the plan; rows of (ticks of the preview,).
        corridor: to fly in.
        tilt_weight: ζ of being beyond the tilt, by g.
        num_ticks: of the horizon.
        tick: period of the control, s.
    """

    numbers: LqgNumbers
    preview: Preview
    corridor: Corridor
    tilt_weight: float
    num_ticks: int
    tick: float


def horizontal_constraints(regulator: Regulator, horizon: Horizon) -> Iterator[Constraint]:
    """The constraints along X and Y, snaps in shares of the largest, accelerations in g and positions in m.

    Args:
        regulator: of either axis.
        horizon: to look over.
    """
    limits, torques, reference = horizon.numbers.thrust, horizon.numbers.torques, horizon.preview.reference
    axis, forward = Prediction(regulator, horizon.num_ticks), _forward(horizon)
    if torques is None:
        tilted, ahead, slack = axis.command(), (forward.x, forward.y), None
    else:
        fields = type(horizon.numbers.lateral.K)._fields
        tilted, ahead = axis.state(fields.index("thrust")), (reference.a_x, reference.a_y)
        slack = SharedSlack("tilt", horizon.tilt_weight)
        for along, snap in (((1.0, 0.0), forward.x), ((0.0, 1.0), forward.y)):
            for share in (1.0 / torques.max_snap, -1.0 / torques.max_snap):
                yield _sum(axis.command(), [share * each for each in along], left=1.0 - np.multiply(share, snap))
    a_x, a_y = ahead
    for angle in np.linspace(0.0, 2.0 * np.pi, _SIDES, endpoint=False):
        n_x, n_y = np.cos(angle) / limits.gravity, np.sin(angle) / limits.gravity
        left = limits.slope * np.cos(np.pi / _SIDES) - n_x * a_x - n_y * a_y
        yield _sum(tilted, (n_x, n_y), left=left, shift=(n_x, n_y, 0.0), slack=slack)
    yield from _walls(axis, (1.0, 0.0), "x", horizon)
    yield from _walls(axis, (0.0, 1.0), "y", horizon)


def vertical_constraints(regulator: Regulator, horizon: Horizon) -> Iterator[Constraint]:
    """The constraints along Z; arguments and units as of `horizontal_constraints`."""
    limits, reference = horizon.numbers.thrust, horizon.preview.reference
    axis, forward = Prediction(regulator, horizon.num_ticks), _forward(horizon)
    least, largest = limits.min_thrust / limits.mass, limits.max_thrust / limits.mass
    level = reference.a_x**2 + reference.a_y**2
    most = np.sqrt(np.maximum(largest**2 - level, least**2))
    for sign, limit in ((1.0, most - limits.gravity), (-1.0, limits.gravity - least)):
        share = sign / limits.gravity
        left = np.subtract(limit / limits.gravity, share * forward.z)
        yield _sum(axis.command(), (share,), left=left, shift=(0.0, 0.0, share))
    yield from _walls(axis, (1.0,), "z", horizon)


def _walls(axis: Prediction, along: Sequence[float], name: str, horizon: Horizon) -> Iterator[Constraint]:
    """The walls of the corridor across one axis."""
    corridor = horizon.corridor
    position = float(not corridor.moves) * getattr(horizon.preview.reference, name)
    place = axis.state(type(horizon.numbers.vertical.K)._fields.index("position"))
    for sign, walls in ((1.0, corridor.upper), (-1.0, corridor.lower)):
        if np.isfinite(wall := getattr(walls, name)):
            left, slack = np.multiply(sign, wall - position), SharedSlack(f"corridor along {name}", corridor.weight)
            yield _sum(place, [sign * share for share in along], left=left, slack=slack)


def _forward(horizon: Horizon) -> ChainCommands:
    """The commands that are fed forward, rows of (ticks of the preview,)."""
    reference, jerk, snap, before = horizon.preview
    wanted = Acceleration(reference.a_x, reference.a_y, reference.a_z)
    return fed_forward(wanted, jerk, snap, before, horizon.numbers, horizon.tick)


def _sum(
    response: Response,
    shares: Sequence[float],
    *,
    left: np.ndarray,
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0),
    slack: SharedSlack | None = None,
) -> Constraint:
    """A constraint of a sum of the same row of several axes, of which there are some shares."""
    free, forced = (np.hstack([share * part for share in shares]) for part in (response.free, response.forced))
    return Constraint(free, forced, left, np.array(shift), response.later, slack)
