"""Registration of a user's Python controllers, so that scenarios can name them as a `kind`.

In a module `mine`, `register_controller(SlidingMode)` registers the kind `mine.SlidingMode`. The output ports of the
class determine whether this is a kind of position controller or a kind of `control`. Scenarios, commands and functions
then accept `kind: mine.SlidingMode` in the same way as the kinds of this library. If the system is a `FleetSystem` that
declares a record of parameters with defaults, as in `def declare(self, *, parameters=Gains())`, these parameters are
fields of the kind.

A scenario can use a kind only after the kind's module was imported. Scenarios never import modules.
"""

import inspect
import shlex
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, Literal

from pydantic import Field
from pydrake.systems.framework import Diagram, DiagramBuilder

from drake_quad.assembly.user_systems import UserSystems, check_user_systems
from drake_quad.control.position import FeedForward
from drake_quad.errors import InputError, did_you_mean, shortest_path
from drake_quad.exported.system import ExportedController, exported_controller
from drake_quad.framework.recipe import Recipe
from drake_quad.framework.wiring import build
from drake_quad.scenario.controls.control import CONTROLS, Control
from drake_quad.scenario.controls.thrust_vectoring import ThrustVectoringSettings
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.position_controllers.controller import POSITION_CONTROLLERS, PositionController
from drake_quad.scenario.quantities import Number
from drake_quad.scenario.sensors.sensor import SENSORS
from drake_quad.scenario.setting import ControlSetting
from drake_quad.scenario.user_code import defining_file

_CONTROL_COMMANDS = ("wrench", "attitude_target")
COMMANDS = ("acceleration_command", *_CONTROL_COMMANDS)
"""Names of the output ports that make a system a controller."""


class _UserSystemSettings(Model):
    """Settings of a user's Python system in a scenario.

    Attributes:
        system: class of the system.
    """

    system: ClassVar[type]

    @classmethod
    def registration_option(cls) -> str:
        """Return the command-line option that registers the system, such as `--controller mine.py:SlidingMode`.

        The option is "" if the system is not defined in a file that a command can import.
        """
        if issubclass(cls.system, ExportedController):
            return f"--controller {shlex.quote(str(shortest_path(cls.system.folder.resolve())))}"
        file = "" if cls.system.__module__ == "__main__" else defining_file(cls.system)
        return f"--controller {file}:{cls.system.__name__}" if file else ""

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the class of the system, so that another process imports its module or compiles the exported code."""
        if issubclass(self.system, ExportedController):
            return _unpickle_export, (self.system.folder, self.system.machine, dict(self))
        return _unpickle_settings, (self.system, dict(self))


class RegisteredPositionController(_UserSystemSettings, PositionController):
    """Settings of a position controller that is a user's Python system."""

    feed_forward: FeedForward = Field(  # type: ignore[misc]
        default="none", description="highest derivative of the reference that the attitude control feeds forward"
    )
    takes_correction: ClassVar = False
    is_user_system: ClassVar = True

    def recipes(self, setting: ControlSetting) -> dict[str, Recipe]:
        """Return the recipe that builds the user's Python system, keyed by its role."""
        return {"position": _recipe(self)}


class RegisteredControl(_UserSystemSettings, Control):
    """Settings of a control that is a user's Python system."""

    network: ClassVar = None

    def recipes(self, setting: ControlSetting) -> dict[str, Recipe]:
        """Return the recipe that builds the user's Python system, keyed by its role."""
        return {"system": _recipe(self)}

    def build(self, systems: Mapping[str, Any], user_systems: Mapping[str, Any]) -> Diagram:
        """Return a diagram that contains only the user's system, and exports the ports of this system."""
        system, builder = systems["system"], DiagramBuilder()
        builder.AddNamedSystem("system", system)
        for port in map(system.get_input_port, range(system.num_input_ports())):
            builder.ExportInput(port, port.get_name())
        for port in map(system.get_output_port, range(system.num_output_ports())):
            builder.ExportOutput(port, port.get_name())
        return build(builder, "control")

    def contains_user_system(self) -> bool:
        """Return True, since the control is a user's Python system."""
        return True

    def limits(self) -> ThrustVectoringSettings:
        """Return the default limits on the commands, which a user's system may ignore."""
        return ThrustVectoringSettings()


def register_controller(system: Any) -> str:
    """Register a Drake system class as a kind of controller, and return the name of the kind.

    The kind is called `MODULE.CLASS`. A class with the output port `acceleration_command` becomes a position
    controller. A class with the output port `wrench` or `attitude_target` becomes a control.

    Args:
        system: class with the ports that `simulate` requires of a `position_controller` or a `control`. For studies and
            fleets, its constructor must accept `num_vehicles`, the number N of vehicles.

    Raises:
        InputError: if the class has none of these output ports or cannot be constructed.
    """
    if not isinstance(system, type):
        raise InputError(f"a controller must be the class of a Drake system, not {system!r}")
    kind = system.__name__ if system.__module__ == "__main__" else f"{system.__module__}.{system.__name__}"
    if _find_registered(kind, system) is not None:
        return kind
    role, command = _role_of(_construct(system, 1))
    settings: Any = RegisteredControl if role == "control" else RegisteredPositionController
    for num_vehicles in (1, 2) if _accepts_num_vehicles(system) else (1,):
        user_systems = UserSystems(**{role: _construct(system, num_vehicles)})
        check_user_systems(user_systems, num_vehicles, command=command, sensors=SENSORS.signals)
    parameters = _default_parameters(system)
    fields = {} if parameters is None else parameters._asdict()
    annotations: dict[str, Any] = {"kind": Literal[kind], "system": ClassVar[type], **dict.fromkeys(fields, Number)}
    model: Any = type(settings)(
        f"{system.__name__}Settings",
        (settings,),
        {
            "__module__": system.__module__,
            "__doc__": inspect.getdoc(system),
            "__annotations__": annotations,
            "system": system,
            **{name: Field(default=value, description="parameter of the controller") for name, value in fields.items()},
        },
    )
    (CONTROLS if role == "control" else POSITION_CONTROLLERS).register(model)
    return kind


