"""Short names of fields and parameters for axes and tables."""

import re

# Symbols for lists whose items are not along x, y and z.
_SYMBOLS = {
    "inertia": ("I_xx", "I_yy", "I_zz"),
    "centre_of_mass": ("c_x", "c_y", "c_z"),
    "misalignment": ("roll misalignment", "pitch misalignment", "yaw misalignment"),
    "natural_frequency": ("natural frequency of roll", "natural frequency of pitch", "natural frequency of yaw"),
    "damping": ("damping of roll", "damping of pitch", "damping of yaw"),
    "curve": ("thrust curve k_0", "thrust curve k_1", "thrust curve k_2"),
}
_SHORT = {
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
        name: path of a field, or name of a parameter with its place in brackets.
    """
    for long, short in _SHORT.items():
        name = name.replace(long, short)
    found = re.fullmatch(r"(.*?)(?:\[(\d)\]|\.(\d))", name)
    *holders, field = re.split("[. ]", name if found is None else found[1])
    last = _words(field)
    if found is not None:
        place = int(found[2] or found[3])
        symbols = _SYMBOLS.get(field, tuple(f"{last} {axis}" for axis in "xyz"))
        last = symbols[place] if place < len(symbols) else f"{last} {place + 1}"
    return " ".join([*map(_words, holders), last])


def _words(name: str) -> str:
    """Return a name in words; symbols such as k_p stay."""
    return name if re.fullmatch(r"[a-z]_\w{1,2}", name) else name.replace("_", " ")
