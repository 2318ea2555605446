"""PX4 module that controls the vehicle in Offboard mode."""

from drake_quad.export.projects.project import (
    ExportedCode,
    Project,
    check_command,
    check_inputs,
    check_single_precision,
    whole_steps,
)
from drake_quad.vehicle.px4_units import torque_units


def _placeholders(code: ExportedCode) -> dict[str, str]:
    """Return the values of the template's placeholders.

    Raises:
        InputError: if the code does not command a wrench or an attitude in single precision.
    """
    description = code.description
    check_command("px4", description, ["wrench", "attitude_target"])
    check_inputs("px4", description)
    check_single_precision("px4", description)
    units = zip("XYZ", torque_units(code.nominal, 1.0), strict=True)
    commands_attitude = "attitude_target" in description.outputs
    return {
        "CLASS": "".join(word.capitalize() for word in description.name.split("_")) + "Module",
        "COMMAND": "an attitude and a thrust" if commands_attitude else "a thrust and torques",
        "MICROSECONDS": str(whole_steps("px4", description, 1e-6, "microseconds")),
        "COMMANDS_ATTITUDE": str(int(commands_attitude)),
        "HAS_JERK": str(int("reference_jerk" in description.inputs)),
        "WEIGHT": f"{code.weight:.7g}",
        **{f"TORQUE_{axis}": f"{unit:.7g}" for axis, unit in units},
    }


PX4 = Project(_placeholders, code_folder="src/modules/@NAME@")
