"""Ready projects around exported code, for the firmware of a vehicle."""

from pathlib import Path

from drake_quad.errors import InputError
from drake_quad.exported.description import ExportDescription

_TEMPLATES = Path(__file__).parent / "templates"
PROJECTS = ("crazyflie",)
"""Names of the projects."""
# Period of the Crazyflie's controller, s.
_CRAZYFLIE_PERIOD = 0.001
# Names of headers of the firmware that are likely names of a controller.
_CRAZYFLIE_NAMES = ("app", "controller", "estimator", "stabilizer", "state", "task")
# Largest difference between the ratio of two periods and a whole number.
_ROUNDING = 1e-9
# Inputs of a controller that the Crazyflie's firmware can provide. It knows no snap, which is zero.
_CRAZYFLIE_INPUTS = {"measurement", "state", "reference", "reference_jerk", "reference_snap"}


def project_files(project: str, description: ExportDescription) -> dict[str, str]:
    """Return the files of a project, by their paths in its folder, without the exported code.

    Args:
        project: name of the project, one of `PROJECTS`.
        description: description of the exported code.

    Raises:
        InputError: if the exported code does not fit the project.
    """
    if project not in PROJECTS:
        raise InputError(f"project is {project!r}; it must be one of {', '.join(PROJECTS)}")
    values = _crazyflie_values(description)
    folder = _TEMPLATES / project
    files = {}
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        text = path.read_text(encoding="utf-8")
        for name, value in values.items():
            text = text.replace(f"@{name}@", value)
        files[path.relative_to(folder).as_posix()] = text
    return files


def _crazyflie_values(description: ExportDescription) -> dict[str, str]:
    """Return the values of the placeholders in the project for the Crazyflie.

    Raises:
        InputError: if the exported code does not command a wrench in single precision with a suitable period.
    """
    if description.name in _CRAZYFLIE_NAMES:
        raise InputError(
            f"project crazyflie needs another name than {description.name}, which is a header of the firmware"
        )
    if [*description.outputs] != ["wrench"]:
        raise InputError(
            f"project crazyflie needs a controller that commands a wrench, not {', '.join(description.outputs)}"
        )
    if description.precision != "single":
        raise InputError("project crazyflie needs single precision, for which the microcontroller has a unit")
    calls = round(description.period / _CRAZYFLIE_PERIOD)
    if calls < 1 or abs(description.period / _CRAZYFLIE_PERIOD - calls) > _ROUNDING:
        raise InputError(f"project crazyflie needs a period of whole milliseconds, not {description.period:g} s")
    if others := [name for name in description.inputs if name not in _CRAZYFLIE_INPUTS]:
        raise InputError(f"project crazyflie cannot provide the input {others[0]}")
    jerk = ".reference_jerk = {.x = setpoint->jerk.x, .y = setpoint->jerk.y, .z = setpoint->jerk.z},"
    return {
        "NAME": description.name,
        "SCENARIO": description.scenario,
        "CALLS": str(calls),
        "MEASUREMENT": "measurement" if "measurement" in description.inputs else "state",
        "JERK": jerk if "reference_jerk" in description.inputs else "",
    }
