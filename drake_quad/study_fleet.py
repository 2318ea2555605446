"""A fleet that flies the samples of a study, batch after batch, in one diagram."""

from collections.abc import Callable, Sequence
from typing import Any

from pydrake.systems.analysis import Simulator

from drake_quad.errors import InputError
from drake_quad.flight import fly, read_metrics
from drake_quad.laboratory.metrics import Metrics
from drake_quad.planning import flight_duration, plan_route
from drake_quad.reference.plan import Plan
from drake_quad.scenario import Scenario
from drake_quad.tracking import build_tracking_diagram, put_samples


class StudyFleet:
    """Flies samples of a scenario's study side by side, up to N at a time.

    The diagram is built once; samples are put into its context.

    Args:
        scenario: of the study.
        num_vehicles: N.
        plan: flown instead of that of the scenario's route.
        position_controller: makes a system for N vehicles that stands in for the scenario's; see
            `build_tracking_diagram`.
        control: makes one for the whole cascade; likewise.
        wind: makes a source of wind beside the scenario's; likewise.

    Raises:
        InputError: the route holds a distribution, or the rotors cannot fly it; or the vehicle has no time step.
    """

    def __init__(
        self,
        scenario: Scenario,
        num_vehicles: int,
        *,
        plan: Plan | None = None,
        position_controller: Callable[[int], Any] | None = None,
        control: Callable[[int], Any] | None = None,
        wind: Callable[[int], Any] | None = None,
    ) -> None:
        if scenario.vehicle.time_step == 0.0:
            # An integrator chooses its steps by all vehicles of a fleet.
            raise InputError("vehicle.time_step is 0; samples fly alike in any fleet only with a time step")
        self._scenario, self.num_vehicles = scenario, num_vehicles
        self._plan = plan or plan_route(scenario)
        self.duration = flight_duration(scenario, self._plan)
        makers = {"position_controller": position_controller, "control": control, "wind": wind}
        own = {name: make(num_vehicles) for name, make in makers.items() if make is not None}
        self._own = tuple(own)
        diagram = build_tracking_diagram(scenario, num_vehicles, samples=range(num_vehicles), plan=self._plan, **own)
        self._simulator = Simulator(diagram)

    def fly(
        self,
        samples: Sequence[int],
        *,
        duration: float | None = None,
        progress: Callable[[float, float], None] | None = None,
    ) -> Metrics:
        """Flies samples and returns the (n,) metrics of each.

        Args:
            samples: n numbers of samples, from 1 to N of them. With fewer than N the last is flown several times: what
                a vehicle does depends on no other.
            duration: after which to stop, s; that of the flight if not given.
            progress: called now and then with the time flown and the time to fly, s.

        Raises:
            InputError: a sample's drag is too much for the vehicle's time step.
        """
        missing = self.num_vehicles - len(samples)
        if missing < 0 or not len(samples):
            raise ValueError(f"a fleet of {self.num_vehicles} cannot fly {len(samples)} samples at once")
        diagram, context = self._simulator.get_system(), self._simulator.get_mutable_context()
        flown = [*samples, *[samples[-1]] * missing]
        put_samples(diagram, context, self._scenario, flown, self._plan, own=self._own)
        self._simulator.Initialize()
        fly(self._simulator, self.duration if duration is None else duration, progress=progress)
        return Metrics(*(values[: len(samples)] for values in read_metrics(diagram, context)))
