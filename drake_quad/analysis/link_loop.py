"""The loop of a whole control, broken where its commands go over the link: what any latency or gain there would do."""

from dataclasses import replace
from typing import Any

import numpy as np

from drake_quad.analysis.closed_loop import as_believed, laboratory_plant
from drake_quad.analysis.sampled_system import SampledSystem, at_tick, linearize
from drake_quad.assembly.control import build_control, control_recipes
from drake_quad.assembly.planning import plan_route
from drake_quad.errors import InputError
from drake_quad.scenario import Batch, Scenario
from drake_quad.signals import AttitudeTarget, Reference, State, Wrench

_STILL, _TICKS = 1e-9, 4


def link_loop(scenario: Scenario, row: str) -> SampledSystem:
    """L of the loop from one row of what goes over the link back to itself, the other rows at rest.

    For `margins`: a cascade's inner and outer loops, and what a controller estimates, are all in it. Thrust is the loop
    of the height; tau_y or pitch that of x, with the attitude inside it; tau_x or roll that of y; tau_z or yaw its own.

    Args:
        scenario: flown `as_believed`, in hover.
        row: of the `wrench` or, with an autopilot, of the `attitude_target`.

    Raises:
        InputError: there is no such row, or the control or the laboratory does not rest in hover.
    """
    command = scenario.laboratory.autopilot.command
    rows = Wrench._fields if command == "wrench" else AttitudeTarget._fields
    if row not in rows:
        raise InputError(f"{row} does not go over the link, but {', '.join(rows)}")
    control, plant = _control_model(as_believed(scenario), command), laboratory_plant(scenario).system
    measured = [f"measurement.{name}" for name in State._fields]
    return in_series(
        plant.between([f"{command}.{row}"], measured), control.between(measured, [f"{command}.{row}"])
    ).connected()


def in_series(plant: SampledSystem, control: SampledSystem) -> SampledSystem:
    """L = -K G of a plant G, without direct feedthrough, and what acts on all its outputs, K."""
    n, m = len(plant.A), len(control.A)
    return replace(
        plant,
        A=np.block([[plant.A, np.zeros((n, m))], [control.B @ plant.C, control.A]]),
        B=np.vstack([plant.B, np.zeros((m, plant.B.shape[1]))]),
        C=-np.hstack([control.D @ plant.C, control.C]),
        D=np.zeros((len(control.C), plant.B.shape[1])),
        states=(*plant.states, *control.states),
        outputs=control.outputs,
    )


def _control_model(resting: Scenario, command: str) -> SampledSystem:
    """The linear model of a resting scenario's control, from `measurement` to what it sends."""
    plan, period = plan_route(resting), resting.laboratory.command_link.period
    control: Any = build_control(resting, control_recipes(Batch(resting, (0,), {}), plan), 1)
    context = control.CreateDefaultContext()
    x, y, z = plan.waypoints[0]
    hover = State(float(x), float(y), float(z), *(0.0,) * 9)
    control.GetInputPort("measurement").FixValue(context, hover)
    control.GetInputPort("reference").FixValue(context, Reference(hover.x, hover.y, hover.z, *(0.0,) * 8))
    for name in ("reference_jerk", "reference_snap"):
        if control.HasInputPort(name):
            port = control.GetInputPort(name)
            port.FixValue(context, np.zeros(port.size()))
    at_tick(control, _TICKS * period, context)
    system, moved = linearize(control, context, period=period, inputs=["measurement"], outputs=[command])
    if not (np.abs(moved) < _STILL).all():
        raise InputError(f"the control of {resting.name} does not rest in hover")
    return system
