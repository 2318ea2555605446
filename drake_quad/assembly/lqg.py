"""Linear-quadratic-Gaussian control of a scenario."""

from typing import Any

import numpy as np
from pydrake.systems.framework import Diagram, DiagramBuilder

from drake_quad.control.cascade import put_around
from drake_quad.control.lqg.chains import (
    Answer,
    ContinuousModel,
    Disturbances,
    Noise,
    attitude_model,
    lagging_attitude_model,
    torque_model,
    vertical_model,
)
from drake_quad.control.lqg.design import AxisLoop, Timing, axis_loop
from drake_quad.control.lqg.laws import LqgNumbers, TargetNumbers, ThrustNumbers, TorqueNumbers
from drake_quad.control.lqg.system import LinearQuadraticGaussian
from drake_quad.errors import InputError
from drake_quad.framework.recipe import Recipe
from drake_quad.planning.believed import nominal_parameters
from drake_quad.process_settings import without_warnings
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.lqg import Axis, LateralAxis, LqgControl, VerticalAxis
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.quantities import can_differ_from_zero


def lqg_recipes(batch: Batch) -> dict[str, Recipe]:
    """The recipe for the linear-quadratic-Gaussian controller of a scenario, by its path in the diagram.

    Args:
        batch: that is flown.
    """
    scenario, own = batch.scenario, batch.fleet_scenario.control
    control: Any = scenario.control
    times = lqg_timing(scenario)
    believed = nominal_parameters(scenario)
    # A command acts for a tick, in whose middle what is fed forward shall be right.
    lead = (times.delay_ticks + 0.5) * times.tick
    weight = believed.mass * believed.gravity
    thrust = ThrustNumbers(
        believed.mass,
        believed.gravity,
        np.tan(own.max_tilt),
        own.min_thrust * weight,
        own.max_thrust * weight,
        lead + control.vertical.lag,
    )
    torques = target = None
    if own.yaw is not None:
        yaw = own.yaw.k_p, own.yaw.k_d
        torques = TorqueNumbers(*believed.inertia, *yaw, control.max_snap, lead + control.lateral.lag)
    else:
        omega, zeta = control.lateral.natural_frequency, control.lateral.damping
        slower = 2.0 * zeta / omega
        lead += control.lateral.lag or 0.0
        target = TargetNumbers(lead + slower, 0.5 * lead**2 + lead * slower + 1.0 / omega**2)
    lateral = lateral_loop(control.lateral, times, believed.gravity)
    numbers = LqgNumbers(lateral, vertical_loop(control.vertical, times), thrust, torques, target)
    structure = {
        "signal": scenario.laboratory.autopilot.command,
        "period": times.frame,
        "tick": times.tick,
        "takes_correction": control.network is not None,
        "takes_perturbation": control.kind == "mpc",
        "loses_frames": can_differ_from_zero(scenario.laboratory.motion_capture.dropout_rate),
    }
    return {"regulator": Recipe(LinearQuadraticGaussian, structure, numbers)}


def build_lqg_control(regulator: Any, network: Any = None, programme: Any = None) -> Diagram:
    """Builds the diagram `control` with the controller in it, and what stands beside it.

    Args:
        regulator: a `LinearQuadraticGaussian`, which takes a correction if there is a network, and a perturbation if
            there is a programme.
        network: to put around it; None for none.
        programme: that keeps it within its limits, a `PredictiveProgramme`; None for none.
    """
    builder = DiagramBuilder()
    builder.AddNamedSystem("regulator", regulator)
    for port in map(regulator.get_input_port, range(regulator.num_input_ports())):
        if port.get_name() not in ("correction", "learned_disturbance", "perturbation"):
            builder.ExportInput(port, port.get_name())
    if programme is not None:
        builder.AddNamedSystem("programme", programme)
        builder.Connect(regulator.GetOutputPort("deviation"), programme.get_input_port())
        builder.Connect(programme.get_output_port(), regulator.GetInputPort("perturbation"))
    shown = [regulator]
    if network is not None:
        put_around(builder, regulator, network)
        shown.append(network)
    for system in shown:
        for port in map(system.get_output_port, range(system.num_output_ports())):
            builder.ExportOutput(port, port.get_name())
    control = builder.Build()
    control.set_name("control")
    return control


def lqg_timing(scenario: Scenario) -> Timing:
    """When frames and ticks of a scenario with such a controller are, and what it believes of the delay."""
    laboratory, control = scenario.laboratory, scenario.control
    assert isinstance(control, LqgControl)
    return Timing(laboratory.motion_capture.period, laboratory.command_link.period, control.delay_ticks)


def lateral_model(axis: LateralAxis) -> ContinuousModel:
    """What is believed of x and of y."""
    disturbances = _disturbances(axis, Noise(axis.bias.deviation, axis.bias.time))
    if axis.natural_frequency is None or axis.damping is None:
        assert axis.lag is not None
        return torque_model(axis.lag, disturbances)
    answer = Answer(axis.natural_frequency, axis.damping)
    if axis.lag is None:
        return attitude_model(answer, disturbances)
    return lagging_attitude_model(answer, axis.lag, disturbances)


def height_model(axis: VerticalAxis) -> ContinuousModel:
    """What is believed of the height."""
    return vertical_model(axis.lag, _disturbances(axis, None))


def lateral_loop(axis: LateralAxis, times: Timing, gravity: float) -> AxisLoop:
    """Filter and regulator of x and of y.

    Raises:
        InputError: there are none.
    """
    noise = np.array([axis.position_noise, axis.attitude_noise * gravity])
    return _designed("control.lateral", lateral_model(axis), times, noise, axis.command_weight)


def vertical_loop(axis: VerticalAxis, times: Timing) -> AxisLoop:
    """Filter and regulator of the height.

    Raises:
        InputError: there are none.
    """
    return _designed(
        "control.vertical", height_model(axis), times, np.array([axis.position_noise]), axis.command_weight
    )


def _designed(field: str, model: ContinuousModel, times: Timing, noise: np.ndarray, weight: float) -> AxisLoop:
    """Return the loop of an axis.

    Raises:
        InputError: if the times or magnitudes of the axis are too different for floating point.
    """
    try:
        # The warnings of SciPy either precede an error or do not matter.
        with np.errstate(all="ignore"), without_warnings():
            return axis_loop(model, times, noise=noise, command_weight=weight)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise InputError(
            f"{field} has no filter or no regulator: its times, deviations or weights are too far apart"
        ) from error


def _disturbances(axis: Axis, bias: Noise | None) -> Disturbances:
    first, second = (Noise(noise.deviation, noise.time) for noise in (axis.first, axis.second))
    return Disturbances(first, second, bias, axis.command_noise)
