"""Merging of scenarios, where one scenario is layered over another.

Mappings are merged field by field, and any other value is replaced. Three parts are replaced as a whole, because a
mixture of two vehicles, controls or routes makes no sense: the vehicle, the control, and the route together with its
duration and metrics.
"""

from drake_quad.errors import InputError, join_names, shorten_text
from drake_quad.scenario.autopilots.autopilot import AUTOPILOTS
from drake_quad.scenario.controls.control import CONTROLS
from drake_quad.scenario.distributions import is_distribution
from drake_quad.scenario.effects.effect import EFFECTS
from drake_quad.scenario.files.marked_tree import Tree
from drake_quad.scenario.files.relative import (
    has_relative_items,
    is_relative,
    relative_part,
    with_base_value,
    with_base_values,
)
from drake_quad.scenario.models import Airframe
from drake_quad.scenario.paths import is_item, join_path

DEFAULT_VEHICLE = "default_vehicle"
"""Key of the vehicle that is used if no layer describes a vehicle."""
# Kind that is assumed for a mapping without `kind`, by the name of its field.
_DEFAULT_KINDS = {"control": CONTROLS.default_kind}
_ROTOR_POSITION_FIELDS = ("layout", "arm_length")
# Fields that remain when a layer describes a new vehicle, since gravity and the integration settings do not belong to
# the airframe.
_FLIGHT_FIELDS = {"nominal": ("gravity",), "vehicle": ("time_step", "attitude_kinematics")}
# Fields of `nominal` that describe an airframe. A description also needs one of the fields that give the rotor
# positions.
_AIRFRAME_FIELDS = Airframe.model_fields.keys() - {*_ROTOR_POSITION_FIELDS, *_FLIGHT_FIELDS["nominal"]}
# A new route removes all of these fields from the base, since they belong to the old route.
_ROUTE_FIELDS = ("route", "metrics", "duration", "initial", "requirements")


def merge(base: Tree, extension: Tree, default_kind: str | None = None) -> Tree:
    """Return a deep merge: mappings are merged by key, and any other value of the extension replaces that of the base.

    If the two mappings have different kinds, or one is a distribution, the extension replaces the whole mapping,
    because the fields have different meanings. A mapping of the extension without `kind` has the kind of the base. A
    relative distribution is stored together with the base value to which it applies.

    Args:
        base: lower layer.
        extension: upper layer.
        default_kind: kind that is assumed for a base without `kind`; None if there is no default.
    """
    old, new = base.value, extension.value
    if is_relative(extension):
        return with_base_value(base, extension)
    if has_relative_items(extension):
        return with_base_values(base, extension)
    if not (isinstance(old, dict) and isinstance(new, dict)) or is_relative(base):
        return extension
    base_kind = old["kind"].value if "kind" in old else default_kind
    kinds_differ = "kind" in new and base_kind is not None and new["kind"].value != base_kind
    if kinds_differ or _is_distribution(old) or _is_distribution(new):
        return extension
    parts = {key: merge(old[key], tree, _DEFAULT_KINDS.get(key)) if key in old else tree for key, tree in new.items()}
    return Tree({**old, **parts}, extension.mark)


def expand_list_items(tree: Tree, override: Tree, path: str = "") -> Tree:
    """Return an override in which whole lists replace single list items that are given by index.

    Args:
        tree: part of the scenario to which the override applies.
        override: override of this part.
        path: path of this part in the scenario.

    Raises:
        InputError: if an index in the override is outside its list.
    """
    old, new = tree.value, override.value
    if isinstance(old, dict) and isinstance(new, dict):
        known = {
            key: expand_list_items(old[key], value, join_path(path, key)) if key in old else value
            for key, value in new.items()
        }
        return Tree(known, override.mark)
    if isinstance(old, list) and isinstance(new, dict) and new and all(map(is_item, new)):
        items = {str(i): item for i, item in enumerate(old)}
        for key, value in new.items():
            if key not in items:
                extent = (
                    f"its items are {join_path(path, 0)} to {join_path(path, len(old) - 1)}" if old else "it is empty"
                )
                raise InputError(f"{override.mark}: {path} has no item {shorten_text(key)}; {extent}")
            items[key] = merge(items[key], expand_list_items(items[key], value, join_path(path, key)))
        return Tree([*items.values()], override.mark)
    return override


def _is_distribution(fields: dict[str, Tree]) -> bool:
    return is_distribution({name: tree.value for name, tree in fields.items()})


def with_override(base: Tree, override: Tree) -> Tree:
    """Return a scenario with the fields of an override merged into it.

    A layout with rotor distances determines the arm length, so the arm length of the base is removed.
    """
    fields = dict(base.value)
    for section in ("nominal", "vehicle"):
        (layout, depth), (_, arm) = override.at((section, "layout")), override.at((section, "arm_length"))
        if depth == 2 and arm < 2 and isinstance(layout.value, dict) and layout.value.keys() & {"length", "rotors"}:
            kept, kept_depth = base.at((section,))
            if kept_depth and isinstance(kept.value, dict):
                kept_fields = {name: part for name, part in kept.value.items() if name != "arm_length"}
                fields[section] = kept._replace(value=kept_fields)
    return merge(base._replace(value=fields), override)


