"""Description of a world: its vehicles, and how they influence each other."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from drake_quad.errors import InputError, join_names
from drake_quad.flight.mission import plan_route
from drake_quad.planning.feasibility import check_obstacles
from drake_quad.reference.plan import Plan
from drake_quad.reference.polynomial_path import PolynomialPath
from drake_quad.scenario.models import NAME, Scenario
from drake_quad.vehicle.downwash import CRAZYFLIE_DOWNWASH, DownwashParameters

# Names of vehicles are identifiers, since the signals of a world are named after them, as in `cf1.state`.
_VEHICLE_NAME = r"[A-Za-z_][A-Za-z0-9_]*"
_RESERVED_NAMES = ("compiled", "crashed", "downwash", "proximity", "recorder")


@dataclass(frozen=True)
class World:
    """Vehicles that fly in one world.

    All vehicles have the same control period and the same seed. Each flies its own scenario, with the wind of its
    laboratory; equal wind sources blow in the same way for all vehicles. A flight ends when the last route ends.

    Args:
        vehicles: scenario of each vehicle, by the name of the vehicle.
        radius: radius of the sphere around each vehicle, m. Vehicles whose spheres overlap have collided.
        downwash: coefficients of the downwash; None for vehicles without downwash.
        offsets: offset of a vehicle's route in W, m, by the name of the vehicle.
        name: name of the world.

    Raises:
        InputError: if there are no vehicles, or if their scenarios do not fit together.
    """

    vehicles: Mapping[str, Scenario]
    radius: float
    downwash: DownwashParameters | None = CRAZYFLIE_DOWNWASH
    offsets: Mapping[str, Sequence[float]] = field(default_factory=dict)
    name: str = "world"

    def __post_init__(self) -> None:
        if not self.vehicles:
            raise InputError("a world needs at least one vehicle")
        if not re.fullmatch(NAME, self.name):
            raise InputError(f"the name of the world is {self.name!r}, but must match {NAME}")
        if not (isinstance(self.radius, int | float) and 0.0 < self.radius < math.inf):
            raise InputError(f"the radius of the vehicles is {self.radius}, but must be a number larger than 0")
        for name, scenario in self.vehicles.items():
            if not (isinstance(name, str) and re.fullmatch(_VEHICLE_NAME, name)):
                raise InputError(
                    f"a vehicle cannot be called {name!r}: a name consists of letters, digits and '_', and begins with"
                    " a letter"
                )
            if name in _RESERVED_NAMES:
                raise InputError(f"a vehicle cannot be called {name}, which is a part of every world")
            if scenario.vehicle.time_step == 0.0:
                raise InputError(f"vehicle.time_step of {name} is 0, but must be positive in a world")
            if scenario.laboratory.autopilot.models_vehicle and self.downwash is not None:
                raise InputError(f"{name} has an autopilot of kind response, which has no rotors for the downwash")
        self._check_offsets()
        seeds = {scenario.seed for scenario in self.vehicles.values()}
        if len(seeds) > 1:
            raise InputError(
                "all vehicles of a world need the same seed, which determines their wind, but the seeds are"
                f" {join_names([str(seed) for seed in sorted(seeds)])}"
            )
        periods = {scenario.laboratory.command_link.period for scenario in self.vehicles.values()}
        if len(periods) > 1:
            raise InputError(
                "all vehicles of a world need the same laboratory.command_link.period, but the periods are"
                f" {join_names([f'{period:g} s' for period in sorted(periods)])}"
            )

    def _check_offsets(self) -> None:
        """Raise InputError if an offset does not belong to a vehicle, or is not a point."""
        for name, offset in self.offsets.items():
            if name not in self.vehicles:
                raise InputError(f"offsets contains {name}, but the vehicles are {join_names([*self.vehicles])}")
            is_point = np.shape(offset) == (3,) and all(isinstance(each, int | float | np.number) for each in offset)
            if not (is_point and np.isfinite(offset).all()):
                raise InputError(f"the offset of {name} is {offset!r}, but must consist of three finite numbers")

    @classmethod
    def formation(
        cls,
        scenario: Scenario,
        offsets: Mapping[str, Sequence[float]],
        *,
        radius: float,
        downwash: DownwashParameters | None = CRAZYFLIE_DOWNWASH,
    ) -> "World":
        """Return a world in which all vehicles fly the same scenario, each at a constant offset.

        Args:
            scenario: scenario of all vehicles.
            offsets: offset of each vehicle's route in W, m, by the name of the vehicle.
            radius: radius of the sphere around each vehicle, m.
            downwash: coefficients of the downwash; None for vehicles without downwash.
        """
        return cls(dict.fromkeys(offsets, scenario), radius, downwash, offsets)

    def plans(self) -> dict[str, Plan]:
        """Return the plan of each vehicle, by its name.

        Raises:
            InputError: if a vehicle cannot fly its route, if its shifted route touches an obstacle, or if two vehicles
                start in the same place.
        """
        plans = {name: self._plan(name) for name in self.vehicles}
        names = [*plans]
        starts = {name: plan.waypoints[0] for name, plan in plans.items()}
        for k, name in enumerate(names):
            for other in names[k + 1 :]:
                distance = float(np.linalg.norm(starts[name] - starts[other]))
                if distance < 2.0 * self.radius:
                    raise InputError(
                        f"{name} and {other} start at a distance of {distance:.3g} m, but the spheres around them have"
                        f" a radius of {self.radius:g} m; give different routes or offsets"
                    )
        return plans

    def _plan(self, name: str) -> Plan:
        scenario = self.vehicles[name]
        try:
            plan = plan_route(scenario)
            offset = self.offsets.get(name)
            if offset is None:
                return plan
            coefficients = plan.path.coefficients.copy()
            coefficients[:, 0] += np.asarray(offset, dtype=float)
            path = PolynomialPath(plan.path.times, coefficients)
            check_obstacles(path, scenario.flight_space())
        except InputError as error:
            raise InputError(f"{name}: {error}") from None
        return replace(plan, path=path)
