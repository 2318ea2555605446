"""The scenario language, as its models have it: a schema for editors, and a page for readers."""

from collections.abc import Iterator
from importlib.resources import files
from typing import Any

from drake_quad.scenario import limits
from drake_quad.scenario.distributions import DISTRIBUTIONS
from drake_quad.scenario.files.layers import DEFAULT_VEHICLE
from drake_quad.scenario.files.relative import RELATIVE
from drake_quad.scenario.models import Scenario

_REFERENCE = "#/$defs/"
_FORMS = {model.__name__: name for name, model in DISTRIBUTIONS.items()}
_DISTRIBUTIONS = tuple(_FORMS)


def file_schema() -> dict[str, Any]:
    """Return the JSON schema of a file of scenarios, for editors that check YAML.

    The schema checks less than `load_scenario`, since a scenario may inherit missing fields from one that it extends.
    """
    scenario = Scenario.model_json_schema()
    definitions = scenario.pop("$defs")
    waypoint = definitions["Waypoint"]
    definitions["Waypoint"] = {"anyOf": [waypoint, {"type": "array", "minItems": 3, "maxItems": 3}]}
    times = definitions["WaypointRoute"]["properties"]["times"]
    times["oneOf"] += [{"type": "array"}, {"enum": list(times["discriminator"]["mapping"])}]
    # In these fields the name of a file may stand for what is in it.
    definitions["TrajectoryRoute"]["properties"]["pieces"]["anyOf"].append({"type": "string"})
    for name in ("Type1Network", "Type2Network"):
        definitions[name]["properties"]["learned"]["anyOf"].append({"type": "string"})
    points = definitions["HullObstacle"]["properties"]
    points["points"] = {
        "description": points["points"].pop("description"),
        "anyOf": [points["points"], {"type": "string"}],
    }
    # Vehicles and beliefs have the same layouts, but of what is believed there are no distributions.
    believed = definitions["Nominal"]["properties"]
    believed["layout"] = _of_numbers(believed["layout"], definitions)
    names = {
        "type": "string",
        "description": "FILE, FILE:NAME, NAME of this file, or a shipped one",
    }
    scenario["properties"]["extends"] = {
        "description": "what this scenario is laid over, the last on top",
        "anyOf": [names, {"type": "array", "items": names}],
    }
    scenario["properties"][DEFAULT_VEHICLE] = {
        "description": "the vehicle that flies where no scenario that this is laid over or under describes one",
        **names,
    }
    _allow_relative(definitions)
    definitions["Scenario"] = scenario
    schema = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "scenarios of drake_quad, by their names",
        "type": "object",
        "additionalProperties": {"$ref": f"{_REFERENCE}Scenario"},
        "$defs": definitions,
    }
    return _loosened(schema)


def _allow_relative(definitions: dict[str, Any]) -> None:
    """Allow a relative distribution wherever a vehicle may have a distribution."""
    for name in ("Vehicle", *_order(definitions["Vehicle"], definitions)):
        for forms in [*_nodes(definitions[name])]:
            if isinstance(forms, list) and any(map(_is_distribution, forms)):
                forms.append({"$ref": f"{_REFERENCE}Relative"})
    one = {name: definitions[model]["properties"][name] for model, name in _FORMS.items()}
    to = {"type": "number", "exclusiveMinimum": 0.0, "description": "value of the field to which the numbers belong"}
    definitions["Relative"] = {
        "type": "object",
        "description": "a distribution in proportion to the value of the vehicle that flies",
        "properties": {RELATIVE: {"type": "object", "properties": {**one, "to": to}, "additionalProperties": False}},
        "additionalProperties": False,
    }


def _nodes(node: Any) -> Iterator[Any]:
    """Yield a node of a schema and all nodes inside it."""
    yield node
    if isinstance(node, dict | list):
        for each in node.values() if isinstance(node, dict) else node:
            yield from _nodes(each)


def _of_numbers(node: Any, definitions: dict[str, Any]) -> Any:
    """Return a node with its references resolved and without the alternatives that are distributions."""
    if isinstance(node, list):
        return [_of_numbers(each, definitions) for each in node if not _is_distribution(each)]
    if not isinstance(node, dict):
        return node
    if "$ref" in node:
        return _of_numbers(definitions[node["$ref"].removeprefix(_REFERENCE)], definitions)
    return {key: _of_numbers(value, definitions) for key, value in node.items()}


