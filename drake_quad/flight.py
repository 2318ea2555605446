"""Flying a scenario, and what a flight leaves behind."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator
from pydrake.systems.framework import Diagram

from drake_quad.errors import InputError
from drake_quad.files import output_folder, write_whole
from drake_quad.laboratory.metrics import Metrics
from drake_quad.laboratory.recorder import read_recorder
from drake_quad.planning import flight_duration, plan_route, refuse_distributions
from drake_quad.reference.plan import Plan
from drake_quad.scenario import Scenario, distributions_in, draw_sample, save_scenario
from drake_quad.signals import signal_rows
from drake_quad.tracking import build_tracking_diagram

# Between two looks at the crashes and two reports of progress, s of flight.
_STRIDE = 1.0
_ACCURACY, _MAX_STEP = 1e-8, 0.1
# Of steps for a continuous state, s: a second of flight takes a quarter of a minute with these.
_MIN_STEP = 1e-5
# How Drake says that they are too long.
_TOO_FAST = "smaller than minimum allowed"


@dataclass(frozen=True, repr=False)
class Flight:
    """A flown scenario.

    Attributes:
        scenario: what was flown, with its seed and the number of the sample.
        plan: the reference.
        time: (ticks,) the ticks of the control, until the end or the crash, s.
        signals: (ticks, rows) values of each signal at the ticks; `drake_quad.signals` says what the rows are.
        metrics: of the flight; NaN where there is nothing to measure.
    """

    scenario: Scenario
    plan: Plan
    time: np.ndarray
    signals: dict[str, np.ndarray]
    metrics: Metrics

    def __getitem__(self, name: str) -> np.ndarray:
        """The (ticks, rows) values of a signal."""
        if name not in self.signals:
            raise KeyError(f"{name} is no signal of this flight, which has {', '.join(self.signals)}")
        return self.signals[name]

    def __repr__(self) -> str:
        """A line of text."""
        end = f"crashed at {self.metrics.crash_time:.2f} s" if self.metrics.crashed else f"{self.time[-1]:.2f} s"
        return f"<Flight of {self.scenario.name}: {end}, RMSE {self.metrics.rmse:.4g} m; {', '.join(self.signals)}>"

    @property
    def euclidean_error(self) -> np.ndarray:
        """(ticks,) distance of the vehicle to the reference, m."""
        error: np.ndarray = np.linalg.norm(self["reference"][:, 0:3] - self["state"][:, 0:3], axis=1)
        return error

    def save(self, folder: Path | str) -> list[Path]:
        """Writes the signals as compressed NumPy and as CSV, the metrics as CSV, and the scenario as YAML to fly again.

        Returns:
            The files.

        Raises:
            InputError: the folder cannot be written, or holds a scenario of something else than a flight.
        """
        target = output_folder(Path(folder))
        if (target / "scenario.yaml").exists() and not (target / "flight.npz").exists():
            raise InputError(
                f"{target / 'scenario.yaml'} would be overwritten, and is no flight's; choose another folder"
            )
        columns = [
            f"{name}.{row.name} ({row.unit})"
            for name, values in self.signals.items()
            for row in signal_rows(name, values.shape[1])
        ]
        table = np.column_stack([self.time, *self.signals.values()])
        header = ",".join(["time (s)", *columns])

        def save_arrays(path: Path) -> None:
            arrays: dict[str, Any] = {"time": self.time, **self.signals}
            np.savez_compressed(path, **arrays)

        def save_metrics(path: Path) -> None:
            values = ["" if not math.isfinite(value) else f"{value:.12g}" for value in self.metrics]
            path.write_text(f"{','.join(Metrics._fields)}\n{','.join(values)}\n", encoding="utf-8")

        return [
            write_whole(target / "flight.npz", save_arrays),
            write_whole(
                target / "flight.csv",
                lambda path: np.savetxt(path, table, fmt="%.9g", delimiter=",", header=header, comments=""),
            ),
            write_whole(target / "scenario.yaml", lambda path: save_scenario(self.scenario, path)),
            write_whole(target / "metrics.csv", save_metrics),
        ]


def simulate(
    scenario: Scenario,
    *,
    seed: int | None = None,
    sample: int | None = None,
    position_controller: Any = None,
    control: Any = None,
    wind: Any = None,
    plan: Plan | None = None,
    prepare: Callable[[Simulator], None] | None = None,
    progress: Callable[[float, float], None] | None = None,
) -> Flight:
    """Flies one vehicle and records every signal.

    Args:
        scenario: with numbers only, unless a sample is given.
        seed: of the study, in place of the scenario's.
        sample: number of the sample of the study to fly, in place of the scenario's: with what is drawn for it, in its
            wind and with its noise. Without one, these are wind and noise of sample 0.
        position_controller: stands in for the scenario's; see `build_tracking_diagram`.
        control: stands in for the whole cascade; likewise.
        wind: blows beside the scenario's; likewise.
        plan: flown instead of that of the scenario's route.
        prepare: called with Drake's simulator before it flies, to set a monitor or a rate of real time.
        progress: called now and then with the time flown and the time to fly, s.

    Raises:
        InputError: the scenario holds a distribution and no sample is given, the rotors cannot fly the route, the
            metric window lies beyond the flight, or a continuous state changes too fast.
    """
    sample = scenario.sample if sample is None else sample
    if sample is None:
        refuse_distributions(distributions_in(scenario))
    scenario = draw_sample(scenario, sample or 0, seed=seed)
    plan = plan or plan_route(scenario)
    duration = flight_duration(scenario, plan)
    diagram = build_tracking_diagram(
        scenario, position_controller=position_controller, control=control, wind=wind, plan=plan, record=True
    )
    simulator = Simulator(diagram)
    # For a vehicle with a continuous state; a stepping one does not use the integrator.
    integrator = ResetIntegratorFromFlags(simulator, "runge_kutta5", _MAX_STEP)
    integrator.set_target_accuracy(_ACCURACY)
    integrator.set_requested_minimum_step_size(_MIN_STEP)
    if prepare is not None:
        prepare(simulator)
    try:
        fly(simulator, duration, progress=progress)
    except RuntimeError as error:
        if _TOO_FAST not in str(error):
            raise
        time = simulator.get_context().get_time()
        raise InputError(
            f"vehicle.time_step is 0, but from {time:.3g} s on something moves too fast for the integration of a"
            f" continuous state, in less than {_MIN_STEP:g} s; give it a step"
        ) from None
    return _flights([scenario], plan, diagram, simulator.get_context())[0]


def simulate_samples(
    scenario: Scenario, samples: Sequence[int], *, seed: int | None = None, plan: Plan | None = None
) -> list[Flight]:
    """Flies samples of a study side by side and records every signal of each, as `simulate` does of one.

    Every signal of every vehicle is kept: a few megabytes a flight of half a minute.

    Args:
        scenario: of the study.
        samples: their numbers in it.
        seed: of the study, in place of the scenario's.
        plan: flown instead of that of the scenario's route.

    Raises:
        InputError: the route holds a distribution, or the rotors cannot fly it.
    """
    scenario = scenario.model_copy(update={"seed": scenario.seed if seed is None else seed})
    plan = plan or plan_route(scenario)
    diagram = build_tracking_diagram(scenario, len(samples), samples=samples, plan=plan, record=True)
    simulator = Simulator(diagram)
    fly(simulator, flight_duration(scenario, plan))
    drawn = [draw_sample(scenario, sample) for sample in samples]
    return _flights(drawn, plan, diagram, simulator.get_context())


def _flights(scenarios: Sequence[Scenario], plan: Plan, diagram: Diagram, context: Any) -> list[Flight]:
    """The flights of a diagram's vehicles so far, each of a scenario."""
    metrics = read_metrics(diagram, context)
    time, signals = read_recorder(diagram.GetSubsystemByName("recorder"), context)
    rows = {name: values.reshape(len(time), -1, len(scenarios)) for name, values in signals.items()}
    flights = []
    for i, scenario in enumerate(scenarios):
        own = Metrics(*(float(value[i]) for value in metrics))
        kept = time <= own.crash_time
        # Within the step into its crash a vehicle may have left all numbers behind.
        kept &= np.all([np.isfinite(values[:, :, i]).all(axis=1) for values in rows.values()], axis=0)
        mine = {name: values[kept, :, i] for name, values in rows.items()}
        flights.append(Flight(scenario, plan, time[kept], mine, own))
    return flights


def fly(simulator: Simulator, duration: float, *, progress: Callable[[float, float], None] | None = None) -> None:
    """Advances a tracking diagram from time zero to a duration (s), or until every vehicle has crashed.

    `progress` is called now and then with the time flown and the duration.
    """
    diagram, context = simulator.get_system(), simulator.get_context()
    crashed = diagram.GetOutputPort("crashed")
    time = 0.0
    while time < duration and not (crashed.Eval(context) != 0.0).all():
        time = min(time + _STRIDE, duration)
        simulator.AdvanceTo(time)
        if progress is not None:
            progress(time, duration)
    simulator.AdvancePendingEvents()


def read_metrics(diagram: Diagram, context: Any) -> Metrics:
    """The (N,) metrics of a tracking diagram's vehicles so far."""
    monitor = diagram.GetSubsystemByName("monitor")
    return monitor.metrics(monitor.GetMyContextFromRoot(context))
