"""Systems that are not compiled, seen from a diagram that is."""

from typing import Any

from pydrake.systems.framework import BasicVector, Context, LeafSystem


class StandIn(LeafSystem):
    """Shows the outputs of a system that belongs to another diagram, or is about to belong to one.

    Its ports are those of that system, which may depend on its inputs, on the time and on its default parameters, and
    must remember nothing.

    Args:
        system: that is shown.
    """

    def __init__(self, system: Any) -> None:
        super().__init__()
        self.system = system
        inputs = [system.get_input_port(index) for index in range(system.num_input_ports())]
        for port in inputs:
            self.DeclareVectorInputPort(port.get_name(), port.size())
        # Random numbers come from elsewhere.
        self.random_inputs = getattr(system, "random_inputs", {})
        scratch = system.CreateDefaultContext()

        def show(context: Context, output: BasicVector, index: int) -> None:
            scratch.SetTime(context.get_time())
            for port in inputs:
                vector = self.EvalVectorInput(context, port.get_index())
                if vector is not None:
                    port.FixValue(scratch, vector.CopyToVector())
            output.SetFromVector(system.get_output_port(index).Eval(scratch))

        for index in range(system.num_output_ports()):
            port = system.get_output_port(index)
            self.DeclareVectorOutputPort(
                port.get_name(), port.size(), lambda context, output, index=index: show(context, output, index)
            )


def system_of(system: Any) -> Any:
    """The system that another stands in for, or itself."""
    return system.system if isinstance(system, StandIn) else system


def remembers(system: Any) -> bool:
    """Whether a system has a state."""
    context = system.CreateDefaultContext()
    # Drake does not count them all together where some are abstract: it ends the process.
    return bool(context.num_continuous_states() or context.num_discrete_state_groups() or context.num_abstract_states())
