"""Placeholder with the same ports as a system that belongs to another diagram."""

from typing import Any

from pydrake.systems.framework import BasicVector, Context, LeafSystem


class SystemPlaceholder(LeafSystem):
    """Placeholder for a system that belongs to another diagram, or will be added to another diagram.

    The placeholder has the same ports as the system, and evaluates the system to compute its outputs. The outputs may
    depend on the inputs, the time and the default parameters. The system must not have a state.

    Attributes:
        system: system to evaluate.
        random_inputs: properties of the random input ports of the system, by name.
    """

    def __init__(self, system: Any) -> None:
        super().__init__()
        self.system = system
        inputs = [system.get_input_port(index) for index in range(system.num_input_ports())]
        for port in inputs:
            self.DeclareVectorInputPort(port.get_name(), port.size())
        self.random_inputs = getattr(system, "random_inputs", {})
        scratch = system.CreateDefaultContext()

        def calc(context: Context, output: BasicVector, index: int) -> None:
            scratch.SetTime(context.get_time())
            for port in inputs:
                vector = self.EvalVectorInput(context, port.get_index())
                if vector is not None:
                    port.FixValue(scratch, vector.CopyToVector())
            output.SetFromVector(system.get_output_port(index).Eval(scratch))

        for index in range(system.num_output_ports()):
            port = system.get_output_port(index)
            self.DeclareVectorOutputPort(
                port.get_name(), port.size(), lambda context, output, index=index: calc(context, output, index)
            )


def system_for_compiled_diagram(system: Any) -> Any:
    """Return the system that takes the place of an uncompiled system in the compiled diagram.

    A placeholder is replaced by its system. A system with a method `new_copy` is replaced by a copy. Any other system
    is replaced by a placeholder, which evaluates it.
    """
    if isinstance(system, SystemPlaceholder):
        return system.system
    return system.new_copy() if hasattr(system, "new_copy") else SystemPlaceholder(system)


def wrapped_system(system: Any) -> Any:
    """Return the system that a placeholder evaluates; other systems are returned unchanged."""
    return system.system if isinstance(system, SystemPlaceholder) else system


def has_state(system: Any) -> bool:
    """Return whether a system has a state."""
    context = system.CreateDefaultContext()
    # Drake's method for the total number of states terminates the process if there are abstract states.
    return bool(context.num_continuous_states() or context.num_discrete_state_groups() or context.num_abstract_states())