def registered_leaf_systems(scenario: Scenario, num_vehicles: int) -> dict[str, Any]:
    """Return a new system for each user-defined controller of a scenario whose class is not a `FleetSystem`.

    Each key is the name of the argument of `simulate` that accepts the system.
    """
    control: Any = scenario.control
    settings = {"control": control, "position_controller": getattr(control, "position", None)}
    return {
        argument: _recipe(each).build(num_vehicles)
        for argument, each in settings.items()
        if isinstance(each, _UserSystemSettings) and not hasattr(each.system, "declare")
    }


def _construct(system: type, num_vehicles: int, **parameters: Any) -> Any:
    """Construct a system for N vehicles, or for one vehicle if its constructor has no argument `num_vehicles`.

    Raises:
        InputError: if the constructor fails.
    """
    accepts_num_vehicles = _accepts_num_vehicles(system)
    if num_vehicles > 1 and not accepts_num_vehicles:
        raise InputError(
            f"{system.__name__} flies a single vehicle; for studies and fleets, its constructor must take num_vehicles,"
            " and each port must contain the values of all vehicles, as in docs/how_to/your_own_controller.md"
        )
    try:
        return system(num_vehicles=num_vehicles, **parameters) if accepts_num_vehicles else system(**parameters)
    except TypeError as error:
        raise InputError(
            f"{system.__name__} cannot be built: {error}; the constructor of a controller must work without"
            " arguments, or with num_vehicles, the number of vehicles"
        ) from error


def _accepts_num_vehicles(system: type) -> bool:
    """Return whether the constructor of a class has an argument `num_vehicles`."""
    try:
        return "num_vehicles" in inspect.signature(system).parameters
    except ValueError:  # some classes implemented in C++ have no signature
        return False


def _role_of(system: Any) -> tuple[str, str]:
    """Return the field of `UserSystems` to which a system belongs, and the command that goes over the command link.

    Raises:
        InputError: if the system has the output port of neither a position controller nor a control.
    """
    count = system.num_output_ports() if hasattr(system, "num_output_ports") else 0
    ports = {system.get_output_port(i).get_name() for i in range(count)}
    if "acceleration_command" in ports and not ports & {*_CONTROL_COMMANDS}:
        return "position_controller", "wrench"
    command = next((name for name in _CONTROL_COMMANDS if name in ports), None)
    if command is None:
        question = next(filter(None, (did_you_mean(port, COMMANDS, 1) for port in sorted(ports))), "")
        hint = f"; {question}" if question else ""
        raise InputError(
            f"{type(system).__name__} has no output port `acceleration_command`, `wrench` or `attitude_target`{hint}"
        )
    return "control", command


def _default_parameters(system: Any) -> Any:
    """Return the default parameter record that a `FleetSystem` declares; None if its fields are not plain numbers."""
    if not hasattr(system, "declare"):
        return None
    parameter = inspect.signature(system.declare).parameters.get("parameters")
    default: Any = None if parameter is None else parameter.default
    flat = hasattr(default, "_fields") and all(isinstance(value, float | int) for value in default)
    return default if flat else None


def _recipe(settings: Any) -> Recipe:
    """Return the recipe for the system of a registered kind, given the settings of this kind."""
    parameters = _default_parameters(settings.system)
    if parameters is not None:
        parameters = type(parameters)(*(getattr(settings, name) for name in parameters._fields))
    return Recipe(partial(_construct, settings.system), {}, parameters)


def _find_registered(kind: str, system: type) -> Any:
    """Return the settings class that is registered as `kind` if it belongs to this system class; otherwise None."""
    found = POSITION_CONTROLLERS.get(kind) or CONTROLS.get(kind)
    # The kind of exported code contains a digest of the code, so equal kinds mean equal code.
    is_same = getattr(found, "system", None) is system or (found is not None and issubclass(system, ExportedController))
    return found if is_same else None


def _unpickle_settings(system: type, fields: dict[str, Any]) -> Any:
    """Unpickle the settings of a system in another process, where its kind may not be registered yet."""
    return _find_registered(register_controller(system), system).model_construct(**fields)


def _unpickle_export(folder: Path, machine: str, fields: dict[str, Any]) -> Any:
    """Unpickle the settings of an exported controller in another process."""
    return _unpickle_settings(exported_controller(folder, machine), fields)
