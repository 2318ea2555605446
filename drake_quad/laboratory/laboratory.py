"""The laboratory: everything between the commanded wrench or attitude and the measured state.

The following diagram shows when the rotors respond to a change of the state (◆), with a frame every 10 ms, a control
tick every 20 ms, and a link delay of one tick:

    time             0      10     20     30     40     50     60 ms
    frame            ●━━━━━━◆━━━━━━●━━━━━━●━━━━━━●━━━━━━●━━━━━━○     contains the state at this time
    command sent     ●━━━━━━━━━━━━━◆━━━━━━━━━━━━━●━━━━━━━━━━━━━○     follows from the previous frame
    rotor command    ●━━━━━━━━━━━━━●━━━━━━━━━━━━━◆━━━━━━━━━━━━━○     arrives one tick later

A change just before the frame at 10 ms affects the rotor commands 30 ms later. A change just after this frame first
appears in the frame at 20 ms. No control tick uses that frame, so the change first affects a control tick through the
frame at 30 ms, and the rotor commands 50 ms after the change. Each frame of latency adds 10 ms, and each tick of delay
adds 20 ms. The lag of the rotors adds to these times.

An autopilot on board is between the link and the allocation. It measures the state of the vehicle directly, at its own
ticks, so neither the cameras nor the link delay the loops of the autopilot.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from pydrake.systems.framework import Diagram, DiagramBuilder

from drake_quad.framework.wiring import build, connect_inputs, split_output
from drake_quad.laboratory.sensors.sensor import build_sensors
from drake_quad.laboratory.wind.wind import build_wind
from drake_quad.randomness.noise import (
    ExportedRandomNumbers,
    Stream,
    connect_noise,
    connect_random_sources,
    export_noise,
    random_streams,
)
from drake_quad.randomness.streams import Samples, StreamKind
from drake_quad.signals import valid_signal


def build_laboratory(
    *,
    vehicle: Any,
    allocation: Any = None,
    motion_capture: Any = None,
    command_link: Any,
    autopilot: Any = None,
    firmware: Any = None,
    estimator: Any = None,
    wind: Mapping[str, Any],
    sensors: Mapping[str, Any] = MappingProxyType({}),
    samples: Samples | ExportedRandomNumbers | None,
) -> Diagram:
    """Build the diagram `laboratory` around a vehicle.

    The command link transmits the wrench to the allocation on board, which commands the rotor speeds. The vehicle flies
    in the wind, and motion capture measures the state of the vehicle. The output `throttle_command` replaces
    `rotor_speed_command` for motors that are commanded by throttles. A slung load adds the output `swing`, and a
    battery adds `charge` and `battery`. With an autopilot, the link transmits an attitude target instead of the wrench,
    and the wrench that the autopilot commands becomes an output. Each sensor adds an output port with the name of the
    sensor, and a second one for the validity if its readings can be missing. With firmware on board, which commands the
    motors itself, the outputs `wrench` and `shortfall` do not exist.

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
        vehicle: system with the input ports `rotor_speed_command` or `throttle_command`, `wind`, `crashed`, and
            optionally `attitude_target` and `external_load`. Its output ports are `state`, `rotor_speed`, and
            optionally `acceleration`, `swing`, `charge` and `battery`.
        allocation: system from `wrench` to a packed output of the command of the vehicle (rotor speeds or throttles)
            and `shortfall`; None if firmware commands the motors.
        motion_capture: system from `state` to `measurement`; None if the estimator does not use it.
        command_link: system from `wrench` to `wrench`, or from `attitude_target` to `attitude_target`.
        autopilot: system from `attitude_target`, and optionally `state`, to `wrench` or to the input of the firmware;
            None if the link transmits a wrench.
        firmware: system from the output of the autopilot to the command of the vehicle; None if the allocation computes
            this command.
        estimator: system with the output port `measurement`, and with input ports that have the names of sensors, of
            the validities of their readings, or `motion_capture`; None if motion capture provides the measurement. An
            autopilot reads the estimate instead of the true state.
        wind: wind sources by name, each with one output port and optionally the input port `state`.
        sensors: sensors by name, with the output ports of a `Sensor`. The input ports of a sensor have the names of the
            signals that it measures: an output port of the vehicle, `wind`, the rotor speed or throttle command, or
            `wrench`.
        samples: samples of a study, which determine the noise; None to connect the random input ports to Drake's random
            sources; `ExportedRandomNumbers` to make these ports input ports of the diagram.
    """
    builder = DiagramBuilder()
    builder.AddNamedSystem("command_link", command_link)
    allocated = {} if allocation is None else split_output(builder, "allocation", allocation)
    if firmware is not None:
        builder.AddNamedSystem("firmware", firmware)
        allocated = {firmware.get_output_port().get_name(): firmware.get_output_port()}
    builder.AddNamedSystem("vehicle", vehicle)
    cameras = [] if motion_capture is None else [builder.AddNamedSystem("motion_capture", motion_capture)]
    wind_streams = random_streams(wind, StreamKind.WIND)
    wind_diagram = builder.AddNamedSystem(
        "wind", build_wind(wind, streams=wind_streams, num_vehicles=vehicle.num_vehicles)
    )

    link_signal = "wrench" if autopilot is None else "attitude_target"
    (command_name,) = (name for name in allocated if name != "shortfall")
    state, wind_port = vehicle.GetOutputPort("state"), wind_diagram.GetOutputPort("wind")
    sources = {port.get_name(): port for port in map(vehicle.get_output_port, range(vehicle.num_output_ports()))}
    sources |= {
        "wind": wind_port,
        command_name: allocated[command_name],
        link_signal: command_link.GetOutputPort(link_signal),
    }
    computers = [system for system in (allocation, firmware) if system is not None]
    systems = [*computers, vehicle, *cameras, wind_diagram]
    if motion_capture is not None:
        sources["motion_capture"] = motion_capture.GetOutputPort("measurement")
        if motion_capture.HasOutputPort("measurement_valid"):
            sources[valid_signal("motion_capture")] = motion_capture.GetOutputPort("measurement_valid")
    if autopilot is not None:
        systems.append(builder.AddNamedSystem("autopilot", autopilot))
        sources[autopilot.get_output_port().get_name()] = autopilot.get_output_port()
    sensor_streams = random_streams(sensors, StreamKind.NOISE)
    if sensors:
        sensor_diagram = build_sensors(sensors, streams=sensor_streams, available=sources)
        systems.append(builder.AddNamedSystem("sensors", sensor_diagram))
        readings = map(sensor_diagram.get_output_port, range(sensor_diagram.num_output_ports()))
        sources |= {port.get_name(): port for port in readings}
    measurement = sources.get("motion_capture")
    if estimator is not None:
        systems.append(builder.AddNamedSystem("estimator", estimator))
        measurement = estimator.GetOutputPort("measurement")
        if autopilot is not None:
            connect_inputs(builder, [autopilot], sources | {"state": measurement})
    connect_inputs(builder, systems, sources)

    parts = {"motion_capture": motion_capture, "command_link": command_link, "autopilot": autopilot}
    systems_by_name = {name: system for name, system in parts.items() if system is not None}
    ports = {
        stream: systems_by_name[name].GetInputPort(stream.name.removeprefix(f"{name}."))
        for name, streams in random_streams(systems_by_name, StreamKind.NOISE).items()
        for stream in streams
    }
    ports |= {stream: wind_diagram.GetInputPort(stream.name) for streams in wind_streams.values() for stream in streams}
    ports |= {
        stream: sensor_diagram.GetInputPort(stream.name) for streams in sensor_streams.values() for stream in streams
    }
    _connect_noise(builder, ports, samples, vehicle.num_vehicles)

    builder.ExportInput(command_link.GetInputPort(link_signal), link_signal)
    builder.ExportInput(vehicle.GetInputPort("crashed"), "crashed")
    if vehicle.HasInputPort("external_load"):
        builder.ExportInput(vehicle.GetInputPort("external_load"), "external_load")
    builder.ExportOutput(measurement, "measurement")
    builder.ExportOutput(state, "state")
    builder.ExportOutput(vehicle.GetOutputPort("rotor_speed"), "rotor_speed")
    builder.ExportOutput(allocated[command_name], command_name)
    for name in ("swing", "charge", "battery"):
        if vehicle.HasOutputPort(name):
            builder.ExportOutput(vehicle.GetOutputPort(name), name)
    if "shortfall" in allocated:
        builder.ExportOutput(allocated["shortfall"], "shortfall")
    builder.ExportOutput(wind_port, "wind")
    if autopilot is not None and "wrench" in sources:
        builder.ExportOutput(sources["wrench"], "wrench")
    if estimator is not None:
        for name in ("estimate_deviation", "innovation"):
            if estimator.HasOutputPort(name):
                builder.ExportOutput(estimator.GetOutputPort(name), name)
    if sensors:
        for port in map(sensor_diagram.get_output_port, range(sensor_diagram.num_output_ports())):
            builder.ExportOutput(port, port.get_name())
    return build(builder, "laboratory")


def _connect_noise(
    builder: DiagramBuilder,
    ports: Mapping[Stream, Any],
    samples: Samples | ExportedRandomNumbers | None,
    num_vehicles: int,
) -> None:
    """Connect or export the random input port of each stream, depending on `samples`; see `build_laboratory`."""
    match samples:
        case None:
            connect_random_sources(builder, ports)
        case ExportedRandomNumbers():
            export_noise(builder, ports, samples, num_vehicles)
        case Samples():
            connect_noise(builder, ports, samples)
