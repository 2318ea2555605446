"""The laboratory: everything between a commanded wrench, or attitude, and a measured state.

The way of a change (◆) from the state to the rotors, with frames every 10 ms, ticks of the control every 20 ms and one
tick of delay on the link:

    time             0      10     20     30     40     50     60 ms
    frame            ●━━━━━━◆━━━━━━●━━━━━━●━━━━━━●━━━━━━●━━━━━━○     takes the state of its instant
    tick, sent       ●━━━━━━━━━━━━━◆━━━━━━━━━━━━━●━━━━━━━━━━━━━○     reads the frame before, 10 ms old
    rotor command    ●━━━━━━━━━━━━━●━━━━━━━━━━━━━◆━━━━━━━━━━━━━○     a tick later

What happens just before the frame of 10 ms is in the rotor commands 30 ms later. What happens just after it waits for
the frame of 20 ms, which no tick reads, and for that of 30 ms: it takes 50 ms. Every frame of latency adds 10 ms, every
tick of delay 20 ms; then comes the lag of the rotors.

An autopilot on board stands between link and allocation. It sees the vehicle itself, at its own instants; neither
cameras nor link delay what it does.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from pydrake.systems.framework import Diagram, DiagramBuilder

from drake_quad.framework.wiring import build, connect_inputs, split_output
from drake_quad.laboratory.sensors.sensor import build_sensors
from drake_quad.laboratory.wind.wind import build_wind
from drake_quad.randomness.noise import (
    Exported,
    Samples,
    Stream,
    connect_noise,
    connect_random_sources,
    export_noise,
    random_streams,
)
from drake_quad.randomness.streams import StreamKind


def build_laboratory(
    *,
    vehicle: Any,
    allocation: Any,
    motion_capture: Any,
    command_link: Any,
    autopilot: Any = None,
    wind: Mapping[str, Any],
    sensors: Mapping[str, Any] = MappingProxyType({}),
    samples: Samples | Exported | None,
) -> Diagram:
    """Builds the diagram `laboratory` around a vehicle.

    The wrench goes through the command link to the allocation on board, whose rotor speeds the vehicle follows in the
    wind; motion capture sees its state. With motors that take throttles there is `throttle_command` in place of
    `rotor_speed_command`; with a slung load and a battery, there are outputs `swing` and `charge`. With an autopilot an
    attitude target goes through the link in place of the wrench, and the laboratory shows the wrench that the autopilot
    makes of it. Each sensor adds an output port with its name.

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
        vehicle: with input ports `rotor_speed_command` or `throttle_command`, `wind`, `crashed`, perhaps
            `attitude_target`, and output ports `state`, `rotor_speed`, and perhaps `acceleration`, `swing` and
            `charge`.
        allocation: from `wrench` to what the vehicle takes and `shortfall`, packed.
        motion_capture: from `state` to `measurement`.
        command_link: from `wrench` to `wrench`, or from `attitude_target` to `attitude_target`.
        autopilot: from `attitude_target`, and perhaps `state`, to `wrench`; None if the wrench comes over the link.
        wind: its sources by name, each with one output port and perhaps the input port `state`.
        sensors: sensors by name, each with one output port. Its input ports are called as what it reads: an output port
            of the vehicle, `wind`, the rotors' or throttles' command, or `wrench`.
        samples: of a study that the vehicles fly, which say what noise there is; None to feed random input ports from
            Drake's random sources, or `Exported` to make them input ports.
    """
    builder = DiagramBuilder()
    builder.AddNamedSystem("command_link", command_link)
    allocated = split_output(builder, "allocation", allocation)
    builder.AddNamedSystem("vehicle", vehicle)
    builder.AddNamedSystem("motion_capture", motion_capture)
    gusts = random_streams(wind, StreamKind.WIND)
    air = builder.AddNamedSystem("wind", build_wind(wind, streams=gusts, num_vehicles=vehicle.num_vehicles))

    carried = "wrench" if autopilot is None else "attitude_target"
    (told,) = (name for name in allocated if name != "shortfall")
    state, wind_port = vehicle.GetOutputPort("state"), air.GetOutputPort("wind")
    sources = {port.get_name(): port for port in map(vehicle.get_output_port, range(vehicle.num_output_ports()))}
    sources |= {"wind": wind_port, told: allocated[told], carried: command_link.GetOutputPort(carried)}
    systems = [allocation, vehicle, motion_capture, air]
    if autopilot is not None:
        systems.append(builder.AddNamedSystem("autopilot", autopilot))
        sources["wrench"] = autopilot.GetOutputPort("wrench")
    readings = random_streams(sensors, StreamKind.NOISE)
    if sensors:
        on_board = build_sensors(sensors, streams=readings, available=sources)
        systems.append(builder.AddNamedSystem("sensors", on_board))
    connect_inputs(builder, systems, sources)

    electronics = {"motion_capture": motion_capture, "command_link": command_link}
    if autopilot is not None:
        electronics["autopilot"] = autopilot
    ports = {
        stream: electronics[name].GetInputPort(stream.name.removeprefix(f"{name}."))
        for name, streams in random_streams(electronics, StreamKind.NOISE).items()
        for stream in streams
    }
    ports |= {stream: air.GetInputPort(stream.name) for streams in gusts.values() for stream in streams}
    ports |= {stream: on_board.GetInputPort(stream.name) for streams in readings.values() for stream in streams}
    _feed_noise(builder, ports, samples, vehicle.num_vehicles)

    builder.ExportInput(command_link.GetInputPort(carried), carried)
    builder.ExportInput(vehicle.GetInputPort("crashed"), "crashed")
    builder.ExportOutput(motion_capture.GetOutputPort("measurement"), "measurement")
    builder.ExportOutput(state, "state")
    builder.ExportOutput(vehicle.GetOutputPort("rotor_speed"), "rotor_speed")
    builder.ExportOutput(allocated[told], told)
    for name in ("swing", "charge"):
        if vehicle.HasOutputPort(name):
            builder.ExportOutput(vehicle.GetOutputPort(name), name)
    builder.ExportOutput(allocated["shortfall"], "shortfall")
    builder.ExportOutput(wind_port, "wind")
    if autopilot is not None:
        builder.ExportOutput(sources["wrench"], "wrench")
    for name in sensors:
        builder.ExportOutput(on_board.GetOutputPort(name), name)
    return build(builder, "laboratory")


def _feed_noise(
    builder: DiagramBuilder, ports: Mapping[Stream, Any], samples: Samples | Exported | None, num_vehicles: int
) -> None:
    """Feed the random input port of each stream, as `build_laboratory` describes."""
    match samples:
        case None:
            connect_random_sources(builder, ports)
        case Exported():
            export_noise(builder, ports, samples, num_vehicles)
        case Samples():
            connect_noise(builder, ports, samples)
