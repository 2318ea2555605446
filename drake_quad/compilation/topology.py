"""Leaf systems of a diagram and the connections between them, with nested diagrams flattened."""

from typing import Any, NamedTuple

from pydrake.systems.framework import Diagram


class Port(NamedTuple):
    """Port of a leaf system.

    Attributes:
        path: path of the system: the names of the diagrams that contain it, and its name, joined by dots.
        number: index of the port among the system's input ports or output ports.
    """

    path: str
    number: int


class ExportedPort(NamedTuple):
    """Exported port of the diagram.

    Attributes:
        name: name of the port.
        size: number of elements.
    """

    name: str
    size: int


class Topology:
    """Leaf systems of a diagram and their connections.

    Args:
        diagram: diagram, which may contain other diagrams.

    Attributes:
        leaves: leaf systems, by path.
        outputs: for the name of each output port of the diagram, the output port of the leaf system that computes it.
    """

    def __init__(self, diagram: Diagram) -> None:
        self.leaves: dict[str, Any] = {}
        self._diagrams: dict[str, Diagram] = {"": diagram}
        # The source of an input port is an output port in the same diagram, or an input port of the enclosing diagram.
        self._sibling_sources: dict[Port, Port] = {}
        self._parent_sources: dict[Port, Port] = {}
        self._walk("", diagram)
        self.outputs = {}
        for number in range(diagram.num_output_ports()):
            name = diagram.get_output_port(number).get_name()
            self.outputs[name] = self._leaf_output(Port("", number))

    def source(self, port: Port) -> Port | ExportedPort | None:
        """Return the source of a leaf system's input port: an output port, or an input port of the diagram.

        The result is None if the port is not connected.
        """
        while port not in self._sibling_sources:
            if port not in self._parent_sources:
                return None
            port = self._parent_sources[port]
            if port.path == "":
                exported = self._diagrams[""].get_input_port(port.number)
                return ExportedPort(exported.get_name(), exported.size())
        return self._leaf_output(self._sibling_sources[port])

    def sources(self, path: str) -> list[Port | ExportedPort | None]:
        """Return the source of each input port of the leaf system at a path."""
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
            self._sibling_sources[Port(prefix + target.get_name(), int(index))] = Port(
                prefix + source.get_name(), int(output)
            )
        for number in range(diagram.num_input_ports()):
            port = diagram.get_input_port(number)
            for target, index in diagram.GetInputPortLocators(port.get_index()):
                self._parent_sources[Port(prefix + target.get_name(), int(index))] = Port(path, number)

    def _leaf_output(self, port: Port) -> Port:
        while port.path in self._diagrams:
            diagram = self._diagrams[port.path]
            system, index = diagram.get_output_port_locator(diagram.get_output_port(port.number).get_index())
            prefix = f"{port.path}." if port.path else ""
            port = Port(prefix + system.get_name(), int(index))
        return port
