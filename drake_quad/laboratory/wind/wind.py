"""The sum of all wind."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import Adder, ConstantVectorSource, ZeroOrderHold

from drake_quad.framework.elementary import identity
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.framework.wiring import append, build, connect_inputs
from drake_quad.randomness.noise import Stream, export_streams
from drake_quad.signals import Wind


@fleet_system(float, AutoDiffXd)
class SteadyWind(FleetSystem):
    """The same wind everywhere, always.

    .. pydrake_system::

        name: SteadyWind
        output_ports:
        - wind

    The only parameter of the context is `velocity`.

    Args:
        num_vehicles: N.
        numbers: the velocity of the air.
    """

    def declare(self, *, numbers: Wind) -> None:
        """Declares the system."""
        self.output("wind", identity, self.parameter("velocity", lambda velocity: velocity))


def build_wind(sources: Mapping[str, Any], *, streams: Mapping[str, list[Stream]], num_vehicles: int = 1) -> Diagram:
    """Builds the diagram `wind`, the sum of its sources; still air if there are none.

    .. pydrake_system::

        name: wind
        input_ports:
        - state
        - dryden_0.turbulence_noise
        - fans.jet_noise
        output_ports:
        - wind

    `state`, the vehicle's, is there if a source depends on the place. Random input ports of the sources are ports of
    the diagram, called after their streams: here for two such sources.

    Args:
        sources: systems with one output port for the wind and perhaps the input port `state`, by name.
        streams: for the random input ports of the sources, by the name of the source.
        num_vehicles: N.
    """
    builder = DiagramBuilder()
    if not sources:
        sources = {"still_air": ConstantVectorSource(np.zeros(3 * num_vehicles))}
    ports = [append(builder, name, source) for name, source in sources.items()]
    connect_inputs(builder, sources.values(), exported=("state",))
    export_streams(builder, sources, streams)
    if len(ports) > 1:
        ports = [append(builder, "total", Adder(len(ports), 3 * num_vehicles), *ports)]
    builder.ExportOutput(*ports, "wind")
    return build(builder, "wind")


def build_held_wind(source: Any, *, period: float) -> Diagram:
    """Builds the diagram `held`, a source of wind that is sampled and held.

    .. pydrake_system::

        name: held
        input_ports:
        - state
        output_ports:
        - wind

    A source that is a function of time or place would be read at the end of a step of the vehicle, with the state of
    its beginning. `state` is there if the source has it; `wind` is zero before the first sample at time zero, which no
    step of the vehicle sees.

    Args:
        source: with one output port for the wind, and perhaps the input port `state`.
        period: of the samples, s; the vehicle's time step.
    """
    builder = DiagramBuilder()
    port = append(builder, "source", source)
    connect_inputs(builder, [source], exported=("state",))
    builder.ExportOutput(append(builder, "hold", ZeroOrderHold(period, port.size()), port), "wind")
    return build(builder, "held")
