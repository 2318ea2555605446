"""Steady wind, the sum of all wind sources, and a sample-and-hold for user-defined sources."""

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
    """Wind that is constant in space and time.

    .. pydrake_system::

        name: SteadyWind
        output_ports:
        - wind

    The only parameter of the context is `velocity`.

    Args:
        num_vehicles: number N of vehicles.
        parameters: velocity of the air in W.
    """

    def declare(self, *, parameters: Wind) -> None:
        """Declare the ports and parameters of this system."""
        self.output("wind", identity, self.parameter("velocity", lambda velocity: velocity))


def build_wind(sources: Mapping[str, Any], *, streams: Mapping[str, list[Stream]], num_vehicles: int = 1) -> Diagram:
    """Build the diagram `wind`, the sum of its sources; still air if there are none.

    .. pydrake_system::

        name: wind
        input_ports:
        - state
        - dryden_0.turbulence_noise
        - fans.jet_noise
        output_ports:
        - wind

    The input port `state`, the state of the vehicle, exists if a source depends on the position. The diagram exports
    the random input ports of the sources under the names of their streams. The block above shows a diagram with two
    random sources.

    Args:
        sources: systems with one output port for the wind and optionally the input port `state`, by name.
        streams: streams of the sources' random input ports, by the name of the source.
        num_vehicles: number N of vehicles.
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
    """Build the diagram `held`, which samples a source of wind and holds the sample.

    .. pydrake_system::

        name: held
        input_ports:
        - state
        output_ports:
        - wind

    The vehicle evaluates its inputs at the end of a time step. A directly connected source would therefore be evaluated
    for the time at the end of the step, but for the position at the beginning. The input port `state` exists if the
    source has this port. Before the first sample at time zero, `wind` is zero; no time step of the vehicle uses this
    value.

    Args:
        source: system with one output port for the wind, and optionally the input port `state`.
        period: sampling interval, s; equal to the vehicle's time step.
    """
    builder = DiagramBuilder()
    port = append(builder, "source", source)
    connect_inputs(builder, [source], exported=("state",))
    builder.ExportOutput(append(builder, "hold", ZeroOrderHold(period, port.size()), port), "wind")
    return build(builder, "held")
