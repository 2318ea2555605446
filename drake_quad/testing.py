"""Check that a system obeys the rules on which flights, fleets, studies and linear models rely."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from pydrake.autodiffutils import AutoDiffXd
from pydrake.systems.analysis import Simulator_
from pydrake.systems.framework import Diagram, DiagramBuilder, PortDataType
from pydrake.systems.primitives import ConstantVectorSource, ZeroOrderHold

from drake_quad.assembly.registered_controllers import COMMANDS
from drake_quad.assembly.user_systems import PORTS
from drake_quad.compilation.blocks import find_block
from drake_quad.compilation.compile_diagram import compile_diagram
from drake_quad.errors import did_you_mean, join_names
from drake_quad.framework.fleet_system import FleetSystem
from drake_quad.signals import SIGNALS

# Number of instants at which outputs are compared.
_NUM_TIMES = 6
# Time between comparisons for a system without a periodic event, s.
_DEFAULT_PERIOD = 0.02
# Tolerance on outputs, relative to the largest output or to 1. It allows several thousand rounding errors.
_TOLERANCE = 1e-12
# Tolerance on the outputs of compiled diagrams, whose elementary functions may round differently.
_COMPILED_TOLERANCE = 1e-9

# A port name that is at least this similar to a signal name counts as misspelt; 1 means equal. The name `accel_command`
# counts as misspelt, `estimate` does not.
_MIN_SIMILARITY = 0.78


class _Inputs(NamedTuple):
    """Inputs of a system for N vehicles over time.

    Attributes:
        rows: input values (num_times, num_rows, N) by port name.
        times: (num_times,) times at which the inputs change, s.
        num_vehicles: number N of vehicles.
    """

    rows: dict[str, np.ndarray]
    times: np.ndarray
    num_vehicles: int

    def of_vehicle(self, vehicle: int) -> "_Inputs":
        rows = {name: rows[..., vehicle : vehicle + 1] for name, rows in self.rows.items()}
        return self._replace(rows=rows, num_vehicles=1)


def check_system(make: Callable[[int], Any], *, num_vehicles: int = 3, seed: int = 0) -> tuple[str, ...]:
    """Check that a system obeys the rules on which flights, fleets, studies and linear models rely.

    - names: flights connect ports by name. Unless the system is a `FleetSystem`, which checks names itself, this
      function rejects port names that look like a misspelt signal. It also rejects input ports of a controller that are
      not signals.
    - ports: each port of a fleet has, for each vehicle, as many components as the same port of a single vehicle.
    - context: outputs depend only on the context, not on earlier computations.
    - vehicles: the outputs of a vehicle in a fleet equal its outputs when it is simulated alone.
    - numbers: outputs are not NaN if the inputs are finite.
    - derivatives: if the system can be converted to AutoDiffXd, the conversion does not change the values of the
      outputs.
    - compiled: if the system is a `FleetSystem` or a diagram of such systems, machine code computes the same outputs.

    Inputs are random numbers between 0.1 and 0.9.

    Args:
        make: function that returns the system for a given number of vehicles, such as the class of the system.
        num_vehicles: number N of vehicles of the fleet.
        seed: seed of the inputs.

    Returns:
        Names of the rules that apply to the system, all of which it obeys.

    Raises:
        AssertionError: if the system breaks a rule; the message names the rule, the port and the difference.
    """
    single, fleet = make(1), make(num_vehicles)
    _check_names(single)
    ports = _check_ports(single, fleet, num_vehicles)
    first, second = (_random_inputs(single, ports, num_vehicles, seed + i) for i in range(2))
    expected = _outputs(fleet, first)
    for name, values in expected.items():
        assert not np.isnan(values).any(), f"numbers: `{name}` is NaN for inputs between 0.1 and 0.9"
    after_others, of_new = _outputs(fleet, second), _outputs(make(num_vehicles), second)
    _compare("context", "after other inputs in another context", after_others, of_new, 0.0)
    for vehicle in range(num_vehicles):
        outputs = _outputs(make(1), first.of_vehicle(vehicle))
        in_fleet = {name: values[..., vehicle : vehicle + 1] for name, values in expected.items()}
        _compare("vehicles", f"if vehicle {vehicle} is simulated alone", outputs, in_fleet, _TOLERANCE)
    applied = ["names", "ports", "context", "vehicles", "numbers"]
    differentiable = fleet.ToAutoDiffXdMaybe()
    if differentiable is not None:
        _compare("derivatives", "with AutoDiffXd", _outputs(differentiable, first, AutoDiffXd), expected, _TOLERANCE)
        applied.append("derivatives")
    if _can_be_compiled(fleet):
        compiled = compile_diagram(_with_clock(make(num_vehicles), first.times[1], num_vehicles))
        _compare("compiled", "in machine code", _outputs(compiled, first), expected, _COMPILED_TOLERANCE)
        applied.append("compiled")
    return tuple(applied)


def _check_names(system: Any) -> None:
    """Check the rule "names". A `FleetSystem` is skipped, because its declaration has already checked the names."""
    if isinstance(system, FleetSystem):
        return
    inputs, outputs = _inputs_of(system), _outputs_of(system)
    is_controller = not outputs.keys().isdisjoint(COMMANDS)
    for name in [each for each in (*inputs, *outputs) if each not in SIGNALS]:
        question = did_you_mean(name, SIGNALS, 1, similarity=_MIN_SIMILARITY)
        if is_controller and name in inputs:
            question = did_you_mean(name, SIGNALS, 1) or f"they connect {join_names([*PORTS['control'].inputs])}"
        assert not question, f"names: flights connect no port called `{name}`; {question}"


def _check_ports(single: Any, fleet: Any, num_vehicles: int) -> dict[str, int]:
    """Check the rule "ports", and return the number of components of each input port for one vehicle, by name."""
    for one, many in ((_inputs_of(single), _inputs_of(fleet)), (_outputs_of(single), _outputs_of(fleet))):
        assert list(one) == list(many), f"ports: one vehicle has {list(one)}, but a fleet has {list(many)}"
        for name, port in one.items():
            assert port.get_data_type() == PortDataType.kVectorValued, f"ports: `{name}` is not vector-valued"
            size, expected_size = many[name].size(), num_vehicles * port.size()
            fault = f"ports: `{name}` has {size} elements for {num_vehicles} vehicles, but must have {expected_size}"
            assert size == expected_size, fault
    return {name: port.size() for name, port in _inputs_of(single).items()}


def _inputs_of(system: Any) -> dict[str, Any]:
    ports = [system.get_input_port(i) for i in range(system.num_input_ports())]
    return {port.get_name(): port for port in ports}


def _outputs_of(system: Any) -> dict[str, Any]:
    ports = [system.get_output_port(i) for i in range(system.num_output_ports())]
    return {port.get_name(): port for port in ports}


def _random_inputs(system: Any, ports: dict[str, int], num_vehicles: int, seed: int) -> _Inputs:
    generator = np.random.default_rng(seed)
    events = system.GetUniquePeriodicDiscreteUpdateAttribute()
    period = _DEFAULT_PERIOD if events is None else events.period_sec()
    rows = {name: generator.uniform(0.1, 0.9, (_NUM_TIMES, size, num_vehicles)) for name, size in ports.items()}
    return _Inputs(rows, period * np.arange(_NUM_TIMES), num_vehicles)


def _outputs(system: Any, inputs: _Inputs, scalar: type = float) -> dict[str, np.ndarray]:
    """Return the outputs of a system, computed in a new context, as arrays (num_times, num_rows, N) by port name."""
    context = system.CreateDefaultContext()
    simulator: Any = None
    outputs: dict[str, list[np.ndarray]] = {name: [] for name in _outputs_of(system)}
    for i, time in enumerate(inputs.times):
        for name, port in _inputs_of(system).items():
            port.FixValue(context, inputs.rows[name][i].ravel())
        if simulator is None:
            simulator = Simulator_[scalar](system, context)
            simulator.Initialize()
        simulator.AdvanceTo(time)
        for name, port in _outputs_of(system).items():
            values = np.array([_number(value) for value in port.Eval(context)])
            outputs[name].append(values.reshape(-1, inputs.num_vehicles))
    return {name: np.array(values) for name, values in outputs.items()}


def _number(value: Any) -> float:
    return float(value.value()) if isinstance(value, AutoDiffXd) else float(value)


def _can_be_compiled(system: Any) -> bool:
    if isinstance(system, Diagram):
        return all(map(_can_be_compiled, system.GetSystems()))
    return find_block(system) is not None


def _with_clock(system: Any, period: float, num_vehicles: int) -> Any:
    """Return a diagram of a system and a clock, because only diagrams with a periodic event can be compiled.

    Args:
        system: system for N vehicles.
        period: period of the clock, s.
        num_vehicles: number N of vehicles.
    """
    builder = DiagramBuilder()
    builder.AddNamedSystem("system", system)
    clock = builder.AddNamedSystem("clock", ZeroOrderHold(period, num_vehicles))
    zeros = builder.AddNamedSystem("zeros", ConstantVectorSource(np.zeros(num_vehicles)))
    builder.Connect(zeros.get_output_port(), clock.get_input_port())
    for name, port in _inputs_of(system).items():
        builder.ExportInput(port, name)
    for name, port in _outputs_of(system).items():
        builder.ExportOutput(port, name)
    return builder.Build()


def _compare(
    rule: str, condition: str, actual: dict[str, np.ndarray], expected: dict[str, np.ndarray], tolerance: float
) -> None:
    for name, values in expected.items():
        size = max(1.0, float(np.abs(values[np.isfinite(values)]).max(initial=0.0)))
        unequal = actual[name] != values  # equal infinite numbers are excluded, since their difference is NaN
        difference = float(np.abs(actual[name][unequal] - values[unequal]).max(initial=0.0)) / size
        assert difference <= tolerance, f"{rule}: `{name}` differs by {difference:.2g} {condition}"
