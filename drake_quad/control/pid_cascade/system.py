"""System `PidCascade`, whose loops may run at a lower rate than the control ticks."""

from typing import Any, NamedTuple

from pydrake.systems.framework import Diagram, DiagramBuilder

from drake_quad.control.pid_cascade.acceleration import acceleration_target
from drake_quad.control.pid_cascade.parameters import (
    CascadeMemory,
    CascadeParameters,
    CascadeRules,
    TiltParameters,
    empty_memory,
)
from drake_quad.control.pid_cascade.tilt import tilt_target
from drake_quad.framework.elementary import where
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.framework.records import layout_of
from drake_quad.framework.wiring import build
from drake_quad.geometry.axes import BodyAxes, times
from drake_quad.signals import Acceleration, AttitudeTarget, Number, Reference, State, Time


class CascadeState(NamedTuple):
    """State of a cascade.

    Attributes:
        ticks: number of ticks since the target was computed; None if it is computed at every tick.
        target: target that is held until the next computation; None if it is computed at every tick.
        memory: state of the loops.
    """

    ticks: Number | None
    target: AttitudeTarget | None
    memory: CascadeMemory


def initial_state(parameters: CascadeParameters, num_ticks: int) -> CascadeState:
    """Return the state of a PID cascade before its first tick."""
    if num_ticks == 1:
        return CascadeState(None, None, empty_memory(parameters))
    target = AttitudeTarget(parameters.mass * parameters.gravity, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    return CascadeState(0.0, target, empty_memory(parameters))


def step_cascade(
    m: State,
    r: Reference,
    parameters: CascadeParameters,
    cascade: CascadeState | None,
    tick: Time,
    num_ticks: int,
    rules: CascadeRules,
) -> tuple[AttitudeTarget, CascadeState]:
    """Return the target of a tick, and the state after it.

    Args:
        m: measured state.
        r: reference.
        parameters: parameters of the cascade.
        cascade: state of the cascade before the tick; None if the cascade has no state.
        tick: control period, s.
        num_ticks: period of the loops in ticks.
        rules: options in which the control laws of firmwares differ.
    """
    memory = empty_memory(parameters) if cascade is None else cascade.memory
    tilts = isinstance(parameters.command, TiltParameters)
    law = tilt_target if tilts else acceleration_target
    target, after = law(m, r, parameters, memory, num_ticks * tick, rules)
    if cascade is None or cascade.ticks is None or cascade.target is None:
        return target, CascadeState(None, None, after)
    is_due = cascade.ticks < 0.5
    target, after = where(is_due, (target, after), (cascade.target, memory))
    if tilts:
        target = target._replace(yaw=r.yaw)
    ticks = where(cascade.ticks > num_ticks - 1.5, 0.0, cascade.ticks + 1.0)
    return target, CascadeState(ticks, target, after)


def _target(*reads: Any) -> AttitudeTarget:
    target, _ = step_cascade(*reads)
    return target


def _acceleration(*reads: Any) -> Acceleration:
    _, _, parameters, *_ = reads
    thrust, roll, pitch, yaw, *_ = _target(*reads)
    x, y, z = times(thrust / parameters.mass, BodyAxes.of(roll, pitch, yaw).z)
    return Acceleration(x, y, z - parameters.gravity)


def _next_state(*reads: Any) -> CascadeState:
    _, cascade = step_cascade(*reads)
    return cascade


@fleet_system(float, AutoDiffXd)
class PidCascade(FleetSystem):
    """PIDs on position and velocity that command an attitude, for an autopilot on board.

    .. pydrake_system::

        name: PidCascade
        input_ports:
        - measurement
        - reference
        output_ports:
        - attitude_target
        - acceleration_command

    The position loop converts the position error to a velocity. The velocity loop converts the velocity error to an
    attitude and a thrust, by the law of `drake_quad.control.pid_cascade.tilt` or of
    `drake_quad.control.pid_cascade.acceleration`. The loops for attitude and body rates are on board.
    `acceleration_command` is the acceleration of the nominal vehicle at the commanded attitude and thrust.

    The loops are computed at every `num_ticks`-th tick. Between these ticks `attitude_target` is held. If the velocity
    loop commands a tilt, the yaw is not held but is the yaw of the reference at every tick.

    The state `cascade` exists if a loop has a memory or the target is held. The only parameter of the context is
    `parameters`.

    Args:
        num_vehicles: number of vehicles N.
        tick: control period, s.
        num_ticks: period of the loops in ticks.
        rules: options in which the control laws of firmwares differ.
        parameters: gains, limits, and parameters of the nominal vehicle.
    """

    def declare(
        self,
        *,
        tick: float = 0.02,
        num_ticks: int = 1,
        rules: CascadeRules = CascadeRules(),
        parameters: CascadeParameters,
    ) -> None:
        """Declare the ports, state and parameters of this system."""
        parameter = self.parameter("parameters", lambda parameters: parameters)
        cascade = None
        if layout_of(CascadeState, initial_state(parameters, num_ticks)).num_rows:
            cascade = self.state("cascade", lambda parameters: initial_state(parameters, num_ticks))
        reads = self.input("measurement"), self.input("reference"), parameter, cascade, tick, num_ticks, rules
        if cascade is not None:
            self.update(tick, _next_state, *reads, writes=[cascade])
        self.output("attitude_target", _target, *reads)
        self.output("acceleration_command", _acceleration, *reads)


def build_pid_cascade(cascade: Any) -> Diagram:
    """Return the diagram `control` with a `PidCascade`."""
    builder = DiagramBuilder()
    builder.AddNamedSystem("cascade", cascade)
    for name in ("measurement", "reference"):
        builder.ExportInput(cascade.GetInputPort(name), name)
    for name in ("attitude_target", "acceleration_command"):
        builder.ExportOutput(cascade.GetOutputPort(name), name)
    return build(builder, "control")
