"""Drake system that advances the firmware of a fleet in lockstep with the simulation."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np
from pydrake.systems.framework import BasicVector, Context, Diagram, DiscreteValues, EventStatus, LeafSystem

from drake_quad.firmware.controller import FirmwareError, FlightController
from drake_quad.firmware.options import FlightControllerOptions
from drake_quad.firmware.pilot import FlightControllerInput
from drake_quad.process_settings import current_processor, on_processor

_NUM_ROTORS = 4
_START_MESSAGE = (
    "the state of the firmware is not part of the context, so a simulation must start at time zero; start a new one"
)


class FirmwareInTheLoop(LeafSystem):
    """Flight controllers of a fleet, each with its own firmware, which advance by one step in every period.

    At the start of a simulation, the firmware of every vehicle is started. At each tick, the firmware receives its
    inputs, and runs for one period. Its commands at the end of this period are output from the tick on, and held until
    the next tick. A real flight controller takes a fraction of a millisecond for the computation.

    The discrete state contains the commands (4 rows), and the number of ticks. The state of the firmware itself is not
    part of the context. A simulation can therefore only start at time zero, and not from the context of another one.

    The input and output ports are vectors with k rows of N elements, for N vehicles.

    Args:
        num_vehicles: number of vehicles N.
        period: period of a tick, s.
        input_name: name of the input port.
        num_inputs: number of inputs of the firmware of one vehicle.
        command: name of the output port, `throttle_command` or `rotor_speed_command`.
        start: function that starts the firmware of a vehicle at the start of a flight, given the number of the vehicle
            and its (num_inputs,) inputs.
    """

    def __init__(
        self,
        num_vehicles: int = 1,
        *,
        period: float,
        input_name: str,
        num_inputs: int,
        command: str,
        start: Callable[[int, np.ndarray], FlightController],
    ) -> None:
        super().__init__()
        self.num_vehicles = num_vehicles
        self._options: dict[str, Any] = {
            "period": period,
            "input_name": input_name,
            "num_inputs": num_inputs,
            "command": command,
            "start": start,
        }
        self._period, self._start = period, start
        self._controllers: list[FlightController] = []
        self._num_ticks, self._processor = 0, 0
        self.DeclareVectorInputPort(input_name, num_inputs * num_vehicles)
        self._commands = self.DeclareDiscreteState(_NUM_ROTORS * num_vehicles)
        self._ticks = self.DeclareDiscreteState(1)
        self.DeclareInitializationDiscreteUpdateEvent(self._restart)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._step)
        self.DeclareVectorOutputPort(
            command, _NUM_ROTORS * num_vehicles, self._copy_commands, {self.discrete_state_ticket(self._commands)}
        )

    @property
    def processor(self) -> int | None:
        """Number of the processor on which the firmware runs; None if no firmware is running."""
        return self._processor if self._controllers else None

    def new_copy(self) -> "FirmwareInTheLoop":
        """Return a new system with the same arguments, for another diagram."""
        return FirmwareInTheLoop(self.num_vehicles, **self._options)

    def close(self) -> None:
        """Stop the firmware of all vehicles."""
        for controller in self._controllers:
            controller.close()
        self._controllers = []

    def _copy_commands(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(context.get_discrete_state(self._commands).value())

    def _inputs(self, context: Context) -> np.ndarray:
        """Return the (N, k) inputs of the flight controllers."""
        inputs: np.ndarray = self.get_input_port().Eval(context).reshape(-1, self.num_vehicles).T
        return inputs

    def _restart(self, context: Context, state: DiscreteValues) -> EventStatus:
        if context.get_time() != 0.0:
            raise FirmwareError(_START_MESSAGE)
        self.close()
        self._num_ticks = 0
        self._processor = current_processor()
        try:
            with on_processor(self._processor):
                for vehicle, inputs in enumerate(self._inputs(context)):
                    self._controllers.append(self._start(vehicle, inputs))
        except BaseException:
            self.close()
            raise
        commands = np.transpose([controller.initial_commands for controller in self._controllers])
        state.set_value(self._commands, commands.ravel())
        state.set_value(self._ticks, [0.0])
        return EventStatus.Succeeded()

    def _step(self, context: Context, state: DiscreteValues) -> EventStatus:
        if not self._controllers or context.get_discrete_state(self._ticks).value()[0] != self._num_ticks:
            raise FirmwareError(_START_MESSAGE)
        inputs = self._inputs(context)
        time = self._num_ticks * self._period
        commands = np.empty((_NUM_ROTORS, self.num_vehicles))
        vehicle = 0
        try:
            for vehicle, controller in enumerate(self._controllers):
                controller.send(inputs[vehicle])
            for vehicle, controller in enumerate(self._controllers):
                commands[:, vehicle] = controller.receive()
        except FirmwareError as error:
            self.close()
            place = f" of vehicle {vehicle + 1}" if self.num_vehicles > 1 else ""
            raise FirmwareError(f"the flight{place} ended at {time:.3f} s: {error}") from None
        self._num_ticks += 1
        state.set_value(self._commands, commands.ravel())
        state.set_value(self._ticks, [float(self._num_ticks)])
        return EventStatus.Succeeded()


def firmware_in_the_loop(
    num_vehicles: int = 1, *, controller: Any, options: FlightControllerOptions, command: str
) -> FirmwareInTheLoop:
    """Return the system that runs a firmware that is flown with sticks, for N vehicles.

    Args:
        num_vehicles: number of vehicles N.
        controller: class of the flight controllers, whose arguments are the options, the number of the vehicle, and the
            inputs at the start.
        options: options of the flight controllers.
        command: name of the output port, `throttle_command` or `rotor_speed_command`.
    """
    return FirmwareInTheLoop(
        num_vehicles,
        period=options.period,
        input_name="flight_controller_input",
        num_inputs=len(FlightControllerInput._fields),
        command=command,
        start=partial(controller, options),
    )


@contextmanager
def firmware_session(diagram: Diagram) -> Iterator[None]:
    """Run the calling thread beside the firmware of a diagram, and stop the firmware at the end of the statement.

    Without firmware, there is no effect. Simulation and firmware never compute at the same time. On one processor they
    alternate in a few microseconds. On two, each has to wake the other processor up, which makes flights half as fast.
    """
    systems = [system for system in _leaf_systems(diagram) if isinstance(system, FirmwareInTheLoop)]
    if not systems:
        yield
        return
    processor = systems[0].processor
    try:
        with on_processor(current_processor() if processor is None else processor):
            yield
    finally:
        for system in systems:
            system.close()


def _leaf_systems(diagram: Any) -> Iterator[Any]:
    for system in diagram.GetSystems():
        if isinstance(system, Diagram):
            yield from _leaf_systems(system)
        else:
            yield system
