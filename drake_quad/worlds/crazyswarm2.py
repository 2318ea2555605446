"""Back end for the simulation of Crazyswarm2 (`crazyflie_sim`), with the vehicles and the downwash of this library.

Crazyswarm2 imports the class `Backend` from the module `crazyflie_sim.backend.NAME`, where NAME is the parameter
`sim.backend`. This module needs only one line:

    from drake_quad.worlds.crazyswarm2 import Backend

The firmware's controllers, which Crazyswarm2 runs, command the speeds of the motors. This back end computes the motion
of the vehicles. It was tested with a stand-in for Crazyswarm2, whose interface is that of commit f6154e2 (July 2026).
"""

import math
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
from pydrake.systems.analysis import Simulator

from drake_quad.assembly.laboratory import vehicle_parameters
from drake_quad.errors import InputError
from drake_quad.firmware.crazyflie.system import MIXER
from drake_quad.firmware.motors import motors_of_rotors
from drake_quad.geometry.quaternion import Quaternion
from drake_quad.planning.nominal import nominal_parameters
from drake_quad.scenario.batch import median_scenario
from drake_quad.scenario.files.loading import load_undesigned
from drake_quad.signals import RotorSpeed, State
from drake_quad.vehicle.downwash import CRAZYFLIE_DOWNWASH, DownwashParameters, downwash_force
from drake_quad.vehicle.external_load import ExternalLoad
from drake_quad.vehicle.quadrotor import Quadrotor, QuadrotorConfig

_RPM = 2.0 * math.pi / 60.0  # rad/s; one revolution per minute


class Backend:
    """Physics of the vehicles in Crazyswarm2's simulation.

    A vehicle below the height 0 rests on the ground, level and without velocity.

    Args:
        node: node of ROS, which publishes the time; None to publish nothing.
        names: names of the vehicles.
        states: initial states of the vehicles, of Crazyswarm2's class `State`: position and velocity in the world (m,
            m/s), quaternion from the body to the world, and body rates (rad/s).

    Attributes:
        vehicle: file or name of the scenario with the vehicles, a class attribute that subclasses may replace. Random
            parameters have their medians.
        downwash: coefficients of the downwash; None for vehicles without downwash.
        dt: duration of a step, s.

    Raises:
        InputError: if the rotors of the vehicle do not fit the firmware, or the vehicle is commanded by throttles.
    """

    vehicle: ClassVar[str] = "vehicles/crazyflie"
    downwash: ClassVar[DownwashParameters | None] = CRAZYFLIE_DOWNWASH
    dt = 0.0005

    def __init__(self, node: Any, names: Sequence[str], states: Sequence[Any]) -> None:
        self.node, self.names = node, [*names]
        if not len(names) or len(names) != len(states):
            raise InputError(f"there are {len(names)} names and {len(states)} states; give a state for each vehicle")
        scenario = median_scenario(load_undesigned(self.vehicle))
        vehicle = scenario.vehicle
        if vehicle.motors.take_throttles:
            raise InputError(
                f"the vehicle {self.vehicle} has motors with throttles, but Crazyswarm2 commands their speeds"
            )
        self._motors = motors_of_rotors(
            nominal_parameters(scenario).rotors,
            MIXER,
            shape_advice="choose a layout of kind x",
            turns_advice="change rotor_1_turns in nominal.layout",
        )
        effects = vehicle.effect_parameters()
        self._system = Quadrotor(
            len(names),
            time_step=self.dt,
            effects=effects.names,
            has_external_load=True,
            # Crazyswarm2 stops the motors below the smallest thrust.
            parameters=QuadrotorConfig(vehicle_parameters(vehicle)._replace(min_rotor_speed=0.0), effects=effects),
        )
        self._simulator = Simulator(self._system)
        self._context = self._simulator.get_mutable_context()
        self._ports = [self._system.GetInputPort(name) for name in ("rotor_speed_command", "external_load")]
        self._steps = 0
        self._set_rows(np.array([_rows(state) for state in states]).T)
        self._system.set_state(self._context, "rotor_speed", RotorSpeed(0.0, 0.0, 0.0, 0.0))
        self._publish = None if node is None else _clock(node)

    def time(self) -> float:
        """Return the simulated time, s."""
        return self._steps * self.dt

    def step(self, states_desired: Sequence[Any], actions: Sequence[Any]) -> list[Any]:
        """Return the states after a step.

        Args:
            states_desired: desired states, of Crazyswarm2's class `State`, which also is the class of the result.
            actions: speeds of motors 1 to 4 of each vehicle, of Crazyswarm2's class `Action`.
        """
        speeds = _RPM * np.array([action.rpm for action in actions], dtype=float)
        if speeds.shape != (len(self.names), 4) or not np.isfinite(speeds).all():
            raise InputError("each vehicle needs an action with four finite motor speeds")
        loads = self._loads(self._rows())
        for port, values in zip(self._ports, (speeds[:, self._motors].T, loads), strict=True):
            port.FixValue(self._context, values.ravel())
        self._steps += 1
        self._simulator.AdvanceTo(self.time())
        self._simulator.AdvancePendingEvents()
        rows = self._rows()
        below = rows[2] < 0.0
        if below.any():
            yaw = rows[5, below]
            rows[2:, below] = 0.0
            rows[5, below] = yaw
            self._set_rows(rows)
        if self._publish is not None:
            self._publish(self.time())
        kinds = [type(state) for state in states_desired]
        return [_state(kind, State(*column)) for kind, column in zip(kinds, rows.T, strict=True)]

    def shutdown(self) -> None:
        """Do nothing; there is nothing to stop."""

    def _rows(self) -> np.ndarray:
        """Return the states of the vehicles, (12, k)."""
        values = self._system.GetOutputPort("state").Eval(self._context)
        return np.array(values).reshape(12, -1)

    def _set_rows(self, rows: np.ndarray) -> None:
        self._system.set_state(self._context, "state", State(*rows))

    def _loads(self, rows: np.ndarray) -> np.ndarray:
        """Return the loads on the vehicles, (6, k). Vehicles on the ground cause no downwash."""
        loads = np.zeros((len(ExternalLoad._fields), rows.shape[1]))
        if self.downwash is not None:
            lower, upper = State(*rows[:, :, None]), State(*rows[:, None, :])
            forces: Any = downwash_force(lower, upper, self.downwash)
            loads[ExternalLoad._fields.index("f_z")] = -forces[:, rows[2] > 0.0].sum(axis=1)
        return loads


def _rows(state: Any) -> list[float]:
    """Return the 12 components of a `State` of this library, given one of Crazyswarm2."""
    attitude = Quaternion(*state.quat).axes().angles()
    return [*state.pos, *attitude, *state.vel, *state.omega]


def _state(kind: type[Any], state: State) -> Any:
    """Return a state of Crazyswarm2's class."""
    quaternion = Quaternion.of(state.roll, state.pitch, state.yaw)
    position, velocity = [state.x, state.y, state.z], [state.v_x, state.v_y, state.v_z]
    return kind(pos=position, vel=velocity, quat=[*quaternion], omega=[state.p, state.q, state.r])


def _clock(node: Any) -> Any:
    """Return a function that publishes a time (s) as the time of the simulation."""
    from rclpy.time import Time
    from rosgraph_msgs.msg import Clock

    publisher = node.create_publisher(Clock, "clock", 10)

    def publish(time: float) -> None:
        message = Clock()
        message.clock = Time(seconds=time).to_msg()
        publisher.publish(message)

    return publish
