"""Operating points of the vehicle, and linear models at these points.

The inputs are commanded rotor speeds. The models omit throttle curve and battery, which determine these commands. They
include a payload if the vehicle carries it at the beginning of a flight.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from pydrake.autodiffutils import ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.solvers import MathematicalProgram, SnoptSolver
from pydrake.systems.framework import Context, Diagram, DiagramBuilder
from pydrake.systems.primitives import (
    AffineSystem,
    Demultiplexer,
    FirstOrderTaylorApproximation,
    Linearize,
    LinearSystem,
)

from drake_quad.errors import InputError
from drake_quad.geometry.axes import BodyAxes
from drake_quad.linear.context_vector import port_rows, without_dots
from drake_quad.signals import RotorSpeed, State, Wind
from drake_quad.vehicle.dynamics import Motion, hover_rotor_speeds
from drake_quad.vehicle.effects import NO_EFFECTS, Effects, hover_equivalent
from drake_quad.vehicle.motion import accelerations, rotor_state
from drake_quad.vehicle.parameters import QuadrotorParameters
from drake_quad.vehicle.quadrotor import Kinematics, Quadrotor, QuadrotorConfig
from drake_quad.vehicle.slung_load import HANGING_AT_REST, rod_from_swing

if TYPE_CHECKING:
    import control

_NUM_ROTORS = len(RotorSpeed._fields)
_NUM_WIND_COMPONENTS = len(Wind._fields)
OUTPUTS = port_rows("state", len(State._fields))
STATES = (*State._fields, *port_rows("rotor_speed", _NUM_ROTORS))
# Additional states of a vehicle with a slung load.
SWING_STATES = tuple(port_rows("swing", len(HANGING_AT_REST)))
INPUTS = (*port_rows("rotor_speed_command", _NUM_ROTORS), *port_rows("wind", _NUM_WIND_COMPONENTS))
# Largest remaining acceleration at an operating point, m/s² or rad/s².
_TRIM_TOLERANCE = 1e-9
_MAX_TRIM_TILT = 1.4  # rad, largest roll and pitch of an operating point
_NUM_NEWTON_STEPS = 3  # number of Newton steps that refine SNOPT's solution


class Trim(NamedTuple):
    """Operating point in steady straight flight.

    Attributes:
        state: (12,) state of the vehicle.
        rotor_speed: (4,) rotor speeds, rad/s.
        wind: (3,) velocity of the air in W, m/s.
    """

    state: np.ndarray
    rotor_speed: np.ndarray
    wind: np.ndarray


def find_trim(
    parameters: QuadrotorParameters,
    *,
    velocity: Sequence[float] = (0.0, 0.0, 0.0),
    wind: Sequence[float] = (0.0, 0.0, 0.0),
    position: Sequence[float] = (0.0, 0.0, 0.0),
    yaw: float = 0.0,
    kinematics: Kinematics = "exact",
    effects: Effects = NO_EFFECTS,
) -> Trim:
    """Find the roll, pitch and rotor speeds at which velocity and attitude are constant.

    SNOPT finds a solution within the limits of the rotors, and Newton's method refines it.

    Args:
        parameters: parameters of one vehicle.
        velocity: velocity in W, m/s.
        wind: velocity of the air in W, m/s.
        position: position in W, m.
        yaw: yaw, rad.
        kinematics: kinematics of the `Quadrotor`. The trim does not depend on it, since the vehicle does not rotate.
        effects: effects on the vehicle.

    Raises:
        InputError: if there is no trim within the limits of the rotors.
    """
    effects = _effects_at_given_speeds(effects)
    hover = np.array([float(speed) for speed in hover_rotor_speeds(hover_equivalent(parameters, effects, position[2]))])
    scale = np.concatenate([[0.1, 0.1], np.maximum(hover, 1.0)])

    def unbalanced(scaled: np.ndarray) -> np.ndarray:
        """Return linear and angular acceleration (6,), given roll, pitch and rotor speeds in units of `scale`."""
        roll, pitch, *speeds = scaled * scale
        v_x, v_y, v_z = velocity
        axes, motion = BodyAxes.of(roll, pitch, yaw), Motion(v_x, v_y, v_z, 0.0, 0.0, 0.0)
        rotors = rotor_state(RotorSpeed(*speeds), RotorSpeed(*speeds), parameters, effects)
        derivatives = accelerations(
            axes, motion, rod_from_swing(HANGING_AT_REST), position[2], rotors, Wind(*wind), parameters, effects
        )
        return np.array(derivatives.motion)

    program = MathematicalProgram()
    x = program.NewContinuousVariables(6)
    program.AddConstraint(unbalanced, np.zeros(6), np.zeros(6), vars=x)
    slowest, fastest = float(parameters.min_rotor_speed), float(parameters.max_rotor_speed)
    low, high = [-_MAX_TRIM_TILT] * 2 + [slowest] * 4, [_MAX_TRIM_TILT] * 2 + [fastest] * 4
    program.AddBoundingBoxConstraint(low / scale, high / scale, x)
    result = SnoptSolver().Solve(program, np.concatenate([[0.0, 0.0], np.clip(hover, slowest, fastest) / scale[2:]]))
    solution = result.GetSolution(x)
    if result.is_success():
        for _ in range(_NUM_NEWTON_STEPS):
            values = unbalanced(InitializeAutoDiff(solution).ravel())
            solution = solution - np.linalg.solve(ExtractGradient(values), ExtractValue(values).ravel())
    remaining = np.abs(unbalanced(solution)).max()
    if not remaining < _TRIM_TOLERANCE:
        raise InputError(
            f"there is no steady flight at {_vector_text(velocity)} m/s in a wind of {_vector_text(wind)} m/s with"
            f" rotors between {slowest:g} and {fastest:g} rad/s; the smallest remaining acceleration is"
            f" {remaining:.3g} m/s² or rad/s²"
        )
    roll, pitch, *speeds = solution * scale
    state = np.array([*position, roll, pitch, yaw, *velocity, 0.0, 0.0, 0.0], dtype=float)
    return Trim(state, np.array(speeds), np.array(wind, dtype=float))


def linear_vehicle(
    trim: Trim, parameters: QuadrotorParameters, *, kinematics: Kinematics = "exact", effects: Effects = NO_EFFECTS
) -> LinearSystem:
    """Return the linearisation at an equilibrium, by Drake's Linearize.

    The result is a continuous system from `INPUTS` to `OUTPUTS` with `STATES`. A slung load adds `SWING_STATES` at the
    end.

    Raises:
        InputError: if the operating point is not an equilibrium; use `affine_vehicle` there.
    """
    diagram, context = _diagram_at(trim, parameters, kinematics, effects)
    rates = diagram.EvalTimeDerivatives(context).CopyToVector()
    worst = int(np.argmax(np.abs(rates)))
    if not np.abs(rates[worst]) < 1e-6:
        raise InputError(
            f"the operating point is not an equilibrium: {(*STATES, *SWING_STATES)[worst]} changes by"
            f" {rates[worst]:.3g} per second; use affine_vehicle instead"
        )
    return Linearize(diagram, context)


def affine_vehicle(
    trim: Trim, parameters: QuadrotorParameters, *, kinematics: Kinematics = "exact", effects: Effects = NO_EFFECTS
) -> AffineSystem:
    """Return the affine model at any point, ẋ = A x + B u + f₀ and y = C x + D u + y₀.

    The model is computed by Drake's FirstOrderTaylorApproximation.
    """
    diagram, context = _diagram_at(trim, parameters, kinematics, effects)
    return FirstOrderTaylorApproximation(diagram, context)


def to_state_space(system: LinearSystem) -> "control.StateSpace":
    """Return the model as python-control's StateSpace with names, in deviations from the operating point."""
    import control

    states = (*STATES, *SWING_STATES)[: len(system.A())]
    names = {"states": without_dots(states), "inputs": without_dots(INPUTS), "outputs": without_dots(OUTPUTS)}
    return control.ss(system.A(), system.B(), system.C(), system.D(), **names)


