"""Systems that control a vehicle by a trained policy: observation, network, and actuation.

The observation can contain the last action:

    ──▶ observation ──▶ policy ── action ──▶ actuation ──▶ ...
              ▲                      │
              └──────────────────────┘
"""

from collections.abc import Callable, Sequence
from typing import Any, Literal

from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import PassThrough

from drake_quad.control.cascade import connect_inner_loop
from drake_quad.control.policy.network import Network, evaluate_network
from drake_quad.control.policy.observation import ObservationParameters, ObservationSpec, num_observed, observation_rows
from drake_quad.framework.elementary import identity
from drake_quad.framework.fleet_system import REQUIRED, AutoDiffXd, FleetSystem, fleet_system
from drake_quad.framework.records import rows_layout
from drake_quad.framework.wiring import build, connect_inputs, split_output
from drake_quad.signals import SIGNALS, Row, Valid

# Input ports of the subsystems that the diagram exports.
_EXPORTED_INPUTS = ("measurement", "reference", "reference_ahead", "rotor_speed", "wind")


def observation_with_history(past: tuple[Row, ...], *observation_inputs: Any) -> tuple[Row, ...]:
    """Return the current observation, computed by `observation_rows`, followed by the earlier observations."""
    return (*observation_rows(*observation_inputs), *past)


def initial_history(times: int, *observation_inputs: Any) -> tuple[Row, ...]:
    """Return the initial earlier observations, which are copies of the first observation."""
    return observation_rows(*observation_inputs) * times


def next_observation_states(
    action: tuple[Row, ...], past: tuple[Row, ...], *observation_inputs: Any
) -> tuple[tuple[Row, ...], tuple[Row, ...]]:
    """Return the last action and the earlier observations at the next tick; the oldest observation is dropped."""
    return action, observation_with_history(past, *observation_inputs)[: len(past)]


@fleet_system(float, AutoDiffXd)
class Observation(FleetSystem):
    """Observation of a policy at each tick.

    .. pydrake_system::

        name: Observation
        input_ports:
        - measurement
        - reference
        - action
        - reference_ahead
        - rotor_speed
        - wind
        output_ports:
        - observation

    The signals are described in `drake_quad.control.policy.observation.OBSERVABLE_SIGNALS`. The values of the current
    tick come first, followed by those of earlier ticks, the most recent tick first. At the first tick, all earlier
    observations equal the first. `measurement` is the measured or the true state of the vehicle. `action` is the output
    of the policy, which is observed at the next tick. The last three ports exist if the observation contains these
    signals. An observation of sensors on board has a further input port for each of their signals, such as
    `accelerometer`.

    The states are `last_action` and, with a history, `past`; the only parameter of the context is `parameters`.

    Args:
        num_vehicles: number of vehicles N.
        period: tick period, s.
        spec: specification of the observation.
        num_actions: number of components of an action.
        num_ahead: number of future times at which the reference is observed.
        clearance: function of X, Y and Z (m) that returns the distance to the nearest obstacle, m; None if the
            observation does not contain it.
        parameters: parameters of the observation.
    """

    def declare(
        self,
        *,
        period: float = 0.02,
        spec: ObservationSpec,
        num_actions: int,
        num_ahead: int = 0,
        clearance: Callable[[Row, Row, Row], Row] | None = None,
        parameters: ObservationParameters,
    ) -> None:
        """Declare the ports, states and parameters of this system."""
        state, reference = self.input("measurement"), self.input("reference")
        action = self.input("action", layout=rows_layout(num_actions))
        ahead: Any = self.input("reference_ahead", layout=rows_layout(3 * num_ahead)) if num_ahead else ()
        rotor_speed = self.input("rotor_speed") if "rotor_speed" in spec.signals else None
        wind = self.input("wind") if "wind" in spec.signals else None
        parameter = self.parameter("parameters", lambda parameters: parameters)
        last = self.state("last_action", lambda parameters: parameters.initial_action)
        # All readings of a sensor without a port for their validity are valid.
        sensor_signals = [
            self.input(name, absent=Valid(1.0) if SIGNALS[name] is Valid else REQUIRED) for name in spec.sensor_signals
        ]
        observation_inputs = (
            *(state, reference, ahead, rotor_speed, wind, last, parameter, clearance, spec),
            *sensor_signals,
        )
        num_rows = num_observed(spec, num_actions=num_actions, num_ahead=num_ahead)
        before = spec.history - 1
        past: Any = self.state("past", lambda _: (0.0,) * (before * num_rows)) if before else ()
        self.output(
            "observation",
            observation_with_history,
            past,
            *observation_inputs,
            layout=rows_layout(spec.history * num_rows),
        )
        if before:
            self.initialize(initial_history, before, *observation_inputs, writes=[past])
            self.update(period, next_observation_states, action, past, *observation_inputs, writes=[last, past])
        else:
            self.update(period, identity, action, writes=[last])


