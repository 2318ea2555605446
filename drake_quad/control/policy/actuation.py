"""Systems that convert policy actions to commands.

There is one system for each type of action, and two for body rates, with the rate loop on the ground or on board. The
equations are in `drake_quad.control.policy.actions`. The only parameter of the context is `scale`.
"""

from drake_quad.control.policy.actions import (
    AccelerationScale,
    AttitudeScale,
    RatesScale,
    SpeedScale,
    commanded_acceleration,
    commanded_attitude,
    offboard_rate_command,
    onboard_rate_command,
    wrench_of_speeds,
)
from drake_quad.control.policy.frames import LevelFrame
from drake_quad.control.thrust_vectoring import VectoringOutput
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, Input, Parameter, fleet_system
from drake_quad.framework.records import rows_layout


def _declare_action(system: FleetSystem, num_rows: int = 4) -> tuple[Input, Parameter]:
    """Declare the input port `action` and the parameter `scale` of a system."""
    action = system.input("action", layout=rows_layout(num_rows))
    return action, system.parameter("scale", lambda scale: scale)


@fleet_system(float, AutoDiffXd)
class AccelerationActuation(FleetSystem):
    """Conversion of an action along the axes of a frame to a commanded acceleration in W.

    .. pydrake_system::

        name: AccelerationActuation
        input_ports:
        - action
        - measurement
        - reference
        output_ports:
        - acceleration_command

    The ports `measurement` and `reference` do not exist with the frame `world`.

    Args:
        num_vehicles: number of vehicles N.
        frame: name of a frame of `drake_quad.control.policy.frames`.
        turn: additional rotation of `heading` and `reference_heading` about Z, rad.
        parameters: accelerations that an action of 1 commands.
    """

    def declare(self, *, frame: LevelFrame = "world", turn: float = 0.0, parameters: AccelerationScale) -> None:
        """Declare the ports and parameters of this system."""
        action, scale = _declare_action(self, num_rows=3)
        heading_inputs = (None, None) if frame == "world" else (self.input("measurement"), self.input("reference"))
        self.output("acceleration_command", commanded_acceleration, action, *heading_inputs, scale, frame, turn)


@fleet_system(float, AutoDiffXd)
class AttitudeActuation(FleetSystem):
    """Conversion of an action to thrust and attitude, which replaces a `ThrustVectoring`.

    .. pydrake_system::

        name: AttitudeActuation
        input_ports:
        - action
        - reference
        output_ports:
        - thrust_and_attitude

    The yaw of the action is relative to the yaw of the `reference`. The output contains all signals of
    `VectoringOutput`, with zero body rates and angular accelerations.

    Args:
        num_vehicles: number of vehicles N.
        parameters: thrusts and angles for actions of -1 and 1.
    """

    def declare(self, *, parameters: AttitudeScale) -> None:
        """Declare the ports, states and parameters of this system."""
        action, scale = _declare_action(self)
        self.packed_output(
            "thrust_and_attitude", VectoringOutput, commanded_attitude, action, self.input("reference"), scale
        )


@fleet_system(float, AutoDiffXd)
class OffboardRateActuation(FleetSystem):
    """Conversion of an action to a wrench, with a body rate loop on the ground.

    .. pydrake_system::

        name: OffboardRateActuation
        input_ports:
        - action
        - measurement
        output_ports:
        - wrench

    The action commands thrust and body rates.

    Args:
        num_vehicles: number of vehicles N.
        parameters: thrusts and body rates for actions of -1 and 1, and parameters of the loop.
    """

    def declare(self, *, parameters: RatesScale) -> None:
        """Declare the ports, states and parameters of this system."""
        action, scale = _declare_action(self)
        self.output("wrench", offboard_rate_command, action, self.input("measurement"), scale)


@fleet_system(float, AutoDiffXd)
class OnboardRateActuation(FleetSystem):
    """Conversion of an action to thrust and body rates, for an autopilot that does not control the attitude.

    .. pydrake_system::

        name: OnboardRateActuation
        input_ports:
        - action
        output_ports:
        - attitude_target

    Args:
        num_vehicles: number of vehicles N.
        parameters: thrusts and body rates for actions of -1 and 1.
    """

    def declare(self, *, parameters: RatesScale) -> None:
        """Declare the ports, states and parameters of this system."""
        self.output("attitude_target", onboard_rate_command, *_declare_action(self))


@fleet_system(float, AutoDiffXd)
class RotorSpeedActuation(FleetSystem):
    """Conversion of an action, which commands rotor speeds, to the wrench of the nominal vehicle at these speeds.

    .. pydrake_system::

        name: RotorSpeedActuation
        input_ports:
        - action
        output_ports:
        - wrench

    The allocation on board converts this wrench back to the same speeds.

    Args:
        num_vehicles: number of vehicles N.
        order: index of each rotor's speed in the action.
        parameters: rotor speeds for actions of -1 and 1.
    """

    def declare(self, *, order: tuple[int, ...] = (0, 1, 2, 3), parameters: SpeedScale) -> None:
        """Declare the ports, states and parameters of this system."""
        self.output("wrench", wrench_of_speeds, *_declare_action(self), order)