def _effects_at_given_speeds(effects: Effects) -> Effects:
    """Return the effects without throttle curve and battery, which have no influence if the rotor speeds are given."""
    return effects._replace(thrust_curve=None, battery=None)


def _diagram_at(
    trim: Trim, parameters: QuadrotorParameters, kinematics: Kinematics, effects: Effects
) -> tuple[Diagram, Context]:
    """Return a diagram of the vehicle with a continuous state, and its context at an operating point.

    The only input port of the diagram contains all inputs of the vehicle: rotor speeds, then wind.
    """
    builder = DiagramBuilder()
    acting = _effects_at_given_speeds(effects)
    config = QuadrotorConfig(parameters, effects=acting)
    vehicle = builder.AddNamedSystem(
        "vehicle", Quadrotor(time_step=0.0, kinematics=kinematics, effects=acting.names, parameters=config)
    )
    inputs = builder.AddNamedSystem("inputs", Demultiplexer([_NUM_ROTORS, _NUM_WIND_COMPONENTS]))
    for i, name in enumerate(("rotor_speed_command", "wind")):
        builder.Connect(inputs.get_output_port(i), vehicle.GetInputPort(name))
    builder.ExportInput(inputs.get_input_port(), "inputs")
    builder.ExportOutput(vehicle.GetOutputPort("state"), "state")
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    hanging = [] if acting.slung_load is None else HANGING_AT_REST
    context.SetContinuousState(np.concatenate([trim.state, trim.rotor_speed, hanging]))
    diagram.get_input_port().FixValue(context, np.concatenate([trim.rotor_speed, trim.wind]))
    return diagram, context


def _vector_text(values: Sequence[float]) -> str:
    return "(" + ", ".join(f"{value:g}" for value in values) + ")"
