"""Loading of a scenario from YAML, with validation and an error message of one sentence."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from functools import reduce
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from pydantic import ValidationError

from drake_quad.errors import InputError, did_you_mean, join_names, short_repr, shorten_text
from drake_quad.scenario.attitude_controllers.controller import ATTITUDE_CONTROLLERS
from drake_quad.scenario.autopilots.autopilot import AUTOPILOTS
from drake_quad.scenario.controls.control import CONTROLS
from drake_quad.scenario.distributions import DISTRIBUTIONS, Model
from drake_quad.scenario.files.layers import expand_list_items, merge, with_default_vehicle, with_layer, with_override
from drake_quad.scenario.files.library import Library
from drake_quad.scenario.files.marked_tree import Mark, Tree
from drake_quad.scenario.files.named_files import with_named_files
from drake_quad.scenario.files.override_mapping import override_trees
from drake_quad.scenario.files.relative import raise_no_base_value, refuse_outside_vehicle, with_absolute_distributions
from drake_quad.scenario.files.saving import saved_options
from drake_quad.scenario.limits import MAX_LEVELS
from drake_quad.scenario.models import Mission, Nominal, Scenario, Vehicle
from drake_quad.scenario.paths import is_item, join_path, split_path
from drake_quad.scenario.unions import alternatives
from drake_quad.scenario.world import VEHICLES, WORLD

# Tags that pydantic adds to the paths of its errors for the alternatives of a quantity.
_TAGS = ("number", *DISTRIBUTIONS)
# Kinds of mappings without the field `kind`. Pydantic adds these kinds to the paths of its errors as well.
_DEFAULT_KINDS = (CONTROLS.default_kind, ATTITUDE_CONTROLLERS.default_kind)
# Largest number of characters that a message shows of an override or a path. The longest path has seventy characters.
_MAX_PATH_CHARACTERS = 80
# Types of validation errors about a missing field.
_MISSING_TYPES = ("missing", "distances")
_AnyModel = TypeVar("_AnyModel", bound=Model)


class Override(NamedTuple):
    """Assignment of a new value to a field.

    Attributes:
        assignment: text `field.path=value` with the value in YAML.
        source: name of the override in error messages, such as the argument of the command line.
    """

    assignment: str
    source: str

    @classmethod
    def of(cls, override: "str | Override") -> "Override":
        """Return an override for a given assignment. An `Override` is returned unchanged."""
        return override if isinstance(override, Override) else cls(override, f"override {override}")


# One override or a sequence of overrides.
Overrides = str | Override | Mapping[str, Any] | Sequence[str | Override | Mapping[str, Any]]


def load_scenario(spec: str | Path, overrides: Overrides = (), *, layers: Sequence[str | Path] = ()) -> Scenario:
    """Load a scenario.

    Args:
        spec: FILE, or FILE:NAME if the file contains several scenarios.
        overrides: new values of fields, which take precedence over the file. Either a mapping from paths to values,
            such as `{"vehicle.mass": 0.7, "route": {"kind": "circle"}, "control.position.k_p": np.ones(3)}`, whose
            mappings are merged with the mappings of the scenario as by `extends`; or an assignment `"vehicle.mass=0.7"`
            with the value in YAML; or a list of either, in which later items take precedence.
        layers: further scenarios, as FILE:NAME, that are layered over the scenario in the given order, as if a scenario
            extended all of them.

    Raises:
        InputError: if the file or an override is wrong; the message names the file, line, field, value and the allowed
            values.
    """
    return validate(Scenario, _load_tree(spec, overrides, layers))


def with_fields(scenario: Scenario, fields: Mapping[str, Any]) -> Scenario:
    """Return a scenario in which some top-level fields are replaced completely.

    Args:
        scenario: scenario to change.
        fields: new values of top-level fields by name, as mappings and numbers.

    Raises:
        InputError: under the conditions of `load_scenario`.
    """
    trees = [*override_trees({**scenario.model_dump(mode="json"), **fields}, Library())]
    return validate(Scenario, reduce(merge, trees))


def build_model(model: type[_AnyModel], overrides: Overrides) -> _AnyModel:
    """Return a model with default values, except for the fields that overrides give.

    Raises:
        InputError: if an override is invalid; see `load_scenario`.
    """
    return validate(model, reduce(merge, _trees_of(overrides, Library()), Tree({}, Mark("", 0))))


# Default route and control of a scenario for gain design. The gains in this text are placeholders that are never used.
_UNDESIGNED_DEFAULTS = """
route: {kind: figure_eight}
control:
  position: {kind: pd, k_p: [1.0, 1.0, 1.0], k_d: [1.0, 1.0, 1.0], feed_forward: snap}
  attitude: {k_p: [1.0, 1.0, 1.0], k_d: [1.0, 1.0, 1.0]}
