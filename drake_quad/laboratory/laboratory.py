"""The laboratory: everything between a commanded wrench and a measured state.

The way of a change (◆) from the state to the rotors, with frames every 10 ms, ticks of the control every 20 ms and one
tick of delay on the link:

    time             0      10     20     30     40     50     60 ms
    frame            ●━━━━━━◆━━━━━━●━━━━━━●━━━━━━●━━━━━━●━━━━━━○     takes the state of its instant
    tick, sent       ●━━━━━━━━━━━━━◆━━━━━━━━━━━━━●━━━━━━━━━━━━━○     reads the frame before, 10 ms old
    rotor command    ●━━━━━━━━━━━━━●━━━━━━━━━━━━━◆━━━━━━━━━━━━━○     a tick later

What happens just before the frame of 10 ms is in the rotor commands 30 ms later. What happens just after it waits for
the frame of 20 ms, which no tick reads, and for that of 30 ms: it takes 50 ms. Every frame of latency adds 10 ms, every
tick of delay 20 ms; then comes the lag of the rotors.
"""

from collections.abc import Mapping
from typing import Any

from pydrake.systems.framework import Diagram, DiagramBuilder

from drake_quad.fleet import split_output
from drake_quad.laboratory.tape import Samples, connect_random_sources, connect_tapes, random_ports
from drake_quad.laboratory.wind.wind import build_wind
from drake_quad.randomness import Kind


def build_laboratory(
    *,
    vehicle: Any,
    allocation: Any,
    motion_capture: Any,
    command_link: Any,
    wind: Mapping[str, Any],
    samples: Samples | None,
) -> Diagram:
    """Builds the diagram `laboratory` around a vehicle.

    The wrench goes through the command link to the allocation on board, whose rotor speeds the vehicle follows in the
    wind; motion capture sees its state.

    .. pydrake_system::

        name: laboratory
        input_ports:
        - wrench
        - crashed
        output_ports:
        - measurement
        - state
        - rotor_speed
        - rotor_speed_command
        - shortfall
        - wind

    Args:
        vehicle: with input ports `rotor_speed_command`, `wind`, `crashed` and output ports `state`, `rotor_speed`.
        allocation: from `wrench` to `rotor_speed_command` and `shortfall`, packed.
        motion_capture: from `state` to `measurement`.
        command_link: from `wrench` to `wrench`.
        wind: sources of it, as `build_wind` takes them.
        samples: that the vehicles fly, from whose tapes the random input ports are fed; or None, to feed them from
            Drake's random sources.
    """
    builder = DiagramBuilder()
    builder.AddNamedSystem("command_link", command_link)
    allocated = split_output(builder, "allocation", allocation)
    builder.AddNamedSystem("vehicle", vehicle)
    builder.AddNamedSystem("motion_capture", motion_capture)
    sum_of_wind = builder.AddNamedSystem("wind", build_wind(wind, num_vehicles=vehicle.num_vehicles))

    builder.Connect(command_link.GetOutputPort("wrench"), allocation.GetInputPort("wrench"))
    builder.Connect(allocated["rotor_speed_command"], vehicle.GetInputPort("rotor_speed_command"))
    builder.Connect(sum_of_wind.GetOutputPort("wind"), vehicle.GetInputPort("wind"))
    for watcher in (motion_capture, sum_of_wind):
        if watcher.HasInputPort("state"):
            builder.Connect(vehicle.GetOutputPort("state"), watcher.GetInputPort("state"))
    noisy = {"motion_capture": motion_capture, "command_link": command_link}
    gusty = [each._replace(port=sum_of_wind.GetInputPort(each.stream.name)) for each in random_ports(wind, Kind.WIND)]
    ports = [*random_ports(noisy, Kind.NOISE), *gusty]
    if samples is None:
        connect_random_sources(builder, ports)
    else:
        connect_tapes(builder, ports, samples)

    builder.ExportInput(command_link.GetInputPort("wrench"), "wrench")
    builder.ExportInput(vehicle.GetInputPort("crashed"), "crashed")
    builder.ExportOutput(motion_capture.GetOutputPort("measurement"), "measurement")
    builder.ExportOutput(vehicle.GetOutputPort("state"), "state")
    builder.ExportOutput(vehicle.GetOutputPort("rotor_speed"), "rotor_speed")
    builder.ExportOutput(allocated["rotor_speed_command"], "rotor_speed_command")
    builder.ExportOutput(allocated["shortfall"], "shortfall")
    builder.ExportOutput(sum_of_wind.GetOutputPort("wind"), "wind")
    laboratory = builder.Build()
    laboratory.set_name("laboratory")
    return laboratory