def with_layer(base: Tree, layer: Tree) -> Tree:
    """Return a scenario with another scenario layered over it.

    - A layer that describes a vehicle replaces the whole airframe. Relative distributions of the base then apply to the
      new vehicle. If the base has an autopilot response that was identified with the old vehicle, the autopilot and the
      control that depends on it are removed.
    - A control with a kind replaces the control of the base.
    - A route with a kind replaces the route of the base, together with the duration, the metrics, the initial state and
      the requirements.
    """
    base_fields, new_vehicle = dict(base.value), describes_vehicle(layer)
    if new_vehicle:
        base_fields = _without_airframe(base_fields)
    if _has_kind(layer, "control"):
        base_fields.pop("control", None)
    if _has_kind(layer, "route") and "route" in base_fields:
        base_fields = {key: tree for key, tree in base_fields.items() if key not in _ROUTE_FIELDS}
    result = with_override(base._replace(value=base_fields), layer)
    if not new_vehicle:
        return result
    # Relative distributions apply to the new vehicle, so they are merged last. Those of the layer take precedence over
    # those of the base.
    for fields, mark in ((base_fields, base.mark), (layer.value, layer.mark)):
        distributions = relative_part(fields["vehicle"]) if "vehicle" in fields else None
        if distributions is not None:
            result = merge(result, expand_list_items(result, Tree({"vehicle": distributions}, mark)))
    return result


def describes_vehicle(tree: Tree) -> bool:
    """Return whether a scenario describes a vehicle, which means that its `nominal` has all fields of an airframe."""
    nominal = tree.value.get("nominal")
    return nominal is not None and isinstance(nominal.value, dict) and not _missing(nominal)


def check_description(tree: Tree) -> None:
    """Raise InputError if a scenario without `extends` describes a vehicle incompletely.

    The defaults of missing fields belong to the paper's vehicle, which has a mass of 0.68 kg. A scenario with few
    fields in `nominal` modifies that vehicle. A scenario with mass and inertia, or with most fields, describes a
    different vehicle.
    """
    nominal = tree.value.get("nominal")
    if nominal is None or not isinstance(nominal.value, dict):
        return
    missing, specified = _missing(nominal), nominal.value.keys() & {*_AIRFRAME_FIELDS, *_ROTOR_POSITION_FIELDS}
    if missing and ({"mass", "inertia"} <= specified or len(specified) > len(missing)):
        raise InputError(
            f"{nominal.mark}: nominal describes a vehicle, but without {join_names(missing)}; add these fields, since"
            " their defaults belong to the paper's vehicle"
        )


def with_default_vehicle(tree: Tree) -> Tree:
    """Layer a scenario over its default vehicle, unless the scenario itself describes a vehicle."""
    default = tree.value.get(DEFAULT_VEHICLE)
    if default is None:
        return tree
    kept_fields = tree._replace(value={key: part for key, part in tree.value.items() if key != DEFAULT_VEHICLE})
    return kept_fields if describes_vehicle(kept_fields) else with_override(default, kept_fields)


def _missing(nominal: Tree) -> list[str]:
    """Return the airframe fields that are missing in `nominal`."""
    missing = [name for name in Airframe.model_fields if name in _AIRFRAME_FIELDS - nominal.value.keys()]
    return missing if any(name in nominal.value for name in _ROTOR_POSITION_FIELDS) else ["layout", *missing]


def _without_airframe(fields: dict[str, Tree]) -> dict[str, Tree]:
    """Return a scenario without its airframe, but with the relative distributions of the airframe."""
    kept = dict(fields)
    for section, names in _FLIGHT_FIELDS.items():
        if section in kept and isinstance(kept[section].value, dict):
            distributions = relative_part(kept[section])
            flight_fields = [
                *names,
                *(name for name, effect in EFFECTS.members.items() if not effect.belongs_to_airframe),
            ]
            kept_fields = {name: part for name, part in kept[section].value.items() if name in flight_fields}
            kept[section] = kept[section]._replace(
                value={**({} if distributions is None else distributions.value), **kept_fields}
            )
    laboratory = kept.get("laboratory")
    parts = laboratory.value if laboratory is not None and isinstance(laboratory.value, dict) else {}
    autopilot = parts.get("autopilot")
    if laboratory is None or autopilot is None or not isinstance(autopilot.value, dict):
        return kept
    kind = autopilot.value.get("kind")
    model = None if kind is None else AUTOPILOTS.get(kind.value)
    if model is None:
        return kept
    others = {name: part for name, part in parts.items() if name != "autopilot"}
    if model.models_vehicle:
        kept.pop("control", None)
    else:
        fields_of_laboratory = {
            name: part for name, part in autopilot.value.items() if name not in model.airframe_fields
        }
        others["autopilot"] = autopilot._replace(value=fields_of_laboratory)
    kept["laboratory"] = laboratory._replace(value=others)
    return kept


def _has_kind(tree: Tree, field: str) -> bool:
    part = tree.value.get(field)
    return part is not None and isinstance(part.value, dict) and "kind" in part.value
