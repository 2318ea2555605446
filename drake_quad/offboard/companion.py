"""Reference and controller of a scenario on a companion computer, advanced tick by tick."""

from typing import Any, Literal, NamedTuple, get_args

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from drake_quad.assembly.control import build_control, control_recipes
from drake_quad.errors import InputError, join_names
from drake_quad.firmware.pilot import rate_command
from drake_quad.flight.mission import plan_route
from drake_quad.framework.wiring import build
from drake_quad.offboard.limits import Limits, with_limited_rates, with_limited_tilt
from drake_quad.planning.duration import flight_duration
from drake_quad.planning.nominal import nominal_parameters
from drake_quad.reference.source import build_reference
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.models import Scenario
from drake_quad.signals import AttitudeTarget, BodyRates, Reference, State

Setpoint = Literal["position", "attitude", "rates"]
"""Kinds of setpoints."""
SETPOINTS: tuple[Setpoint, ...] = get_args(Setpoint)
# The attitude loop for setpoints of body rates has the defaults of PX4's MC_ROLL_P and MC_YAW_P.
_ATTITUDE_GAIN = 6.5  # 1/s
_YAW_GAIN = 2.8  # 1/s
_MAX_END_SPEED = 0.3  # m/s; largest speed at the start and at the end of a route
_MEASUREMENTS = ("measurement", "state")


class Command(NamedTuple):
    """Command for one tick.

    Attributes:
        reference: reference in the coordinates of the route.
        target: command of the controller; None if only the reference is sent.
        rates: body rates, for setpoints of body rates.
        thrust: thrust relative to the weight of the nominal vehicle.
        is_limited: True if the tilt or a body rate was reduced to its limit.
    """

    reference: Reference
    target: AttitudeTarget | None = None
    rates: BodyRates | None = None
    thrust: float = 1.0
    is_limited: bool = False


class Companion:
    """Reference and controller of a scenario, advanced tick by tick.

    Args:
        scenario: scenario with the route and the controller.
        setpoint: kind of setpoints that are sent.
        limits: limits on the route and on the commands.

    Attributes:
        scenario: the scenario.
        setpoint: kind of setpoints.
        plan: plan of the route.
        period: time between ticks, s.
        duration: duration of the flight, s.

    Raises:
        InputError: if the route cannot be flown, or the controller does not fit the kind of setpoints.
    """

    def __init__(self, scenario: Scenario, setpoint: Setpoint, limits: Limits = Limits()) -> None:
        self.scenario, self.setpoint, self._limits = scenario, setpoint, limits
        self.plan = plan_route(scenario)
        self.period = scenario.laboratory.command_link.period
        self.duration = flight_duration(scenario, self.plan)
        self._trajectory = self.plan.reference()
        nominal = nominal_parameters(scenario)
        self._weight = float(nominal.mass * nominal.gravity)
        self._follows_attitude = not scenario.control.commands_rates_only()
        builder = DiagramBuilder()
        ahead = () if setpoint == "position" else scenario.control.preview_times()
        reference = builder.AddNamedSystem("reference", build_reference(self.plan, ahead=ahead))
        builder.ExportOutput(reference.GetOutputPort("reference"), "reference")
        if setpoint != "position":
            self._add_control(builder, reference)
        diagram = build(builder, "companion")
        self._simulator = Simulator(diagram)
        self._simulator.Initialize()
        self._context = self._simulator.get_mutable_context()
        self._measurements = [
            port
            for port in (diagram.get_input_port(index) for index in range(diagram.num_input_ports()))
            if port.get_name() in _MEASUREMENTS
        ]
        self._reference = diagram.GetOutputPort("reference")
        self._target = None if setpoint == "position" else diagram.GetOutputPort("attitude_target")
        self._tick = 0
        route = self.route()
        limits.check_reference(route[:, 3:6], route[:, 6:9])
        for row, word in ((route[0], "begins"), (route[-1], "ends")):
            speed = float(np.linalg.norm(row[3:6]))
            if speed > _MAX_END_SPEED:
                raise InputError(
                    f"the route {word} with a speed of {speed:.2g} m/s, but the vehicle hovers before and after it;"
                    " choose a route that begins and ends at rest"
                )

    def _add_control(self, builder: DiagramBuilder, reference: Any) -> None:
        scenario, setpoint = self.scenario, self.setpoint
        if scenario.laboratory.autopilot.command != "attitude_target":
            raise InputError(
                f"the controller of {scenario.name} commands thrust and torques, which this command cannot send to an"
                " autopilot; use --send position, or a scenario whose laboratory.autopilot follows attitudes"
            )
        if setpoint == "attitude" and not self._follows_attitude:
            raise InputError(
                f"the controller of {scenario.name} commands body rates without an attitude; use --send rates"
            )
        batch = Batch.draw(scenario, [scenario.sample or 0])
        control = builder.AddNamedSystem(
            "control", build_control(batch.scenario, control_recipes(batch, self.plan), num_vehicles=1)
        )
        unknown = []
        for port in (control.get_input_port(index) for index in range(control.num_input_ports())):
            name = port.get_name()
            if reference.HasOutputPort(name):
                builder.Connect(reference.GetOutputPort(name), port)
            elif name in _MEASUREMENTS:
                builder.ExportInput(port, name)
            else:
                unknown.append(name)
        if unknown:
            raise InputError(
                f"the controller of {scenario.name} needs {join_names(unknown)}, which the telemetry of MAVLink does"
                " not provide at the control rate"
            )
        builder.ExportOutput(control.GetOutputPort("attitude_target"), "attitude_target")

    @property
    def num_ticks(self) -> int:
        """Number of ticks in the flight."""
        return round(self.duration / self.period)

    def reference_at(self, time: float) -> Reference:
        """Return the reference at a time of the flight, s."""
        return Reference(*self._trajectory.value(time)[: len(Reference._fields), 0].tolist())

    def route(self) -> np.ndarray:
        """Return position, velocity and acceleration of the reference at each tick, (num_ticks + 1, 9)."""
        times = np.arange(self.num_ticks + 1) * self.period
        return np.array([self._trajectory.value(time)[:9, 0] for time in times])

    def warm_up(self) -> None:
        """Compute a command of the first tick, so that libraries are loaded and formulas compiled before the flight."""
        self.command(State(*self.reference_at(0.0)[:3], *[0.0] * 9))

    def command(self, state: State) -> Command:
        """Return the command of the present tick.

        Args:
            state: measured state in the coordinates of the route.
        """
        for port in self._measurements:
            port.FixValue(self._context, np.array(state))
        reference = Reference(*self._reference.Eval(self._context).tolist())
        if self._target is None:
            return Command(reference)
        commanded = AttitudeTarget(*self._target.Eval(self._context).tolist())
        target = with_limited_tilt(commanded, self._limits.tilt) if self._follows_attitude else commanded
        all_rates = BodyRates(
            *map(float, rate_command(target, state, _ATTITUDE_GAIN, _YAW_GAIN, self._follows_attitude))
        )
        rates = with_limited_rates(all_rates, self._limits.rate)
        is_limited = target is not commanded or (self.setpoint == "rates" and rates != all_rates)
        return Command(reference, target, rates, target.thrust / self._weight, is_limited)

    def advance(self) -> None:
        """Advance to the next tick, with the measurement of the last command."""
        self._tick += 1
        self._simulator.AdvanceTo(self._tick * self.period)
