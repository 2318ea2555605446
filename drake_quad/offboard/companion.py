"""Reference and controller of a scenario on a companion computer, advanced tick by tick."""

from typing import Any, Literal, NamedTuple

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from drake_quad.assembly.control import build_control, control_recipes
from drake_quad.errors import InputError, join_names
from drake_quad.firmware.pilot import rate_command
from drake_quad.flight.mission import plan_route
from drake_quad.framework.wiring import build
from drake_quad.offboard.limits import Limits, with_limited_tilt
from drake_quad.planning.duration import flight_duration
from drake_quad.planning.nominal import nominal_parameters
from drake_quad.reference.source import build_reference
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.models import Scenario
from drake_quad.signals import AttitudeTarget, BodyRates, Reference, State

Setpoint = Literal["position", "attitude", "rates"]
"""Kinds of setpoints."""
SETPOINTS: tuple[Setpoint, ...] = ("position", "attitude", "rates")
# Gains from an error of the attitude to a body rate, for setpoints of body rates: the defaults of PX4's parameters
# MC_ROLL_P and MC_YAW_P.
_ATTITUDE_GAIN, _YAW_GAIN = 6.5, 2.8  # 1/s
_MEASUREMENTS = ("measurement", "state")


class Command(NamedTuple):
    """Command of a tick.

    Attributes:
        reference: reference in the coordinates of the route.
        target: command of the controller; None if only the reference is sent.
        rates: body rates, for setpoints of body rates.
        thrust: thrust relative to the weight of the nominal vehicle.
        tilt_is_limited: True if the controller commanded a larger tilt.
    """

    reference: Reference
    target: AttitudeTarget | None = None
    rates: BodyRates | None = None
    thrust: float = 1.0
    tilt_is_limited: bool = False


class Companion:
    """Reference and controller of a scenario, advanced tick by tick.

    Args:
        scenario: scenario with the route and the controller.
        setpoint: kind of setpoints that are sent.
        max_tilt: largest commanded tilt, rad.

    Attributes:
        scenario: the scenario.
        setpoint: kind of setpoints.
        plan: plan of the route.
        period: time between ticks, s.
        duration: duration of the flight, s.

    Raises:
        InputError: if the route cannot be flown, or the controller does not fit the kind of setpoints.
    """

    def __init__(self, scenario: Scenario, setpoint: Setpoint, max_tilt: float = Limits().tilt) -> None:
        self.scenario, self.setpoint, self._max_tilt = scenario, setpoint, max_tilt
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

    def _add_control(self, builder: DiagramBuilder, reference: Any) -> None:
        scenario, setpoint = self.scenario, self.setpoint
        if scenario.laboratory.autopilot.command != "attitude_target":
            raise InputError(
                f"the controller of {scenario.name} commands thrust and torques, which MAVLink cannot transmit to an"
                " autopilot; send position setpoints, or choose a scenario with laboratory.autopilot"
            )
        if setpoint == "attitude" and not self._follows_attitude:
            raise InputError(f"the controller of {scenario.name} commands body rates without an attitude; send rates")
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
                f"the controller of {scenario.name} needs {join_names(unknown)}, which a vehicle with MAVLink does not"
                " send at the rate of a controller"
            )
        builder.ExportOutput(control.GetOutputPort("attitude_target"), "attitude_target")

    @property
    def num_ticks(self) -> int:
        """Number of ticks in the flight."""
        return round(self.duration / self.period)

    def reference_at(self, time: float) -> Reference:
        """Return the reference at a time of the flight, s."""
        return Reference(*self._trajectory.value(time)[: len(Reference._fields), 0].tolist())

    def positions(self) -> np.ndarray:
        """Return the positions (ticks, 3) of the route in the flight, m."""
        times = np.arange(self.num_ticks + 1) * self.period
        return np.array([self._trajectory.value(time)[:3, 0] for time in times])

    def step(self, state: State) -> Command:
        """Return the command of the present tick, and advance.

        Args:
            state: measured state in the coordinates of the route.
        """
        for port in self._measurements:
            port.FixValue(self._context, np.array(state))
        reference = Reference(*self._reference.Eval(self._context).tolist())
        command = Command(reference)
        if self._target is not None:
            commanded = AttitudeTarget(*self._target.Eval(self._context).tolist())
            target = with_limited_tilt(commanded, self._max_tilt)
            rates = rate_command(target, state, _ATTITUDE_GAIN, _YAW_GAIN, self._follows_attitude)
            command = Command(
                reference,
                target,
                BodyRates(*map(float, rates)),
                target.thrust / self._weight,
                target is not commanded,
            )
        self._tick += 1
        self._simulator.AdvanceTo(self._tick * self.period)
        return command
