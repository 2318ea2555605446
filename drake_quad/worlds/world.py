"""Description of a world: its vehicles, and how they influence each other."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from drake_quad.errors import InputError, join_names
from drake_quad.flight.mission import plan_route
from drake_quad.reference.plan import Plan
from drake_quad.reference.polynomial_path import PolynomialPath
from drake_quad.scenario.models import Scenario
from drake_quad.vehicle.downwash import CRAZYFLIE_DOWNWASH, DownwashParameters


@dataclass(frozen=True)
class World:
    """Vehicles that fly in one world.

    All vehicles have the same control period. Each flies its own scenario, with the wind of its laboratory; equal wind
    sources blow in the same way for all vehicles. A flight ends when the last route ends.

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
    offsets: Mapping[str, Sequence[float]] = MappingProxyType({})
    name: str = "world"

    def __post_init__(self) -> None:
        if not self.vehicles:
            raise InputError("a world needs at least one vehicle")
        if not self.radius > 0.0:
            raise InputError(f"the radius of the vehicles is {self.radius}, but must be larger than 0")
        for name, scenario in self.vehicles.items():
            if not name.isidentifier():
                raise InputError(f"a vehicle cannot be called {name!r}: use letters, digits and '_'")
            if scenario.vehicle.time_step == 0.0:
                raise InputError(f"vehicle.time_step of {name} is 0, but must be positive in a world")
            if scenario.laboratory.autopilot.models_vehicle and self.downwash is not None:
                raise InputError(f"{name} has an autopilot of kind response, which has no rotors for the downwash")
        periods = {scenario.laboratory.command_link.period for scenario in self.vehicles.values()}
        if len(periods) > 1:
            raise InputError(
                "all vehicles of a world need the same laboratory.command_link.period, but the periods are"
                f" {join_names([f'{period:g} s' for period in sorted(periods)])}"
            )

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

    def plan(self, name: str) -> Plan:
        """Return the plan of a vehicle.

        Raises:
            InputError: under the same conditions as in `drake_quad.plan_route`.
        """
        plan = plan_route(self.vehicles[name])
        offset = self.offsets.get(name)
        if offset is None:
            return plan
        coefficients = plan.path.coefficients.copy()
        coefficients[:, 0] += np.asarray(offset, dtype=float)
        return replace(plan, path=PolynomialPath(plan.path.times, coefficients))
