"""Force of the downwash of other vehicles.

The model is that of gym-pybullet-drones (J. Panerati et al., "Learning to fly", IROS 2021; function `_downwash`). A
vehicle at the height Δz below another one, and at the horizontal distance d, is pushed along -z_B by the force

    F = α exp(-½ (d / β)²),   α = c₁ (r / (4 Δz))²,   β = c₂ Δz + c₃

with the radius r of a propeller, and without a force at horizontal distances over 10 m. The forces of several vehicles
are added. The formula depends only on positions: it holds for vehicles in hover. With the published coefficients β is
negative below Δz = 0.6875 m, where it is zero and only a vehicle exactly below is pushed; only |β| matters.

α is infinite at Δz = 0, where the vehicles are side by side and the formula is not meant to hold. Below a smallest
height, the force is therefore that at this height, multiplied by the ratio of the heights.
"""

from typing import Annotated, NamedTuple

from drake_quad.framework.elementary import exp, maximum, minimum, where
from drake_quad.geometry.axes import TINY
from drake_quad.signals import Number, Quantity, Row, State

_MAX_DISTANCE = 10.0  # m; vehicles at a larger horizontal distance have no downwash


class DownwashParameters(NamedTuple):
    """Coefficients of the downwash; the defaults are those of the Crazyflie 2 in gym-pybullet-drones (`cf2x.urdf`).

    Attributes:
        force: factor c₁ of the force.
        spread: increase c₂ of the radius with the height.
        offset: radius c₃ at the height 0.
        propeller_radius: radius r of a propeller.
        min_height: height below which the force is proportional to the height; the default is an assumption.
    """

    force: Annotated[Row, Quantity("N", sign="nonnegative")] = 2267.18
    spread: Number = 0.16
    offset: Annotated[Row, Quantity("m")] = -0.11
    propeller_radius: Annotated[Row, Quantity("m", sign="nonnegative")] = 2.31348e-2
    min_height: Annotated[Row, Quantity("m", sign="positive")] = 0.2


CRAZYFLIE_DOWNWASH = DownwashParameters()


def downwash_force(lower: State, upper: State, parameters: DownwashParameters) -> Row:
    """Return the force with which a vehicle pushes another one down, N; 0 if it is not above it within 10 m."""
    x, y, z = upper.x - lower.x, upper.y - lower.y, upper.z - lower.z
    squared_distance = x * x + y * y
    is_pushed = (z > 0.0) & (squared_distance < _MAX_DISTANCE * _MAX_DISTANCE)
    height = maximum(z, parameters.min_height)
    ratio = parameters.propeller_radius / (4.0 * height)
    radius = parameters.spread * height + parameters.offset
    force = parameters.force * ratio * ratio * exp(-0.5 * squared_distance / (radius * radius + TINY))
    return where(is_pushed, minimum(z / parameters.min_height, 1.0) * force, 0.0)