"""


def load_undesigned(spec: str | Path, overrides: Overrides = (), *, layers: Sequence[str | Path] = ()) -> Scenario:
    """Load a scenario for gain design. The scenario may lack a route and a control.

    The default route is the paper's figure eight, and the default position controller is a PD with feed-forward. If the
    scenario has an autopilot, the default cascade leaves attitude control to it.

    Args:
        spec: FILE, or FILE:NAME if the file contains several scenarios.
        overrides: overrides for `load_scenario`.
        layers: layers for `load_scenario`.

    Raises:
        InputError: under the conditions of `load_scenario`.
    """
    tree = _load_tree(spec, overrides, layers, defaults_text=_UNDESIGNED_DEFAULTS)
    return validate(Scenario, _with_attitude_on_board(tree))


def _with_attitude_on_board(tree: Tree) -> Tree:
    """Return a scenario whose cascade leaves attitude control to the autopilot, if it has one."""
    autopilot = AUTOPILOTS.get(_text_at(tree, "laboratory", "autopilot", "kind"))
    is_on_ground = autopilot is None or autopilot.command == "wrench"
    if is_on_ground or _text_at(tree, "control", "kind") not in (None, CONTROLS.default_kind):
        return tree
    allowed = autopilot.feeds_forward
    mark = tree.value["control"].mark
    changes: dict[str, Tree] = {"attitude": Tree(None, mark)}
    if _text_at(tree, "control", "position", "feed_forward") not in (None, *allowed):
        changes["position"] = Tree({"feed_forward": Tree(allowed[-1], mark)}, mark)
    return merge(tree, Tree({"control": Tree(changes, mark)}, tree.mark))


def _text_at(tree: Tree, *path: str) -> Any:
    """Return the text at a path, or None if the path does not exist or its value is not text."""
    part, depth = tree.at(path)
    return part.value if depth == len(path) and isinstance(part.value, str) else None


def has_control(spec: str | Path) -> bool:
    """Return whether the files of a scenario contain a control. A vehicle file, for example, contains none.

    Raises:
        InputError: if the file or the scenario does not exist, or the file is not YAML.
    """
    return "control" in Library().find(spec)[1].value


def load_mission(spec: str | Path, overrides: Overrides = ()) -> Mission:
    """Load a mission from a scenario, ignoring its other fields, or from a table of waypoints.

    Args:
        spec: FILE, FILE:NAME if the file contains several scenarios, or a CSV file (see `waypoint_table`).
        overrides: overrides for `load_scenario`.

    Raises:
        InputError: as for `load_scenario`, or if an override names a field that a mission does not have.
    """
    others = Scenario.model_fields.keys() - Mission.model_fields.keys()
    tree = _load_tree(spec, overrides, fixed_fields=others)
    return validate(Mission, Tree({key: value for key, value in tree.value.items() if key not in others}, tree.mark))


def _load_tree(
    spec: str | Path,
    overrides: Overrides,
    layers: Sequence[str | Path] = (),
    *,
    defaults_text: str = "",
    fixed_fields: Set[str] = frozenset(),
) -> Tree:
    """Return the tree of a scenario after merging its layers and overrides.

    Args:
        spec: FILE, or FILE:NAME if the file contains several scenarios.
        overrides: overrides for `load_scenario`.
        layers: layers for `load_scenario`.
        defaults_text: YAML text with defaults for fields that the scenario does not have.
        fixed_fields: names of fields that overrides must not change.

    Raises:
        InputError: if the scenario cannot be read, or an override changes one of `fixed_fields`.
    """
    library = Library()
    name, tree = library.find(spec)
    if defaults_text:
        tree = merge(library.parse(defaults_text, "defaults", with_line_numbers=False), tree)._replace(mark=tree.mark)
    for layer in layers:
        tree = with_layer(tree, library.find(layer)[1])
    if VEHICLES in tree.value:
        raise InputError(
            f"{tree.mark}: has several vehicles; only `drake-quad fly` and `load_world` accept such a scenario"
        )
    return complete_tree(name, tree, library, overrides, fixed_fields=fixed_fields)


def complete_tree(
    name: str, tree: Tree, library: Library, overrides: Overrides = (), *, fixed_fields: Set[str] = frozenset()
) -> Tree:
    """Return the tree of a scenario with its name, the default vehicle, overrides, and the files that it names.

    Args:
        name: name of the scenario, unless the tree contains one.
        tree: merged layers of the scenario.
        library: library that reads files.
        overrides: overrides for `load_scenario`.
        fixed_fields: names of fields that overrides must not change.

    Raises:
        InputError: under the conditions of `load_scenario`.
    """
    tree = with_default_vehicle(tree)
    for override in _trees_of(overrides, library):
        if world_fields := override.value.keys() & {VEHICLES, WORLD}:
            raise InputError(
                f"{override.mark}: {join_names(sorted(world_fields))} cannot be overridden; change the file"
            )
        for field in override.value.keys() & fixed_fields:
            allowed = ", ".join(Mission.model_fields)
            raise InputError(f"{override.mark}: a plan does not depend on {field}, only on {allowed}")
        # The merged tree keeps the mark of the file, to which messages about missing fields refer.
        tree = with_override(tree, expand_list_items(tree, override))._replace(mark=tree.mark)
    if "name" not in tree.value:
        tree = Tree({"name": Tree(name, tree.mark), **tree.value}, tree.mark)
    return _without_relatives(with_named_files(tree, library))


def _without_relatives(tree: Tree) -> Tree:
    """Replace the relative distributions of a scenario by ordinary distributions.

    If `nominal` is invalid, the scenario is returned unchanged, so that validation reports the error.
    """
    refuse_outside_vehicle(tree)
    nominal = tree.value.get("nominal")
    try:
        nominal_vehicle = Nominal() if nominal is None else Nominal.model_validate(nominal.to_python())
    except ValidationError:
        return tree
    absolute, dropped = with_absolute_distributions(tree, nominal_vehicle, Vehicle())
    if dropped:
        _check_required_fields(dropped, absolute)
    return absolute


def _check_required_fields(dropped: Mapping[str, Tree], tree: Tree) -> None:
    """Raise InputError if a required field of the vehicle is missing because its relative distribution was dropped."""
    data = tree.value["vehicle"].to_python()
    try:
        Vehicle.model_validate(data)
    except ValidationError as error:
        problems = error.errors(include_url=False)
    else:
        return
    for problem in problems:
        missing = ".".join(map(str, ("vehicle", *_document_path(problem, data))))
        for path, distribution in dropped.items():
            if problem["type"] in _MISSING_TYPES and f"{path}.".startswith(f"{missing}."):
                raise_no_base_value(distribution, path)


def validate(model: type[_AnyModel], tree: Tree) -> _AnyModel:
    """Validate a document and return it as a model.

    Raises:
        InputError: if the document is invalid. The message names file, line, field, value and allowed values.
    """
    data = tree.to_python()
    try:
        return model.model_validate(data)
    except ValidationError as error:
        problems = error.errors(include_url=False)
    paths = [_document_path(problem, data) for problem in problems if _is_partial_list(problem)]
    # If overrides give only some items of a list, by index, the defaults of the model supply the other items.
    rest = reduce(_without_field, paths, tree)
    try:
        defaults = model.model_validate(rest.to_python()).model_dump(mode="json") if paths else {}
    except ValidationError as error:
        others = error.errors(include_url=False)
        lists_are_missing = any(_document_path(problem, rest.to_python()) in paths for problem in others)
        if not lists_are_missing:
            raise InputError(_explain(others, model, rest, rest.to_python())) from None
        defaults = {}
    base = Tree.of(defaults, tree.mark)
    if not paths or not all(isinstance(base.at(path)[0].value, list) for path in paths):
        raise InputError(_explain(problems, model, tree, data))
    return validate(model, expand_list_items(base, tree))


def _without_field(tree: Tree, path: tuple[Any, ...]) -> Tree:
    """Return the tree without the field at a path."""
    key, *inside = path
    parts = tree.value.copy()
    if inside:
        parts[key] = _without_field(parts[key], tuple(inside))
    else:
        del parts[key]
    return Tree(parts, tree.mark)


def _is_partial_list(problem: Any) -> bool:
    """Return whether a problem arises because only single list items are given, as in `vehicle.inertia.0`."""
    value = problem["input"]
    return problem["type"] == "tuple_type" and isinstance(value, dict) and all(map(is_item, value))


def _trees_of(overrides: Overrides, library: Library) -> Iterator[Tree]:
    """Yield a separate document for each overridden field."""
    if isinstance(overrides, str | Override | Mapping) or not isinstance(overrides, Iterable):
        overrides = [overrides]
    for override in overrides:
        if isinstance(override, Mapping):
            yield from override_trees(override, library)
        elif isinstance(override, str | Override):
            yield _parsed(Override.of(override), library)
        else:
            raise InputError(f"the override {short_repr(override)} must be a mapping or a text field.path=value")


def _parsed(override: Override, library: Library) -> Tree:
    source = shorten_text(override.source, _MAX_PATH_CHARACTERS)
    mark = Mark(source, 0)
    path, equals, text = override.assignment.partition("=")
    if not equals or not all(path.strip().split(".")) or not text.strip():
        raise InputError(f"{mark}: must be field.path=value, for example vehicle.mass=0.7")
    try:
        keys = split_path(path.strip())
    except InputError as error:
        raise InputError(f"{mark}: {error}") from None
    if len(keys) > MAX_LEVELS:
        raise InputError(f"{mark}: is nested too deeply: a scenario may have at most {MAX_LEVELS} levels")
    tree = library.parse(text, source, with_line_numbers=False)
    for key in reversed(keys):
        tree = Tree({key: tree}, mark)
    return tree


def _explain(problems: Sequence[Any], model: type[Model], tree: Tree, data: Any) -> str:
    """Return an error message about the first validation problem, with the number of further problems."""
    problem = problems[0]
    context = problem.get("ctx", {})
    missing = {_document_path(each, data) for each in problems if each["type"] in _MISSING_TYPES}
    if missing >= {("route",), ("control",)}:
        return (
            f"{tree.mark}: has neither a route nor a control, so it describes only a vehicle; `drake-quad design`"
            " designs gains for it and writes a scenario that flies, or write a scenario with both that extends it"
        )
    path = _document_path(problem, data)
    path = (*path, *context.get("path", ()))
    if problem["type"] in ("union_tag_invalid", "union_tag_not_found"):
        path = (*path, "kind")
    others = [_document_path(other, data) for other in problems[1:]]
    together = all(other["type"] == "missing" for other in problems) and {other[:-1] for other in others} == {path[:-1]}
    more = f" (and {len(others)} more)" if others else ""
    if together:
        more = f", and so {'is' if len(others) == 1 else 'are'} {', '.join(str(other[-1]) for other in others)}"
    node, depth = tree.at(path)
    if hint := _registration_hint(problem, node, path):
        return f"{node.mark}: {_path_text(path)} {hint}"
    if depth == len(path):
        complaint = _complaint(problem, short_repr(node.to_python()), path, model)
    else:  # the value is a default, so no file contains it
        default = context.get("value", context.get("tag", problem["input"]))
        complaint = _complaint(problem, f"{short_repr(default)} by default", path, model)
    return f"{node.mark}: {_path_text(path)} {complaint}{more}"


def _registration_hint(problem: Any, node: Tree, path: tuple[Any, ...]) -> str:
    """Return a clause with the command that registers an unknown kind or effect; empty for other problems.

    If `save_scenario` wrote the file, its first line contains the options. Otherwise, the options are derived from a
    kind of the form MODULE.CLASS, as `register_controller` assigns it. An unknown name that is similar to a registered
    name is treated as a misspelling, for which no command is suggested.
    """
    context = problem.get("ctx", {})
    match problem["type"]:
        case "union_tag_invalid":
            unknown, known = str(node.value), re.findall(r"'([^']*)'", context["expected_tags"])
        case "unknown_field" if path[0] == "vehicle":
            unknown, known = str(path[-1]), context["fields"]
        case _:
            return ""
    if did_you_mean(unknown, known, 1):
        return ""
    source, options = node.mark.source, saved_options(node.mark.source)
    module, _, name = node.value.rpartition(".") if isinstance(node.value, str) else ("", "", "")
    if not options and module.isidentifier() and name.isidentifier():
        options = f"--controller {module}.py:{name}"
    if not options:
        return ""
    clause = f"is {short_repr(node.value)}, which" if path[-1] == "kind" else "is a field that"
    return f"{clause} a Python file registers; name the file in the command, as in drake-quad fly {source} {options}"


def _complaint(problem: Any, value: str, path: tuple[Any, ...], model: type[Model]) -> str:
    """Describe a validation problem with the value at a path, including the allowed values."""
    context = problem.get("ctx", {})
    match problem["type"]:
        case "unknown_field":
            nested = _nested_paths(model, str(path[0])) if len(path) == 1 else []
            question = did_you_mean(path[-1], context["fields"], 1)
            if nested and not question:
                question = f"did you mean {' or '.join(nested)}?"
            return f"{problem['msg']}; {question}" if question else problem["msg"]
        case "kind_missing":
            return str(problem["msg"])
        case "missing" | "union_tag_not_found":
            hint = "; only `drake-quad plan` needs no control" if path == ("control",) else ""
            return f"is missing{hint}"
        case "union_tag_invalid":
            is_metric = path[:2] == ("metrics", "additional")
            hint = "; `--import FILE.py` registers a metric in Python" if is_metric else ""
            return f"is {value}, but must be one of {context['expected_tags']}{hint}{_nearest(problem)}"
        case "model_type" | "model_attributes_type":
            return f"is {value}, but must be a mapping of fields"
        case "path":
            return f"cannot be flown: {problem['msg']}"
        case "dict_type":
            return f"is {value}, but must be a mapping from names to numbers"
        case "tuple_type":
            hint = (
                "; single items can only be given if the other items have defaults" if _is_partial_list(problem) else ""
            )
            return f"is {value}, but must be a list{hint}"
    demand = re.sub(r"^(Input|String|Tuple) should", "must", problem["msg"]).replace(" after validation", "")
    return f"is {value}, but {demand}{_nearest(problem)}"


def _nearest(problem: Any) -> str:
    """Return a "did you mean" question with the most similar allowed text, for a misspelt kind or choice."""
    context = problem.get("ctx", {})
    allowed = re.findall(r"'([^']*)'", str(context.get("expected_tags") or context.get("expected") or ""))
    value = context.get("tag", problem["input"])
    question = did_you_mean(value, allowed, 1) if isinstance(value, str) else ""
    return f"; {question}" if question else ""


def _nested_paths(model: type[Model], name: str) -> list[str]:
    """Return the paths of the fields with a given name in the mappings of a model."""
    return [
        f"{field}.{name}"
        for field, info in model.model_fields.items()
        if any(name in getattr(mapping, "model_fields", ()) for mapping in alternatives(info.annotation, info.metadata))
    ]


def _document_path(problem: Any, data: Any) -> tuple[Any, ...]:
    """Return the path of a validation problem in the document, without the union tags that pydantic adds.

    The path of a missing field or item ends with that field or item.
    """
    path: list[Any] = []
    tagged: Any = None
    location, is_missing = problem["loc"], problem["type"] == "missing"
    for i, key in enumerate(location):
        is_last = i == len(location) - 1
        kinds = (data["kind"],) if isinstance(data, dict) and "kind" in data else _DEFAULT_KINDS
        # "normal" is the tag of a normal distribution, but also a field of a half-space. It is a tag if the input that
        # pydantic reports is the whole mapping.
        is_tag = key in _TAGS and not is_missing and problem["input"] is data
        if isinstance(data, dict) and key in kinds and data is not tagged:
            tagged = data
        elif is_last and is_tag:
            break
        elif (isinstance(data, dict) and key in data) or (isinstance(data, list) and key in range(len(data))):
            path.append(key)
            data = data[key]
        elif is_last and (is_missing or key not in _TAGS) and isinstance(data, list if isinstance(key, int) else dict):
            path.append(key)
    return tuple(path)


def _path_text(path: tuple[Any, ...]) -> str:
    """Return a path as text, such as `vehicle.inertia.0`."""
    steps = [key if isinstance(key, int) or str(key).isidentifier() else short_repr(key) for key in path]
    return shorten_text(join_path(*steps), _MAX_PATH_CHARACTERS) or "the scenario"
