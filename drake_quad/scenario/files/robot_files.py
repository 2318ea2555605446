"""Error messages for robot files, such as URDF, which are not scenario files."""

from pathlib import PurePath

ROBOT_KINDS = {
    **dict.fromkeys((".urdf", ".xacro"), "robot (URDF)"),
    **dict.fromkeys((".sdf", ".world"), "model or world (SDFormat)"),
    **dict.fromkeys((".xml", ".mjcf"), "robot (XML, such as MJCF)"),
    **dict.fromkeys((".usd", ".usda", ".usdc", ".usdz"), "scene (USD)"),
}
"""Description of the format of a robot file, by its suffix."""


def robot_file_error(spec: str) -> str:
    """Return an error message if FILE or FILE:NAME has the suffix of a robot file; empty otherwise."""
    kind = ROBOT_KINDS.get(PurePath(spec).suffix.partition(":")[0].lower())
    if kind is None:
        return ""
    return (
        f"describes a {kind} and is not a scenario: write its mass, inertia and rotors into `nominal` of a YAML file"
        " that describes your vehicle, and give meshes of obstacles as the `points` of hulls in `space.obstacles`"
    )
