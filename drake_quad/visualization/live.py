"""Real-time flight in Meshcat, with wind, gains and mass that can be changed during the flight.

The page contains a slider for each of these parameters, and two sliders that display the position error. Its buttons
start a gust, stop a motor, restart the flight or end it. The diagram is the same as in `simulate`.
"""

import time
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator
from pydrake.systems.primitives import ConstantVectorSource

from drake_quad.assembly.tracking import build_fleet_diagram, reset_fleet, set_fleet_parameters
from drake_quad.assembly.user_systems import UserSystems
from drake_quad.flight.mission import plan_route
from drake_quad.planning.duration import flight_duration
from drake_quad.scenario.batch import Batch, draw_sample
from drake_quad.scenario.effects.rotor_failure import RotorFailureEffect
from drake_quad.scenario.limits import MAX_DURATION
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.numbers import number_at, with_number
from drake_quad.signals import Reference, State
from drake_quad.visualization.positions import positions
from drake_quad.visualization.replay.visualizer import QuadrotorVisualizer

_FRAME_PERIOD = 1.0 / 32.0  # s, period at which the sliders and buttons are read
_MAX_WIND = 10.0  # m/s, end of the sliders for the wind along X and Y
_GUST_SPEED = 8.0  # m/s
_GUST_DURATION = 1.5  # s
_ERROR_WINDOW = 5.0  # s, window for the RMS error
_MAX_SHOWN_ERROR = 200.0  # cm, upper end of the sliders that display the error
_MAX_GAIN_FACTOR = 3.0  # upper end of the gain sliders, relative to the gain in the scenario
_MASS_RATIOS = (0.5, 1.5)  # range of the mass slider, relative to the mass in the scenario
_WIND_LABELS = ("wind X (m/s)", "wind Y (m/s)")
_MASS_LABEL = "mass (kg)"
_FAILURE_TIME = "vehicle.rotor_failure.time"
_ERROR_LABELS = ("error (cm)", "RMS error, 5 s (cm)")
# Labels of the buttons.
_GUST = "gust"
_FAILURE = "motor fails"
_RESTART = "start again"
_STOP = "stop"
# Keyboard key of each button.
_BUTTON_KEYS = {_GUST: "KeyG", _FAILURE: "KeyM", _RESTART: "KeyR", _STOP: "Escape"}


class _Gain(NamedTuple):
    """Gain of the position controller. A slider multiplies it by a common factor on all axes.

    Attributes:
        label: label of the slider.
        paths: paths of the gain in the scenario, one for each axis.
    """

    label: str
    paths: tuple[str, ...]


