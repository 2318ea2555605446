"""The loop of a scenario at rest: its equilibrium, its linear model, and the plants that its controllers act on."""

from typing import Any, NamedTuple

import numpy as np
from pydrake.systems.framework import Diagram

from drake_quad import parts
from drake_quad.analysis.sampled_system import SampledSystem, at_tick, linearize
from drake_quad.analysis.state_vector import StateVector
from drake_quad.errors import InputError
from drake_quad.laboratory.tape import Samples
from drake_quad.planning import nominal_parameters, plan_route
from drake_quad.scenario import Scenario, distributions_in
from drake_quad.scenario.models import Airframe, Vehicle, Window
from drake_quad.scenario.routes import HoverRoute
from drake_quad.tracking import build_tracking_diagram

# They watch the loop and do not act on it.
WATCHERS = ("monitor", "recorder")
# Ticks after which the equilibrium is sought (the first grids that do not quite coincide are behind), and how still
# everything must be (in SI units over a period) to be called one.
_TICKS, _STILL = 4, 1e-9


class ClosedLoop(NamedTuple):
    """A diagram in equilibrium.

    Attributes:
        diagram: of the closed loop.
        context: at a tick, before its events.
        system: what `linearize` makes of it: x⁺ = A x over a tick of the control.
    """

    diagram: Diagram
    context: Any
    system: SampledSystem


def at_rest(scenario: Scenario) -> Scenario:
    """The scenario in hover, without what is random and what changes with time.

    Left out are noise, lost frames and packets, turbulence, gusts, battery sag and rotor failures; delays, lags,
    filters, drag, errors of the vehicle, fans and steady wind stay.

    Raises:
        InputError: the scenario holds a distribution.
    """
    for path in distributions_in(scenario):
        if not path.startswith("route."):
            raise InputError(f"{path} is a distribution; a linear model needs a number there")
    cameras, link, wind = (
        scenario.laboratory.motion_capture,
        scenario.laboratory.command_link,
        scenario.laboratory.wind,
    )
    still = [
        source.model_copy(update={"turbulence": 0.0}) if source.kind == "fan" else source
        for source in wind
        if source.kind in ("steady", "fan")
    ]
    laboratory = scenario.laboratory.model_copy(
        update={
            "motion_capture": cameras.model_copy(
                update={"position_noise": 0.0, "attitude_noise": 0.0, "dropout_rate": 0.0}
            ),
            "command_link": link.model_copy(update={"loss_rate": 0.0}),
            "wind": tuple(still),
        }
    )
    vehicle = scenario.vehicle.model_copy(update={"battery_sag": 0.0, "rotor_failure": None})
    route = HoverRoute(kind="hover", position=(0.0, 0.0, 1.0))
    nowhere = scenario.crash.model_copy(update={"position_error": 1e6, "height": -1e6})
    return scenario.model_copy(
        update={
            "route": route,
            "vehicle": vehicle,
            "laboratory": laboratory,
            "duration": None,
            "sample": None,
            "crash": nowhere,
            "metrics": Window(),
        }
    )


def as_believed(scenario: Scenario) -> Scenario:
    """The scenario in hover in still air with the vehicle that the ground believes in, for design.

    Of the vehicle as it is, only what the ground knows besides `nominal` stays: the lag of the rotors and the drag.
    """
    resting = at_rest(scenario)
    believed = {name: getattr(resting.nominal, name) for name in Airframe.model_fields}
    kept = ("rotor_time_constant", "linear_drag", "quadratic_drag", "attitude_kinematics", "time_step")
    vehicle = Vehicle().model_copy(update=believed | {name: getattr(resting.vehicle, name) for name in kept})
    cameras = resting.laboratory.motion_capture.model_copy(update={"misalignment": (0.0, 0.0, 0.0)})
    laboratory = resting.laboratory.model_copy(update={"wind": (), "motion_capture": cameras})
    return resting.model_copy(update={"vehicle": vehicle, "laboratory": laboratory})


def closed_loop(scenario: Scenario, *, position_controller: Any = None, control: Any = None) -> ClosedLoop:
    """Finds the equilibrium of a scenario's loop at rest and linearises it there.

    Newton's method on x = Φ(x), from hover at the reference: in wind or with an uneven vehicle a PD settles beside it.

    Args:
        scenario: flown `at_rest`.
        position_controller: stands in for the scenario's; see `build_tracking_diagram`.
        control: stands in for the whole cascade; likewise.

    Raises:
        InputError: the loop has no equilibrium near hover, or cannot be differentiated.
    """
    resting = at_rest(scenario)
    diagram = build_tracking_diagram(resting, position_controller=position_controller, control=control)
    period = resting.laboratory.command_link.period
    context = at_tick(diagram, _TICKS * period)
    layout = StateVector(diagram, without=WATCHERS)
    for _ in range(20):
        system, moved = linearize(diagram, context, period=period, without=WATCHERS)
        worst = int(np.argmax(np.abs(moved)))
        if np.abs(moved[worst]) < _STILL:
            return ClosedLoop(diagram, context, system)
        if not (np.isfinite(moved).all() and np.isfinite(system.A).all()):
            break
        step = np.linalg.lstsq(np.eye(len(moved)) - system.A, moved, rcond=None)[0]
        layout.write(diagram, context, layout.read(diagram, context) + step)
    raise InputError(
        f"the loop of {scenario.name} has no equilibrium near hover: {layout.names[worst]} still moves by"
        f" {moved[worst]:.3g} a tick"
    )


def laboratory_plant(scenario: Scenario) -> SampledSystem:
    """The linear model of a scenario's laboratory `as_believed`, from `wrench` to `measurement`, over a tick.

    The rotors' four states are turned into the thrust and the torques that they stand for, so that at hover the axes
    come apart.
    """
    believed = as_believed(scenario)
    if believed.vehicle.time_step == 0.0:
        raise InputError("vehicle.time_step is 0, but gains are designed for a vehicle that steps")
    parameters = nominal_parameters(believed)
    plan = plan_route(believed)
    laboratory = parts.laboratory(believed, plan, plan.duration, Samples(0, [0]))
    context = laboratory.CreateDefaultContext()
    laboratory.GetInputPort("wrench").FixValue(context, [parameters.mass * parameters.gravity, 0.0, 0.0, 0.0])
    period = believed.laboratory.command_link.period
    at_tick(laboratory, _TICKS * period, context)
    system, moved = linearize(laboratory, context, period=period, inputs=["wrench"], outputs=["measurement"])
    worst = int(np.argmax(np.abs(moved)))
    if not np.abs(moved[worst]) < _STILL:
        raise InputError(
            f"hover is not an equilibrium of {scenario.name}: {system.states[worst]} moves by {moved[worst]:.3g} a tick"
        )
    rotors = [system.states.index(f"vehicle.rotor_speed.{i}") for i in (1, 2, 3, 4)]
    # From rotor speeds to four times the mean, and to the differences that make roll, pitch and yaw torque, eq (5).
    pattern = np.array([[1.0, 1.0, 1.0, 1.0], [0.0, -1.0, 0.0, 1.0], [-1.0, 0.0, 1.0, 0.0], [1.0, -1.0, 1.0, -1.0]])
    names = [f"vehicle.rotors.{name}" for name in ("thrust", "tau_x", "tau_y", "tau_z")]
    return system.transformed(rotors, pattern, names)
