"""What is in a built diagram, and what is connected with what, without the diagrams in between."""

from typing import Any, NamedTuple

from pydrake.systems.framework import Diagram


class Port(NamedTuple):
    """A port of a leaf system.

    Attributes:
        path: of the system: the names on the way, joined by dots.
        number: of the port among the system's input ports, or among its output ports.
    """

    path: str
    number: int


class ExportedPort(NamedTuple):
    """A port of the diagram.

    Attributes:
        name: of the port.
        size: elements.
    """

    name: str
    size: int


class Topology:
    """The leaf systems of a diagram and their connections.

    Args:
        diagram: that is built.

    Attributes:
        leaves: the leaf systems, by path.
        outputs: the leaf's output port behind each output port of the diagram, by name.
    """

    def __init__(self, diagram: Diagram) -> None:
        self.leaves: dict[str, Any] = {}
        self._diagrams: dict[str, Diagram] = {"": diagram}
        # What feeds an input port: an output port of a system or diagram beside it, or an input port of the diagram
        # around it.
        self._beside: dict[Port, Port] = {}
        self._around: dict[Port, Port] = {}
        self._walk("", diagram)
        self.outputs = {}
        for number in range(diagram.num_output_ports()):
            name = diagram.get_output_port(number).get_name()
            self.outputs[name] = self._leaf_output(Port("", number))

    def source(self, port: Port) -> Port | ExportedPort | None:
        """The leaf's output port, or the input port of the diagram, that feeds a leaf's input port; None if none does.

        Args:
            port: an input port of a leaf.
        """
        while port not in self._beside:
            if port not in self._around:
                return None
            port = self._around[port]
            if port.path == "":
                exported = self._diagrams[""].get_input_port(port.number)
                return ExportedPort(exported.get_name(), exported.size())
        return self._leaf_output(self._beside[port])

    def sources(self, path: str) -> list[Port | ExportedPort | None]:
        """What feeds each input port of a leaf."""
        return [self.source(Port(path, index)) for index in range(self.leaves[path].num_input_ports())]

    def _walk(self, path: str, diagram: Diagram) -> None:
        prefix = f"{path}." if path else ""
        for system in diagram.GetSystems():
            inside = prefix + system.get_name()
            if isinstance(system, Diagram):
                self._diagrams[inside] = system
                self._walk(inside, system)
            else:
                self.leaves[inside] = system
        for (target, index), (source, output) in diagram.connection_map().items():
            self._beside[Port(prefix + target.get_name(), int(index))] = Port(prefix + source.get_name(), int(output))
        for number in range(diagram.num_input_ports()):
            port = diagram.get_input_port(number)
            for target, index in diagram.GetInputPortLocators(port.get_index()):
                self._around[Port(prefix + target.get_name(), int(index))] = Port(path, number)

    def _leaf_output(self, port: Port) -> Port:
        while port.path in self._diagrams:
            diagram = self._diagrams[port.path]
            system, index = diagram.get_output_port_locator(diagram.get_output_port(port.number).get_index())
            prefix = f"{port.path}." if port.path else ""
            port = Port(prefix + system.get_name(), int(index))
        return port