class LiveFlight:
    """Flight of one sample of a scenario, with wind, mass and gains that can be changed during the flight.

    Args:
        scenario: scenario to simulate.
        meshcat: server that shows the flight.
        sample: number of the sample.
        rate: ratio of simulated time to real time; 0 to simulate as fast as possible.

    Raises:
        InputError: if `simulate` cannot fly the scenario.
    """

    def __init__(self, scenario: Scenario, meshcat: Meshcat, *, rate: float, sample: int = 0) -> None:
        drawn = draw_sample(scenario, sample)
        self.plan = plan_route(drawn)
        self.duration = flight_duration(drawn, self.plan)
        self._meshcat, self._sample = meshcat, sample
        # The diagram has no rotors that could fail if the autopilot models the attitude response.
        self._can_fail = not drawn.laboratory.autopilot.models_vehicle
        self._scenario = self._given = _with_failing_motor(drawn) if self._can_fail else drawn
        self._wind: Any = ConstantVectorSource(np.zeros(3))
        self._user_systems = UserSystems(wind=self._wind)
        self._diagram = build_fleet_diagram(self._batch, self.plan, user_systems=self._user_systems)
        self.simulator = Simulator(self._diagram)
        self.simulator.set_target_realtime_rate(rate)
        self._visualizer = QuadrotorVisualizer(meshcat, drawn, self.plan)
        self._gains = [*_position_gains(drawn)]
        self._errors: list[float] = []
        self._gust_end = -np.inf
        self._clicks: dict[str, int] = {}
        self._values: dict[str, float] = {}
        self._add_controls()
        self._start()

    @property
    def _batch(self) -> Batch:
        return Batch(self._scenario, (self._sample,), {})

    @property
    def time(self) -> float:
        """Current time of the live flight, s."""
        return float(self.simulator.get_context().get_time())

    @property
    def state(self) -> State:
        """Current state of the vehicle."""
        return State(*self._diagram.GetOutputPort("state").Eval(self.simulator.get_context()))

    @property
    def scenario(self) -> Scenario:
        """Scenario with the current values of mass and gains."""
        return self._scenario

    @property
    def crashed(self) -> bool:
        """True once the vehicle has crashed."""
        return bool(self._diagram.GetOutputPort("crashed").Eval(self.simulator.get_context())[0])

    def fly(self, duration: float = np.inf) -> Iterator[float]:
        """Repeat the flight until the user clicks on "stop", and yield the flight time (s) after each frame.

        After a crash, the vehicle remains at its position until the user clicks on "start again".

        Args:
            duration: largest simulated time, summed over all repetitions, s.
        """
        elapsed = 0.0
        while elapsed < duration and not self._clicked(_STOP):
            if self._clicked(_RESTART) or self.time >= self.duration - 1e-9:
                self._start()
            self._read_controls()
            if self.crashed:
                time.sleep(_FRAME_PERIOD)
            else:
                self.simulator.AdvanceTo(min(self.time + _FRAME_PERIOD, self.duration))
                self._show_error()
            elapsed += _FRAME_PERIOD
            yield self.time

    def _add_controls(self) -> None:
        sliders: list[tuple[str, float, float, float, float]] = []
        sliders += [(label, -_MAX_WIND, _MAX_WIND, 0.1, 0.0) for label in _WIND_LABELS]
        mass = float(self._given.vehicle.mass)
        lowest, highest = (round(ratio * mass, 4) for ratio in _MASS_RATIOS)
        sliders.append((_MASS_LABEL, lowest, highest, 1e-4, mass))
        sliders += [(gain.label, 0.0, _MAX_GAIN_FACTOR, 0.01, 1.0) for gain in self._gains]
        for label in _ERROR_LABELS:
            self._meshcat.AddSlider(label, 0.0, _MAX_SHOWN_ERROR, 0.1, 0.0)
        for label, low, high, step, value in sliders:
            self._values[label] = self._meshcat.AddSlider(label, low, high, step, value)
        for button, key in _BUTTON_KEYS.items():
            if button != _FAILURE or self._can_fail:
                self._meshcat.AddButton(button, key)

    def _start(self) -> None:
        """Start a flight with the current mass and gains, and with all motors intact."""
        if self._can_fail:
            self._scenario = with_number(self._scenario, _FAILURE_TIME, number_at(self._given, _FAILURE_TIME))
        context = self.simulator.get_mutable_context()
        reset_fleet(self._diagram, context, self._batch, self.plan, user_systems=self._user_systems)
        self._gust_end, self._errors = -np.inf, []
        self._visualizer.watch(self.simulator)
        self.simulator.Initialize()

    def _clicked(self, button: str) -> bool:
        """Return whether a button was clicked since the last call."""
        before, self._clicks[button] = self._clicks.get(button, 0), self._meshcat.GetButtonClicks(button)
        return self._clicks[button] > before

    def _read_controls(self) -> None:
        """Apply the values of the sliders and the button clicks to the simulation."""
        changed = {
            label: value for label in self._values if (value := self._slider_value(label)) != self._values[label]
        }
        self._values |= changed
        numbers = {"vehicle.mass": changed[_MASS_LABEL]} if _MASS_LABEL in changed else {}
        for gain in self._gains:
            if gain.label in changed:
                numbers |= {path: changed[gain.label] * number_at(self._given, path) for path in gain.paths}
        if self._can_fail and self._clicked(_FAILURE):
            numbers[_FAILURE_TIME] = self.time
        for path, number in numbers.items():
            self._scenario = with_number(self._scenario, path, number)
        context = self.simulator.get_mutable_context()
        if numbers:
            set_fleet_parameters(self._diagram, context, self._batch, self.plan, user_systems=self._user_systems)
        if self._clicked(_GUST):
            self._gust_end = self.time + _GUST_DURATION
        wind = np.array([*(self._values[label] for label in _WIND_LABELS), 0.0])
        if self.time < self._gust_end:
            remaining_fraction = (self._gust_end - self.time) / _GUST_DURATION
            wind[0] += 0.5 * _GUST_SPEED * (1.0 - np.cos(2.0 * np.pi * remaining_fraction))
        wind_context = self._wind.GetMyMutableContextFromRoot(context)
        self._wind.get_mutable_source_value(wind_context).set_value(wind)

    def _slider_value(self, label: str) -> float:
        return float(self._meshcat.GetSliderValue(label))

    def _show_error(self) -> None:
        """Display the position error, and its RMS value over the last seconds."""
        context = self.simulator.get_context()
        reference = Reference(*self._diagram.GetOutputPort("reference").Eval(context))
        error = 100.0 * float(np.linalg.norm(positions(self.state) - positions(reference)))
        self._errors = [*self._errors, error][-round(_ERROR_WINDOW / _FRAME_PERIOD) :]
        for label, shown in zip(_ERROR_LABELS, (error, float(np.sqrt(np.mean(np.square(self._errors))))), strict=True):
            self._meshcat.SetSliderValue(label, min(shown, _MAX_SHOWN_ERROR))


def _with_failing_motor(scenario: Scenario) -> Scenario:
    """Return the scenario with a motor failure after the end of the flight, unless it already contains a failure.

    A click on the button sets the time of the failure to the current time.
    """
    vehicle: Any = scenario.vehicle
    if vehicle.rotor_failure is not None:
        return scenario
    failure = RotorFailureEffect(rotor=1.0, time=MAX_DURATION, speed_factor=0.0)
    return scenario.model_copy(update={"vehicle": vehicle.model_copy(update={"rotor_failure": failure})})


def _position_gains(scenario: Scenario) -> Iterator[_Gain]:
    """Yield the gains of the position controller, which are its fields with names that begin with k_."""
    cascade = scenario.control.cascade()
    if cascade is None:
        return
    for name in type(cascade.position).model_fields:
        value = getattr(cascade.position, name)
        if name.startswith("k_"):
            path = f"control.position.{name}"
            yield _Gain(
                f"{name} (factor)", tuple(f"{path}.{i}" for i in range(3)) if isinstance(value, tuple) else (path,)
            )
