"""Fleet that simulates the samples of a study in one diagram, batch by batch."""

from collections.abc import Callable, Sequence

import numpy as np

from drake_quad.assembly.user_systems import UserSystems
from drake_quad.errors import InputError
from drake_quad.fleets.fleet_simulation import simulate_fleet
from drake_quad.laboratory.metrics import Metrics, recorded_metrics
from drake_quad.memory import check_fleet_fits
from drake_quad.planning.duration import flight_duration
from drake_quad.reference.plan import Plan
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.models import Scenario


class StudyFleet:
    """Fleet that simulates samples of a scenario's study in parallel, up to N at a time.

    The diagram is built once; its context is reset for every batch of samples.

    Args:
        scenario: scenario, which may contain distributions.
        plan: plan to fly, for example from `drake_quad.plan_route`.
        num_vehicles: number N of vehicles.
        user_systems: functions that create the user's systems for N vehicles.
        compiled: True to compile the diagram to machine code.

    Attributes:
        plan: plan to fly.
        duration: duration of a flight, s.
        simulation: simulation of the fleet, which records signals if a metric of the scenario needs them.

    Raises:
        InputError: if the route contains a distribution, the rotors cannot fly it, `vehicle.time_step` is 0, or the
            fleet does not fit into memory.
    """

    def __init__(
        self,
        scenario: Scenario,
        plan: Plan,
        num_vehicles: int,
        *,
        user_systems: UserSystems = UserSystems(),
        compiled: bool = True,
    ) -> None:
        if scenario.vehicle.time_step == 0.0:
            # With a continuous state, the integrator chooses the same steps for all vehicles, so a flight would depend
            # on the other vehicles.
            raise InputError(
                "vehicle.time_step is 0; it must be positive, so that a sample does not depend on the other vehicles of"
                " the fleet"
            )
        check_fleet_fits(num_vehicles, "num_vehicles")
        self.scenario, self.num_vehicles = scenario, num_vehicles
        self.plan = plan
        self.duration = flight_duration(scenario, plan)
        batch = Batch.draw(scenario, range(num_vehicles))
        record = bool(recorded_metrics(scenario.metrics_type))
        systems = user_systems.build(num_vehicles)
        self.simulation = simulate_fleet(batch, plan, user_systems=systems, record=record, compiled=compiled)

    def fly(
        self,
        samples: Sequence[int],
        *,
        duration: float | None = None,
        progress: Callable[[float, float], None] | None = None,
    ) -> Metrics:
        """Fly n <= N samples and return their metrics, (n,) arrays.

        Args:
            samples: indices of the n samples, at least one.
            duration: time at which the simulation stops, s. By default, the end of the flight.
            progress: function that is called repeatedly with the simulated time and the total time, s.

        Raises:
            InputError: if the drag of a sample is too large for the vehicle's time step.
        """
        return self.fly_batch(Batch.draw(self.scenario, samples), duration=duration, progress=progress)

    def fly_batch(
        self,
        batch: Batch,
        *,
        duration: float | None = None,
        progress: Callable[[float, float], None] | None = None,
    ) -> Metrics:
        """Fly a batch of n <= N vehicles and return their metrics, (n,) arrays.

        A smaller batch is padded to N with copies of its last vehicle. Vehicles do not influence one another.
        """
        if not 0 < len(batch) <= self.num_vehicles:
            raise ValueError(f"a fleet of {self.num_vehicles} vehicles cannot fly {len(batch)} samples at once")
        self.simulation.reset(batch.padded(self.num_vehicles))
        self.simulation.fly(self.duration if duration is None else duration, progress=progress)
        return self.simulation.metrics().take(slice(len(batch)))

    def obstacle_hit(self) -> np.ndarray:
        """Return the (N,) numbers of the obstacles that the vehicles hit, counted from 1; 0 for no collision."""
        return self.simulation.obstacle_hit()
