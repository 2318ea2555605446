"""JSON schema and Markdown page of the scenario language, generated from its models."""

from collections.abc import Iterator
from importlib.resources import files
from typing import Any

from drake_quad.scenario import limits
from drake_quad.scenario.distributions import DISTRIBUTIONS
from drake_quad.scenario.files.layers import DEFAULT_VEHICLE
from drake_quad.scenario.files.relative import RELATIVE
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.world import VEHICLES, WORLD, VehicleSettings, WorldSettings

_REFERENCE_PREFIX = "#/$defs/"
# Name of each distribution in YAML, by the name of its model class.
_DISTRIBUTION_NAMES = {model.__name__: name for name, model in DISTRIBUTIONS.items()}
_DISTRIBUTION_MODELS = tuple(_DISTRIBUTION_NAMES)


def file_schema() -> dict[str, Any]:
    """Return the JSON schema of a file of scenarios, for editors that check YAML.

    The schema requires less than `load_scenario`, since a scenario may inherit missing fields from a scenario that it
    extends.
    """
    scenario = Scenario.model_json_schema()
    definitions = scenario.pop("$defs")
    waypoint = definitions["Waypoint"]
    definitions["Waypoint"] = {"anyOf": [waypoint, {"type": "array", "minItems": 3, "maxItems": 3}]}
    times = definitions["WaypointRoute"]["properties"]["times"]
    times["oneOf"] += [{"type": "array"}, {"enum": list(times["discriminator"]["mapping"])}]
    # The following fields may contain a file name in place of the file's content.
    definitions["TrajectoryRoute"]["properties"]["pieces"]["anyOf"].append({"type": "string"})
    for name in ("Type1Network", "Type2Network"):
        definitions[name]["properties"]["learned"]["anyOf"].append({"type": "string"})
    points = definitions["HullObstacle"]["properties"]
    points["points"] = {
        "description": points["points"].pop("description"),
        "anyOf": [points["points"], {"type": "string"}],
    }
    # The layouts of `nominal` and `vehicle` have the same model class, but that of `nominal` must not contain
    # distributions.
    nominal = definitions["Nominal"]["properties"]
    nominal["layout"] = _without_distributions(nominal["layout"], definitions)
    names = {
        "type": "string",
        "description": "FILE, FILE:NAME, the name of a scenario in this file, or the name of a shipped scenario",
    }
    scenario["properties"]["extends"] = {
        "description": "scenarios that this scenario extends; later scenarios take precedence over earlier scenarios",
        "anyOf": [names, {"type": "array", "items": names}],
    }
    scenario["properties"][DEFAULT_VEHICLE] = {
        "description": "vehicle that is used if no scenario in the chain of extensions describes a vehicle",
        **names,
    }
    _allow_relative(definitions)
    _add_worlds(scenario, definitions)
    definitions["Scenario"] = scenario
    schema = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "scenarios of drake_quad, by their names",
        "type": "object",
        "additionalProperties": {"$ref": f"{_REFERENCE_PREFIX}Scenario"},
        "$defs": definitions,
    }
    return _relaxed(schema)


def _add_worlds(scenario: dict[str, Any], definitions: dict[str, Any]) -> None:
    """Add the fields of scenarios with several vehicles. A vehicle has the fields of a scenario, and an offset."""
    world = WorldSettings.model_json_schema()
    definitions |= {**world.pop("$defs"), "WorldSettings": world}
    offset = VehicleSettings.model_json_schema()["properties"]["offset"]
    vehicle = {**scenario, "properties": {**scenario["properties"], "offset": offset}}
    definitions["WorldVehicle"] = {"anyOf": [vehicle, {"type": "null"}]}
    scenario["properties"] |= {
        WORLD: {"description": "how the vehicles influence each other", "$ref": f"{_REFERENCE_PREFIX}WorldSettings"},
        VEHICLES: {
            "description": "vehicles of a world by their names",
            "type": "object",
            "additionalProperties": {"$ref": f"{_REFERENCE_PREFIX}WorldVehicle"},
        },
    }


def _allow_relative(definitions: dict[str, Any]) -> None:
    """Allow a relative distribution in each vehicle field that may be a distribution."""
    for name in ("Vehicle", *_referenced_mappings(definitions["Vehicle"], definitions)):
        for node in [*_nodes(definitions[name])]:
            if isinstance(node, list) and any(map(_is_distribution, node)):
                node.append({"$ref": f"{_REFERENCE_PREFIX}Relative"})
    forms = {name: definitions[model]["properties"][name] for model, name in _DISTRIBUTION_NAMES.items()}
    to = {
        "type": "number",
        "exclusiveMinimum": 0.0,
        "description": "value of the field to which the distribution applies",
    }
    definitions["Relative"] = {
        "type": "object",
        "description": "a distribution that is scaled in proportion to the value of the vehicle that flies",
        "properties": {RELATIVE: {"type": "object", "properties": {**forms, "to": to}, "additionalProperties": False}},
        "additionalProperties": False,
    }


def _nodes(node: Any) -> Iterator[Any]:
    """Yield a node of a schema and all nodes inside it."""
    yield node
    if isinstance(node, dict | list):
        for each in node.values() if isinstance(node, dict) else node:
            yield from _nodes(each)


