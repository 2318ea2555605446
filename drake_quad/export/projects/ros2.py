"""ROS 2 package with a node that controls the vehicle."""

from drake_quad.export.projects.project import ExportedCode, Project, check_command, check_inputs, whole_steps


def _placeholders(code: ExportedCode) -> dict[str, str]:
    """Return the values of the template's placeholders.

    Raises:
        InputError: if the code does not command a wrench or an attitude.
    """
    description = code.description
    check_command("ros2", description, ["wrench", "attitude_target"])
    check_inputs("ros2", description)
    commands_attitude = "attitude_target" in description.outputs
    return {
        "COMMAND": "an attitude and a thrust for MAVROS" if commands_attitude else "a wrench",
        "MAVROS_DEPENDENCY": "<depend>mavros_msgs</depend>" if commands_attitude else "",
        "MAVROS_PACKAGE": "mavros_msgs" if commands_attitude else "",
        "MICROSECONDS": str(whole_steps("ros2", description, 1e-6, "microseconds")),
        "COMMANDS_ATTITUDE": str(int(commands_attitude)),
        "NUMBER": code.number_type,
        "WEIGHT": f"{code.weight:.7g}",
    }


ROS2 = Project(_placeholders, code_folder="src")
