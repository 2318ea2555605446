"""How scenarios are laid over each other.

Mappings are joined field by field, and anything else replaces. Three things replace as a whole, since half of one and
half of another make no sense: a vehicle, a control, and a route with what belongs to it.
"""

from drake_quad.errors import InputError, listed
from drake_quad.scenario.distributions import is_distribution
from drake_quad.scenario.marked_tree import Tree
from drake_quad.scenario.relative import (
    are_relative,
    is_relative,
    laid_on_value,
    laid_on_values,
    relative_part,
)

DEFAULT_VEHICLE = "default_vehicle"
"""The key of the vehicle that flies where no layer describes one."""
# The kind of a field that may leave it out.
SILENT_KINDS = {"control": "cascade"}
# Fields of `nominal` that describe an airframe. The place of the rotors may be given in two ways.
_DESCRIPTION = (
    "mass",
    "inertia",
    "thrust_factor",
    "drag_factor",
    "rotor_inertia",
    "min_rotor_speed",
    "max_rotor_speed",
)
_PLACES = ("layout", "arm_length")
# Fields that are not part of the airframe: gravity, how motion is integrated, and what happens to the vehicle in this
# flight.
_NOT_OF_THE_AIRFRAME = {
    "nominal": ("gravity",),
    "vehicle": ("time_step", "attitude_kinematics", "rotor_failure", "payload", "slung_load"),
}
# Fields that are those of a flight along a route.
_OF_THE_ROUTE = ("route", "metrics", "duration")


def merged(base: Tree, extension: Tree, silent: str | None = None) -> Tree:
    """Return a deep merge: mappings are joined, anything else in the extension replaces.

    A mapping of another `kind`, or a distribution, replaces as a whole: its fields mean something else. A control in
    the base that does not say its kind is a cascade; one in the extension is of whatever kind is there. A relative
    distribution keeps the value that it is laid on.

    Args:
        base: that is laid under.
        extension: that is laid over it.
        silent: kind of a base that does not say it.
    """
    old, new = base.value, extension.value
    if is_relative(extension):
        return laid_on_value(base, extension)
    if are_relative(extension):
        return laid_on_values(base, extension)
    if not (isinstance(old, dict) and isinstance(new, dict)) or is_relative(base):
        return extension
    before = old["kind"].value if "kind" in old else silent
    other_kind = "kind" in new and before is not None and new["kind"].value != before
    if other_kind or _is_distribution(old) or _is_distribution(new):
        return extension
    joined = {key: merged(old[key], tree, SILENT_KINDS.get(key)) if key in old else tree for key, tree in new.items()}
    return Tree({**old, **joined}, extension.mark)


def _is_distribution(fields: dict[str, Tree]) -> bool:
    return is_distribution({name: tree.value for name, tree in fields.items()})


def changed(base: Tree, override: Tree) -> Tree:
    """Return a scenario with the fields that an override names changed.

    An arm length beneath a layout with distances, which say it themselves, is dropped.
    """
    fields = dict(base.value)
    for section in ("nominal", "vehicle"):
        (layout, depth), (_, arm) = override.at((section, "layout")), override.at((section, "arm_length"))
        if depth == 2 and arm < 2 and isinstance(layout.value, dict) and layout.value.keys() & {"length", "rotors"}:
            kept, found = base.at((section,))
            if found and isinstance(kept.value, dict):
                own = {name: part for name, part in kept.value.items() if name != "arm_length"}
                fields[section] = kept._replace(value=own)
    return merged(base._replace(value=fields), override)


def laid_over(base: Tree, layer: Tree) -> Tree:
    """Return a scenario with another one laid over it.

    A layer that describes a vehicle replaces the vehicle: nothing of the airframe beneath is left, but relative
    distributions apply to the new one. A response of the attitude that was identified with the airframe goes with it,
    and with that the control that relied on it. A control or a route that says its kind replaces the one beneath; with
    a route go the duration of its flight and the window of its metrics.
    """
    beneath, new_vehicle = dict(base.value), describes_vehicle(layer)
    if new_vehicle:
        beneath = _without_airframe(beneath)
    if _has_kind(layer, "control"):
        beneath.pop("control", None)
    if _has_kind(layer, "route") and "route" in beneath:
        beneath = {key: tree for key, tree in beneath.items() if key not in _OF_THE_ROUTE}
    result = changed(base._replace(value=beneath), layer)
    if not new_vehicle:
        return result
    # Relative distributions apply to the new vehicle, so they come on top of it; those of the layer come last.
    for fields, mark in ((beneath, base.mark), (layer.value, layer.mark)):
        spreads = relative_part(fields["vehicle"]) if "vehicle" in fields else None
        if spreads is not None:
            result = merged(result, Tree({"vehicle": spreads}, mark))
    return result


def describes_vehicle(tree: Tree) -> bool:
    """Return whether a scenario describes a vehicle: whether its `nominal` has all that an airframe is."""
    nominal = tree.value.get("nominal")
    return nominal is not None and isinstance(nominal.value, dict) and not _missing(nominal)


def check_description(tree: Tree) -> None:
    """Raise InputError if a scenario that extends nothing describes a vehicle in part.

    The rest of it would be the paper's vehicle, of 0.68 kg.
    """
    nominal = tree.value.get("nominal")
    if nominal is None or not isinstance(nominal.value, dict) or not {"mass", "inertia"} <= nominal.value.keys():
        return
    if missing := _missing(nominal):
        raise InputError(
            f"{nominal.mark}: nominal describes a vehicle by its mass and inertia, but not by its {listed(missing)},"
            " which would be those of the paper's vehicle"
        )


def with_default_vehicle(tree: Tree) -> Tree:
    """Return a scenario whose vehicle is the default one, unless it describes another."""
    default = tree.value.get(DEFAULT_VEHICLE)
    if default is None:
        return tree
    own = tree._replace(value={key: part for key, part in tree.value.items() if key != DEFAULT_VEHICLE})
    return own if describes_vehicle(own) else changed(default, own)


def _missing(nominal: Tree) -> list[str]:
    """What of an airframe is not described."""
    missing = [name for name in _DESCRIPTION if name not in nominal.value]
    return missing if any(name in nominal.value for name in _PLACES) else ["layout", *missing]


def _without_airframe(fields: dict[str, Tree]) -> dict[str, Tree]:
    """The fields of a scenario without its vehicle, of which only what is relative is left."""
    kept = dict(fields)
    for section, names in _NOT_OF_THE_AIRFRAME.items():
        if section in kept and isinstance(kept[section].value, dict):
            spreads = relative_part(kept[section])
            own = {name: part for name, part in kept[section].value.items() if name in names}
            kept[section] = kept[section]._replace(value={**({} if spreads is None else spreads.value), **own})
    laboratory = kept.get("laboratory")
    if laboratory is not None and isinstance(laboratory.value, dict) and _is_identified(laboratory):
        others = {name: part for name, part in laboratory.value.items() if name != "autopilot"}
        kept["laboratory"] = laboratory._replace(value=others)
        kept.pop("control", None)
    return kept


def _is_identified(laboratory: Tree) -> bool:
    """Whether the autopilot of a laboratory is a response that was identified with one vehicle."""
    autopilot = laboratory.value.get("autopilot")
    kind = autopilot.value.get("kind") if autopilot is not None and isinstance(autopilot.value, dict) else None
    return kind is not None and kind.value == "response"


def _has_kind(tree: Tree, field: str) -> bool:
    part = tree.value.get(field)
    return part is not None and isinstance(part.value, dict) and "kind" in part.value
