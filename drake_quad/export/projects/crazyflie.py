"""Out-of-tree controller for the Crazyflie firmware."""

from drake_quad.errors import InputError
from drake_quad.export.projects.project import (
    ExportedCode,
    Project,
    check_command,
    check_inputs,
    check_single_precision,
    whole_steps,
)

# Period at which the firmware calls the controller, s.
_FIRMWARE_PERIOD = 0.001
# Names of firmware headers that a user is likely to choose as the name of a controller.
_FIRMWARE_HEADERS = ("app", "controller", "estimator", "stabilizer", "state", "task")


def _placeholders(code: ExportedCode) -> dict[str, str]:
    """Return the values of the template's placeholders.

    Raises:
        InputError: if the output of the code is not a wrench, if the firmware cannot provide an input of the code, if
            the code is not in single precision, if its period is not a whole number of milliseconds, or if a header of
            the firmware has the name of the code.
    """
    description = code.description
    if description.name in _FIRMWARE_HEADERS:
        raise InputError(
            f"project crazyflie cannot use the name {description.name}, since a header of the firmware has this name;"
            " choose another name with --name"
        )
    check_command("crazyflie", description, ["wrench"])
    check_inputs("crazyflie", description)
    check_single_precision("crazyflie", description)
    # The firmware does not provide the snap of the reference, so the controller assumes that the snap is zero.
    jerk = ".reference_jerk = {.x = setpoint->jerk.x, .y = setpoint->jerk.y, .z = setpoint->jerk.z},"
    return {
        "CALLS": str(whole_steps("crazyflie", description, _FIRMWARE_PERIOD, "milliseconds")),
        "MASS": f"{code.nominal.mass:.4g}",
        "JERK": jerk if "reference_jerk" in description.inputs else "",
    }


CRAZYFLIE = Project(_placeholders, code_folder="src")