def _without_distributions(node: Any, definitions: dict[str, Any]) -> Any:
    """Resolve the references in a node, and remove alternatives that are distributions."""
    if isinstance(node, list):
        return [_without_distributions(each, definitions) for each in node if not _is_distribution(each)]
    if not isinstance(node, dict):
        return node
    if "$ref" in node:
        return _without_distributions(definitions[node["$ref"].removeprefix(_REFERENCE_PREFIX)], definitions)
    return {key: _without_distributions(value, definitions) for key, value in node.items()}


def _is_distribution(node: Any) -> bool:
    return isinstance(node, dict) and node.get("$ref", "").removeprefix(_REFERENCE_PREFIX) in _DISTRIBUTION_MODELS


def _relaxed(node: Any) -> Any:
    """Return a node that also accepts incomplete mappings.

    No field is required, and `anyOf` replaces `oneOf`, since an incomplete mapping can match several alternatives.
    """
    if isinstance(node, list):
        return [_relaxed(each) for each in node]
    if not isinstance(node, dict):
        return node
    renamed = {"anyOf" if key == "oneOf" else key: value for key, value in node.items()}
    return {key: _relaxed(value) for key, value in renamed.items() if key not in ("required", "discriminator")}


def language_page() -> str:
    """Return a Markdown page of all fields. Each mapping has a section, in the order of first reference."""
    schema = Scenario.model_json_schema()
    definitions = schema["$defs"]
    sections = [_section("Scenario", schema)]
    sections += [_section(name, definitions[name]) for name in _referenced_mappings(schema, definitions)]
    introduction = files(__package__).joinpath("language_template.md").read_text(encoding="utf-8")
    return introduction.format_map(vars(limits)) + "\n\n".join(sections) + "\n"


def _referenced_mappings(schema: dict[str, Any], definitions: dict[str, Any]) -> list[str]:
    """Return the mappings to which a schema refers, in the order of first reference but with distributions last."""
    names: dict[str, None] = {}
    pending = _references(schema["properties"])
    while pending:
        name = pending.pop(0)
        if name not in names:
            names[name] = None
            pending = [*_references(definitions[name].get("properties", {})), *pending]
    return sorted(
        names, key=lambda name: name in _DISTRIBUTION_MODELS or name in ("Range", "PositiveRange", "NormalParameters")
    )


def _references(node: Any) -> list[str]:
    """Return the names of the mappings to which a node refers."""
    return [
        each["$ref"].removeprefix(_REFERENCE_PREFIX)
        for each in _nodes(node)
        if isinstance(each, dict) and "$ref" in each
    ]


def _section(name: str, model: dict[str, Any]) -> str:
    required = model.get("required", [])
    lines = [f"## {name}", "", model.get("description", "").partition("\n\n")[0].replace("\n", " "), ""]
    fields = model.get("properties", {})
    lines += (
        ["| field | type | default | meaning |", "| --- | --- | --- | --- |"]
        if fields
        else ["This mapping has no fields; write `{}`."]
    )
    for field, node in fields.items():
        default = "required" if field in required else _default(node.get("default"))
        lines.append(f"| `{field}` | {_type_text(node)} | {default} | {node.get('description', '')} |")
    return "\n".join(lines)


def _default(value: Any) -> str:
    if value is None or value == {}:
        return "–"
    if isinstance(value, dict):
        return f"`{value['kind']}`" if "kind" in value else "its defaults"
    return f"`{value}`"


def _type_text(node: dict[str, Any]) -> str:
    """Return a Markdown text that describes the values that a field accepts."""
    if "$ref" in node:
        name = node["$ref"].removeprefix(_REFERENCE_PREFIX)
        return f"[{name}](#{name.lower()})"
    forms = node.get("anyOf") or node.get("oneOf")
    if forms:
        names = [form["$ref"].removeprefix(_REFERENCE_PREFIX) for form in forms if "$ref" in form]
        if set(names) == set(_DISTRIBUTION_MODELS):
            return "number or [distribution](#uniform)"
        return " or ".join(_type_text(form) for form in forms if form.get("type") != "null")
    if "enum" in node:
        return " or ".join(f"`{value}`" for value in node["enum"])
    if "const" in node:
        return f"`{node['const']}`"
    if node.get("type") == "array":
        if "prefixItems" in node:
            items = [_type_text(item) for item in node["prefixItems"]]
            return f"{len(items)} × {items[0]}" if len(set(items)) == 1 else f"[{', '.join(items)}]"
        return f"list of {_type_text(node.get('items', {}))}"
    if isinstance(node.get("additionalProperties"), dict):
        return f"names, each with a {_type_text(node['additionalProperties'])}"
    return f"{node.get('type', 'anything')}{_bounds(node)}"


_COMPARISON_SIGNS = {"exclusiveMinimum": ">", "minimum": "≥", "exclusiveMaximum": "<", "maximum": "≤"}


def _bounds(node: dict[str, Any]) -> str:
    # The limit on the magnitude of all numbers is given only in the introduction of the page.
    bounds = [
        (sign, node[key])
        for key, sign in _COMPARISON_SIGNS.items()
        if key in node and abs(node[key]) < limits.MAX_MAGNITUDE
    ]
    texts = ["> 0" if bound == limits.MIN_MAGNITUDE else f"{sign} {bound:g}" for sign, bound in bounds]
    return f" {', '.join(texts)}" if texts else ""
