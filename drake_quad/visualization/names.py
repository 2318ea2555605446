"""Short names of scenario fields and identified parameters, for axes and tables."""

import re

# Names of list items for which the default names "x", "y" and "z" would be misleading.
_SYMBOLS = {
    "inertia": ("I_xx", "I_yy", "I_zz"),
    "centre_of_mass": ("c_x", "c_y", "c_z"),
    "attitude": ("roll", "pitch", "yaw"),
    "body_rates": ("roll rate", "pitch rate", "yaw rate"),
    "misalignment": ("roll misalignment", "pitch misalignment", "yaw misalignment"),
    "natural_frequency": ("natural frequency of roll", "natural frequency of pitch", "natural frequency of yaw"),
    "damping": ("damping of roll", "damping of pitch", "damping of yaw"),
    "curve": ("thrust curve k_0", "thrust curve k_1", "thrust curve k_2"),
}
# Short forms of parts of a name. A part with an empty short form is left out.
_ABBREVIATIONS = {
    "laboratory.motion_capture.": "",
    "laboratory.command_link.": "",
    "rotor_aerodynamics.": "",
    "body_drag.": "drag ",
    "autopilot.": "",
    "motors.": "",
}


def short_name(name: str) -> str:
    """Return the short name of a field or parameter, such as "I_xx" for `inertia[0]` and for `inertia.0`.

    Args:
        name: path of a field, such as `vehicle.inertia.0`, or name of a parameter with an index in brackets.
    """
    for long, short in _ABBREVIATIONS.items():
        name = name.replace(long, short)
    match = re.fullmatch(r"(.*?)(?:\[(\d)\]|\.(\d))", name)
    *groups, field = re.split("[. ]", name if match is None else match[1])
    label = _words(field)
    if match is not None:
        index = int(match[2] or match[3])
        symbols = _SYMBOLS.get(field, tuple(f"{label} {axis}" for axis in "xyz"))
        label = symbols[index] if index < len(symbols) else f"{label} {index + 1}"
    return " ".join([*map(_words, groups), label])


def _words(name: str) -> str:
    """Return a name with spaces in place of underscores, unless it is a symbol such as k_p."""
    return name if re.fullmatch(r"[a-z]_\w{1,2}", name) else name.replace("_", " ")