def _is_distribution(node: Any) -> bool:
    return isinstance(node, dict) and node.get("$ref", "").removeprefix(_REFERENCE) in _DISTRIBUTIONS


def _loosened(node: Any) -> Any:
    """Without what is required, and with any of some forms in place of exactly one: parts fit several."""
    if isinstance(node, list):
        return [_loosened(each) for each in node]
    if not isinstance(node, dict):
        return node
    renamed = {"anyOf" if key == "oneOf" else key: value for key, value in node.items()}
    return {key: _loosened(value) for key, value in renamed.items() if key not in ("required", "discriminator")}


def language_page() -> str:
    """The page of all fields, in Markdown: a section for each mapping, in the order in which a scenario needs it."""
    schema = Scenario.model_json_schema()
    definitions = schema["$defs"]
    sections = [_section("Scenario", schema)]
    sections += [_section(name, definitions[name]) for name in _order(schema, definitions)]
    introduction = files(__package__).joinpath("language_template.md").read_text(encoding="utf-8")
    return introduction.format_map(vars(limits)) + "\n\n".join(sections) + "\n"


def _order(schema: dict[str, Any], definitions: dict[str, Any]) -> list[str]:
    """Return the names of the mappings that a schema refers to, as one comes upon them."""
    found: dict[str, None] = {}
    pending = _references(schema["properties"])
    while pending:
        name = pending.pop(0)
        if name not in found:
            found[name] = None
            pending = [*_references(definitions[name].get("properties", {})), *pending]
    return sorted(found, key=lambda name: name in _DISTRIBUTIONS or name in ("Range", "PositiveRange", "Bell"))


def _references(node: Any) -> list[str]:
    """Return the names of the mappings to which a node refers."""
    return [each["$ref"].removeprefix(_REFERENCE) for each in _nodes(node) if isinstance(each, dict) and "$ref" in each]


def _section(name: str, model: dict[str, Any]) -> str:
    required = model.get("required", [])
    lines = [f"## {name}", "", model.get("description", "").partition("\n\n")[0].replace("\n", " "), ""]
    lines += ["| field | takes | default | meaning |", "| --- | --- | --- | --- |"]
    for field, node in model.get("properties", {}).items():
        default = "needed" if field in required else _default(node.get("default"))
        lines.append(f"| `{field}` | {_takes(node)} | {default} | {node.get('description', '')} |")
    return "\n".join(lines)


def _default(value: Any) -> str:
    if value is None or value == {}:
        return "–"
    if isinstance(value, dict):
        return f"`{value['kind']}`" if "kind" in value else "its defaults"
    return f"`{value}`"


def _takes(node: dict[str, Any]) -> str:
    """Return the values that a field takes, in words."""
    if "$ref" in node:
        name = node["$ref"].removeprefix(_REFERENCE)
        return f"[{name}](#{name.lower()})"
    forms = node.get("anyOf") or node.get("oneOf")
    if forms:
        names = [form["$ref"].removeprefix(_REFERENCE) for form in forms if "$ref" in form]
        if set(names) == set(_DISTRIBUTIONS):
            return "number or [distribution](#uniform)"
        return " or ".join(_takes(form) for form in forms if form.get("type") != "null")
    if "enum" in node:
        return " or ".join(f"`{value}`" for value in node["enum"])
    if "const" in node:
        return f"`{node['const']}`"
    if node.get("type") == "array":
        if "prefixItems" in node:
            items = [_takes(item) for item in node["prefixItems"]]
            return f"{len(items)} × {items[0]}" if len(set(items)) == 1 else f"[{', '.join(items)}]"
        return f"list of {_takes(node.get('items', {}))}"
    if isinstance(node.get("additionalProperties"), dict):
        return f"names, each with a {_takes(node['additionalProperties'])}"
    return f"{node.get('type', 'anything')}{_bounds(node)}"


_COMPARED = {"exclusiveMinimum": ">", "minimum": "≥", "exclusiveMaximum": "<", "maximum": "≤"}


def _bounds(node: dict[str, Any]) -> str:
    # Limits that only keep numbers finite are those of the introduction.
    bounds = [(sign, node[key]) for key, sign in _COMPARED.items() if key in node and abs(node[key]) < limits.LARGEST]
    said = ["> 0" if bound == limits.SMALLEST else f"{sign} {bound:g}" for sign, bound in bounds]
    return f" {', '.join(said)}" if said else ""
