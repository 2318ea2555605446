"""What the actions of a policy command, as systems: one for each kind of action, and one for each way there.

The equations are those of `drake_quad.control.policy.actions`. The only parameter of the context is `scale`.
"""

from drake_quad.control.policy.actions import (
    AccelerationScale,
    AttitudeScale,
    RatesScale,
    SpeedScale,
    commanded_acceleration,
    commanded_attitude,
    rates_from_the_ground,
    rates_on_board,
    wrench_of_speeds,
)
from drake_quad.control.policy.frames import LevelFrame
from drake_quad.control.thrust_vectoring import Vectored
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, Input, Parameter, fleet_system
from drake_quad.framework.records import rows_layout


def _declared(system: FleetSystem, num_rows: int = 4) -> tuple[Input, Parameter]:
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
        num_vehicles: N.
        frame: name of a frame of `drake_quad.control.policy.frames`.
        turn: additional rotation of `heading` and `reference_heading` about Z, rad.
        numbers: accelerations that an action of 1 commands.
    """

    def declare(self, *, frame: LevelFrame = "world", turn: float = 0.0, numbers: AccelerationScale) -> None:
        """Declare ports and parameters."""
        action, scale = _declared(self, num_rows=3)
        heads = (None, None) if frame == "world" else (self.input("measurement"), self.input("reference"))
        self.output("acceleration_command", commanded_acceleration, action, *heads, scale, frame, turn)


@fleet_system(float, AutoDiffXd)
class AttitudeActuation(FleetSystem):
    """The thrust and the attitude that an action commands, in place of a `ThrustVectoring`.

    .. pydrake_system::

        name: AttitudeActuation
        input_ports:
        - action
        - reference
        output_ports:
        - thrust_and_attitude

    The yaw is counted from that of the `reference`. The output packs the signals of `Vectored`: body rates and angular
    accelerations are none.

    Args:
        num_vehicles: N.
        numbers: what actions of -1 and of 1 mean.
    """

    def declare(self, *, numbers: AttitudeScale) -> None:
        """Declare ports, states and parameters."""
        action, scale = _declared(self)
        self.packed_output("thrust_and_attitude", Vectored, commanded_attitude, action, self.input("reference"), scale)


@fleet_system(float, AutoDiffXd)
class RatesFromTheGround(FleetSystem):
    """The wrench for the thrust and the body rates that an action commands: a loop of the rates on the ground.

    .. pydrake_system::

        name: RatesFromTheGround
        input_ports:
        - action
        - measurement
        output_ports:
        - wrench

    Args:
        num_vehicles: N.
        numbers: what actions of -1 and of 1 mean, and the loop.
    """

    def declare(self, *, numbers: RatesScale) -> None:
        """Declare ports, states and parameters."""
        action, scale = _declared(self)
        self.output("wrench", rates_from_the_ground, action, self.input("measurement"), scale)


@fleet_system(float, AutoDiffXd)
class RatesOnBoard(FleetSystem):
    """The thrust and the body rates that an action commands, for an autopilot that heeds no attitude.

    .. pydrake_system::

        name: RatesOnBoard
        input_ports:
        - action
        output_ports:
        - attitude_target

    Args:
        num_vehicles: N.
        numbers: what actions of -1 and of 1 mean.
    """

    def declare(self, *, numbers: RatesScale) -> None:
        """Declare ports, states and parameters."""
        self.output("attitude_target", rates_on_board, *_declared(self))


@fleet_system(float, AutoDiffXd)
class RotorSpeedActuation(FleetSystem):
    """The wrench that rotors of the speeds that an action commands are believed to give.

    .. pydrake_system::

        name: RotorSpeedActuation
        input_ports:
        - action
        output_ports:
        - wrench

    Allocation on board makes the same speeds of it.

    Args:
        num_vehicles: N.
        order: place of each rotor's row in the action.
        numbers: what actions of -1 and of 1 mean.
    """

    def declare(self, *, order: tuple[int, ...] = (0, 1, 2, 3), numbers: SpeedScale) -> None:
        """Declare ports, states and parameters."""
        self.output("wrench", wrench_of_speeds, *_declared(self), order)
