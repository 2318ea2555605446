"""A policy in the loop: what it sees, the network, and what its actions command.

What it did at the last tick can be seen as well:

    ──▶ observation ──▶ policy ── action ──▶ actuation ──▶ ...
              ▲                      │
              └──────────────────────┘
"""

from collections.abc import Callable
from typing import Any, Literal

from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import PassThrough

from drake_quad.control.cascade import connect_inner_loop
from drake_quad.control.policy.network import Network, passed
from drake_quad.control.policy.observation import ObservationNumbers, ObservationSpec, num_observed, observed
from drake_quad.framework.elementary import identity
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.framework.records import rows_layout
from drake_quad.framework.wiring import build, connect_inputs, split_output
from drake_quad.signals import Row

# Input ports of the diagram, where a system has a port of this name.
_INPUTS = ("measurement", "reference", "reference_ahead", "rotor_speed", "wind")


def with_past(past: tuple[Row, ...], *seen: Any) -> tuple[Row, ...]:
    """What is seen now, of arguments as for `observed`, and what was seen before."""
    return (*observed(*seen), *past)


def repeated(times: int, *seen: Any) -> tuple[Row, ...]:
    """What is seen at the beginning, as if it had been so many times so before."""
    return observed(*seen) * times


def remembered(action: tuple[Row, ...], past: tuple[Row, ...], *seen: Any) -> tuple[tuple[Row, ...], tuple[Row, ...]]:
    """The action, and what was seen, now and before but for the oldest: the next tick's past."""
    return action, with_past(past, *seen)[: len(past)]


@fleet_system(float, AutoDiffXd)
class Observation(FleetSystem):
    """What a policy sees of the loop, tick by tick.

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

    The rows are those of `drake_quad.control.policy.observation.SIGNALS_SEEN`, those of the present tick first, then
    those of the ticks before, the last one first. At the beginning these are all as the first. `measurement` is the
    state of the vehicle, as cameras or as the vehicle itself have it; `action` is what the policy makes of the
    observation, and seen at the next tick. The last three ports are there if something looks at them.

    The states are `last_action` and, with a history, `past`; the only parameter of the context is `numbers`.

    Args:
        num_vehicles: N.
        period: of the ticks, s.
        spec: what is seen.
        num_actions: rows of an action.
        num_ahead: times ahead at which the reference is seen.
        clearance: a function of X, Y and Z (m) that says how far obstacles are, m; None if nothing looks at it.
        numbers: of the vehicle.
    """

    def declare(
        self,
        *,
        period: float = 0.02,
        spec: ObservationSpec,
        num_actions: int,
        num_ahead: int = 0,
        clearance: Callable[[Row, Row, Row], Row] | None = None,
        numbers: ObservationNumbers,
    ) -> None:
        """Declare ports, states and parameters."""
        state, reference = self.input("measurement"), self.input("reference")
        action = self.input("action", layout=rows_layout(num_actions))
        ahead: Any = self.input("reference_ahead", layout=rows_layout(3 * num_ahead)) if num_ahead else ()
        rotor_speed = self.input("rotor_speed") if "rotor_speed" in spec.signals else None
        wind = self.input("wind") if "wind" in spec.signals else None
        parameter = self.parameter("numbers", lambda numbers: numbers)
        last = self.state("last_action", lambda numbers: numbers.initial_action)
        seen = state, reference, ahead, rotor_speed, wind, last, parameter, clearance, spec
        num_rows = num_observed(spec, num_actions=num_actions, num_ahead=num_ahead)
        before = spec.history - 1
        past: Any = self.state("past", lambda _: (0.0,) * (before * num_rows)) if before else ()
        self.output("observation", with_past, past, *seen, layout=rows_layout(spec.history * num_rows))
        if before:
            self.initialize(repeated, before, *seen, writes=[past])
            self.update(period, remembered, action, past, *seen, writes=[last, past])
        else:
            self.update(period, identity, action, writes=[last])


def output_of(observation: tuple[Row, ...], memory: tuple[tuple[Row, ...], ...], network: Network) -> tuple[Row, ...]:
    """The action of a policy."""
    return passed(network, observation, memory).output


def memory_of(
    observation: tuple[Row, ...], memory: tuple[tuple[Row, ...], ...], network: Network
) -> tuple[tuple[Row, ...], ...]:
    """What a policy remembers at the next tick."""
    return passed(network, observation, memory).memory


@fleet_system(float, AutoDiffXd)
class Policy(FleetSystem):
    """A network that was trained: from what is seen to an action.

    .. pydrake_system::

        name: Policy
        input_ports:
        - observation
        output_ports:
        - action

    The equations are those of `drake_quad.control.policy.network`. What recurrent units remember is the state `memory`,
    which is there if there are any.

    Args:
        num_vehicles: N.
        period: of the ticks, s.
        network: the same for all vehicles.
    """

    def declare(self, *, period: float = 0.02, network: Network) -> None:
        """Declare ports, states and parameters."""
        observation = self.input("observation", layout=rows_layout(network.num_inputs))
        memory: Any = self.state("memory", lambda _: network.memory) if network.memory else ()
        layout = rows_layout(network.num_outputs)
        self.output("action", output_of, observation, memory, network, layout=layout)
        if network.memory:
            self.update(period, memory_of, observation, memory, network, writes=[memory])


def build_policy_control(
    *,
    observation: Any,
    policy: Any | None,
    actuation: Any,
    sees: Literal["measurement", "state"] = "measurement",
    thrust_vectoring: Any = None,
    attitude: Any = None,
) -> Diagram:
    """Builds the diagram `control` around a policy.

    .. pydrake_system::

        name: control
        input_ports:
        - measurement
        - reference
        output_ports:
        - observation
        - action
        - wrench

    With an autopilot on board there is an `attitude_target` in place of the `wrench`. Where acceleration or attitude
    are commanded, they are shown. There are inputs for what the observation looks at, among them `state` if it sees the
    vehicle itself, and `action` if there is no policy.

    Args:
        observation: an `Observation`.
        policy: a `Policy`, or a system with its ports; None if actions come from elsewhere, by the input port `action`.
        actuation: a system of `drake_quad.control.policy.actuation`.
        sees: the signal that the observation takes for its measurement.
        thrust_vectoring: a `ThrustVectoring`, where an acceleration is commanded.
        attitude: an attitude controller; None if there is an autopilot on board, or if nothing commands an attitude.
    """
    builder = DiagramBuilder()
    builder.AddNamedSystem("observation", observation)
    if policy is None:
        # What comes in is shown, as what a policy makes is.
        policy = builder.AddNamedSystem("action", PassThrough(observation.GetInputPort("action").size()))
        builder.ExportInput(policy.get_input_port(), "action")
    else:
        builder.AddNamedSystem("policy", policy)
        if policy.num_input_ports():
            builder.Connect(observation.get_output_port(), policy.get_input_port())
    action = policy.get_output_port()
    builder.ExportOutput(observation.get_output_port(), "observation")
    builder.ExportOutput(action, "action")
    if sees != "measurement":
        builder.ExportInput(observation.GetInputPort("measurement"), sees)
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
    connect_inputs(builder, systems, sources, exported=_INPUTS)
    if commanded is None:
        builder.ExportOutput(actuation.get_output_port(), actuation.get_output_port().get_name())
    else:
        builder.ExportOutput(*connect_inner_loop(builder, commanded, attitude))
        if actuation.HasOutputPort("acceleration_command"):
            builder.ExportOutput(actuation.get_output_port(), "acceleration_command")
        builder.ExportOutput(commanded["attitude_command"], "attitude_command")
    return build(builder, "control")