def policy_output(
    observation: tuple[Row, ...], memory: tuple[tuple[Row, ...], ...], network: Network
) -> tuple[Row, ...]:
    """Return the action of a policy."""
    return evaluate_network(network, observation, memory).output


def next_policy_memory(
    observation: tuple[Row, ...], memory: tuple[tuple[Row, ...], ...], network: Network
) -> tuple[tuple[Row, ...], ...]:
    """Return the memory of a policy at the next tick."""
    return evaluate_network(network, observation, memory).memory


@fleet_system(float, AutoDiffXd)
class Policy(FleetSystem):
    """Trained network that computes an action from an observation.

    .. pydrake_system::

        name: Policy
        input_ports:
        - observation
        output_ports:
        - action

    The equations are in `drake_quad.control.policy.network`. If the network contains recurrent units, their memory is
    the state `memory`.

    Args:
        num_vehicles: number of vehicles N.
        period: tick period, s.
        network: network, the same for all vehicles.
    """

    def declare(self, *, period: float = 0.02, network: Network) -> None:
        """Declare the ports, states and parameters of this system."""
        observation = self.input("observation", layout=rows_layout(network.num_inputs))
        memory: Any = self.state("memory", lambda _: network.memory) if network.memory else ()
        layout = rows_layout(network.num_outputs)
        self.output("action", policy_output, observation, memory, network, layout=layout)
        if network.memory:
            self.update(period, next_policy_memory, observation, memory, network, writes=[memory])


def build_policy_control(
    *,
    observation: Any,
    policy: Any | None,
    actuation: Any,
    state_source: Literal["measurement", "state"] = "measurement",
    thrust_vectoring: Any = None,
    attitude: Any = None,
    sensor_signals: Sequence[str] = (),
) -> Diagram:
    """Build the diagram `control` around a policy.

    .. pydrake_system::

        name: control
        input_ports:
        - measurement
        - reference
        output_ports:
        - observation
        - action
        - wrench

    If an autopilot on board controls the attitude, the output `attitude_target` replaces `wrench`. If the actions are
    accelerations or attitudes, the commanded acceleration or attitude is also an output.

    There is an input for each signal of the observation, including `state` if the observation uses the true state.
    Without a policy, there is also an input `action`.

    Args:
        observation: an `Observation`.
        policy: a `Policy`, or a system with the same ports; None if actions are given through the input port `action`.
        actuation: a system of `drake_quad.control.policy.actuation`.
        state_source: signal that is connected to the port `measurement` of the observation.
        thrust_vectoring: a `ThrustVectoring` if an acceleration is commanded, else None.
        attitude: an attitude controller; None with an autopilot on board, or if no attitude is commanded.
        sensor_signals: names of the sensor signals in the observation.
    """
    builder = DiagramBuilder()
    builder.AddNamedSystem("observation", observation)
    if policy is None:
        # The pass-through `action` lets the diagram output the actions, as it does with a policy.
        policy = builder.AddNamedSystem("action", PassThrough(observation.GetInputPort("action").size()))
        builder.ExportInput(policy.get_input_port(), "action")
    else:
        builder.AddNamedSystem("policy", policy)
        if policy.num_input_ports():
            builder.Connect(observation.get_output_port(), policy.get_input_port())
    action = policy.get_output_port()
    builder.ExportOutput(observation.get_output_port(), "observation")
    builder.ExportOutput(action, "action")
    if state_source != "measurement":
        builder.ExportInput(observation.GetInputPort("measurement"), state_source)
    systems, sources, commanded = [observation, actuation], {"action": action}, None
    if actuation.HasOutputPort("thrust_and_attitude"):
        commanded = split_output(builder, "actuation", actuation)
    else:
        builder.AddNamedSystem("actuation", actuation)
    if actuation.HasOutputPort("acceleration_command"):
        commanded = split_output(builder, "thrust_vectoring", thrust_vectoring)
        sources["acceleration_command"] = actuation.get_output_port()
        systems.append(thrust_vectoring)
    if attitude is not None:
        systems.append(builder.AddNamedSystem("attitude", attitude))
    connect_inputs(builder, systems, sources, exported=(*_EXPORTED_INPUTS, *sensor_signals))
    if commanded is None:
        builder.ExportOutput(actuation.get_output_port(), actuation.get_output_port().get_name())
    else:
        builder.ExportOutput(*connect_inner_loop(builder, commanded, attitude))
        if actuation.HasOutputPort("acceleration_command"):
            builder.ExportOutput(actuation.get_output_port(), "acceleration_command")
        builder.ExportOutput(commanded["attitude_command"], "attitude_command")
    return build(builder, "control")
