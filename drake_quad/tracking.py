"""The wiring: a scenario in, a named Diagram out.

reference ──▶ control ──▶ laboratory
│            ▲             │
│            └─measurement─┘
└──▶ monitor, recorder ◀── (all of them)
"""

import math
from typing import Any

from pydrake.systems.framework import Diagram, DiagramBuilder

from drake_quad.control.attitude import AttitudeController
from drake_quad.control.cascade import build_cascade
from drake_quad.control.position import build_position_controller
from drake_quad.control.thrust_vectoring import ThrustLimits, ThrustVectoring
from drake_quad.laboratory.command_link import CommandLink
from drake_quad.laboratory.flight_monitor import CrashLimits, FlightMonitor
from drake_quad.laboratory.laboratory import build_laboratory
from drake_quad.laboratory.motion_capture import MotionCapture
from drake_quad.laboratory.recorder import build_recorder
from drake_quad.planning import plan_route, vehicle_parameters
from drake_quad.reference.plan import Plan
from drake_quad.reference.source import build_reference
from drake_quad.scenario import Scenario
from drake_quad.vehicle.allocation import Allocation, RotorModel
from drake_quad.vehicle.parameters import QuadrotorParameters
from drake_quad.vehicle.quadrotor import Quadrotor

# What is exported, and recorded, from each part; a control of the user's own need only have `wrench`.
_SIGNALS = {
    "reference": ("reference",),
    "control": ("error", "error_rate", "pd", "correction", "acceleration_command", "attitude_command", "wrench"),
    "laboratory": ("measurement", "state", "rotor_speed", "rotor_speed_command", "shortfall", "wind"),
    "monitor": ("crashed",),
}


def build_tracking_diagram(
    scenario: Scenario,
    num_vehicles: int = 1,
    *,
    position_controller: Any = None,
    control: Any = None,
    plan: Plan | None = None,
    record: bool = False,
) -> Diagram:
    """Builds the closed loop of a scenario.

    Its subsystems are `reference`, `control`, `laboratory`, `monitor` and, if asked for, `recorder`. Every signal of
    the loop is exported under its name; what the control does not have is left out. The default context is hover at
    the reference's first point.

    Args:
        scenario: with numbers only, no distributions.
        num_vehicles: N; all fly the same scenario.
        position_controller: a system that stands in for the scenario's: from `measurement` (12 rows) and `reference`
            (11 rows) to `acceleration_command` (3 rows, m/s²). The diagram takes it over.
        control: a system that stands in for the whole cascade: from `measurement` and `reference` to `wrench`
            (4 rows: F_z in N; τ_x, τ_y, τ_z in N m). The diagram takes it over.
        plan: flown instead of that of the scenario's route.
        record: whether to add a recorder of all signals, sampled at every tick of the control.

    Raises:
        InputError: the scenario holds a distribution, or the rotors cannot fly the route.
    """
    plan = plan or plan_route(scenario)
    parameters = vehicle_parameters(scenario)
    own_control = control if control is not None else _control(scenario, num_vehicles, parameters, position_controller)

    builder = DiagramBuilder()
    parts = {
        "reference": build_reference(plan, num_vehicles=num_vehicles),
        "control": own_control,
        "laboratory": _laboratory(scenario, num_vehicles, parameters, plan),
        "monitor": _monitor(scenario, num_vehicles),
    }
    for name, part in parts.items():
        builder.AddNamedSystem(name, part)
    sources = {
        name: parts[part].GetOutputPort(name)
        for part, names in _SIGNALS.items()
        for name in names
        if parts[part].HasOutputPort(name)
    }
    jerk = parts["reference"].GetOutputPort("reference_jerk")
    for part in ("control", "laboratory", "monitor"):
        for i in range(parts[part].num_input_ports()):
            port = parts[part].get_input_port(i)
            name = port.get_name()
            if name in sources:
                builder.Connect(sources[name], port)
            elif name == "reference_jerk":
                builder.Connect(jerk, port)
    for name, port in sources.items():
        builder.ExportOutput(port, name)
    if record:
        _add_recorder(builder, sources, scenario.laboratory.command_link.period)
    diagram = builder.Build()
    diagram.set_name(scenario.name)
    return diagram


def _control(
    scenario: Scenario, num_vehicles: int, parameters: QuadrotorParameters, position_controller: Any
) -> Diagram:
    position, attitude = scenario.control.position, scenario.control.attitude
    if position_controller is None:
        position_controller = build_position_controller(
            num_vehicles=num_vehicles,
            k_p=position.k_p,
            k_d=position.k_d,
            derivative=position.derivative,
            feed_forward=position.feed_forward,
        )
    limits = scenario.control.thrust_vectoring
    weight = parameters.mass * parameters.gravity
    thrust_vectoring = ThrustVectoring(
        num_vehicles=num_vehicles,
        mass=parameters.mass,
        gravity=parameters.gravity,
        limits=ThrustLimits(math.tan(limits.max_tilt), limits.min_thrust * weight, limits.max_thrust * weight),
    )
    attitude_controller = AttitudeController(
        num_vehicles=num_vehicles, k_p=attitude.k_p, k_d=attitude.k_d, inertia=parameters.inertia
    )
    return build_cascade(
        position=position_controller,
        thrust_vectoring=thrust_vectoring,
        attitude=attitude_controller,
        follow_jerk=position.feed_forward == "jerk",
    )


def _laboratory(scenario: Scenario, num_vehicles: int, parameters: QuadrotorParameters, plan: Plan) -> Diagram:
    link = scenario.laboratory.command_link
    return build_laboratory(
        vehicle=Quadrotor(
            num_vehicles=num_vehicles,
            time_step=scenario.vehicle.time_step,
            kinematics=scenario.vehicle.attitude_kinematics,
            parameters=parameters,
            initial_position=plan.waypoints[0],
            initial_yaw=plan.initial_yaw,
        ),
        allocation=Allocation(num_vehicles=num_vehicles, rotors=RotorModel.of(parameters)),
        motion_capture=MotionCapture(num_vehicles=num_vehicles, period=scenario.laboratory.motion_capture.period),
        command_link=CommandLink(
            num_vehicles=num_vehicles,
            period=link.period,
            delay_ticks=link.delay_ticks,
            initial=(parameters.mass * parameters.gravity, 0.0, 0.0, 0.0),
        ),
    )


def _monitor(scenario: Scenario, num_vehicles: int) -> Any:
    window, crash = scenario.metrics, scenario.crash
    return FlightMonitor(
        num_vehicles=num_vehicles,
        period=scenario.laboratory.command_link.period,
        limits=CrashLimits(crash.tilt, crash.position_error, crash.height),
        window=(window.start, math.inf if window.end is None else window.end),
    )


def _add_recorder(builder: DiagramBuilder, sources: dict[str, Any], period: float) -> None:
    sizes = {name: port.size() for name, port in sources.items()}
    recorder = builder.AddNamedSystem("recorder", build_recorder(sizes, period=period))
    for name, port in sources.items():
        builder.Connect(port, recorder.GetInputPort(name))
