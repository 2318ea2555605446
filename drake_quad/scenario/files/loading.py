"""From a YAML file to a validated scenario, or to one sentence that says what is wrong and where."""

import difflib
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from functools import reduce
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from pydantic import ValidationError

from drake_quad.errors import InputError, shortened, shown
from drake_quad.scenario.attitude_controllers.controller import ATTITUDE_CONTROLLERS
from drake_quad.scenario.autopilots.autopilot import AUTOPILOTS
from drake_quad.scenario.controls.control import CONTROLS
from drake_quad.scenario.distributions import DISTRIBUTIONS, Model
from drake_quad.scenario.files.given_values import given_trees
from drake_quad.scenario.files.layers import changed, laid_over, merged, with_default_vehicle, within_lists
from drake_quad.scenario.files.library import Library
from drake_quad.scenario.files.marked_tree import Mark, Tree
from drake_quad.scenario.files.named_files import with_named_files
from drake_quad.scenario.files.relative import refuse_dropped, refuse_elsewhere, with_absolute_distributions
from drake_quad.scenario.limits import MOST_LEVELS
from drake_quad.scenario.models import Mission, Nominal, Scenario, Vehicle
from drake_quad.scenario.paths import is_item, joined, steps_of
from drake_quad.scenario.unions import alternatives

# Names of forms that stand in no file.
_TAGS = ("number", *DISTRIBUTIONS)
# Kinds of mappings that do not state their kind.
_SILENT_KINDS = (CONTROLS.silent, ATTITUDE_CONTROLLERS.silent)
# Characters of an override, or of the path of a field, that a message shows; the longest path has seventy.
_MOST_OF_A_PATH = 80
# Types of validation errors in models that lack a field.
_MISSING = ("missing", "distances")
_Valid = TypeVar("_Valid", bound=Model)


class Override(NamedTuple):
    """A field that is given another value.

    Attributes:
        assignment: `field.path=value`, the value in YAML.
        source: what errors call it, such as the argument of a command line that it comes from.
    """

    assignment: str
    source: str

    @classmethod
    def of(cls, override: "str | Override") -> "Override":
        """Return the override that an assignment alone stands for."""
        return override if isinstance(override, Override) else cls(override, f"override {override}")


# `Override` is a tuple itself; the last stands for a sequence of any of the others.
Overrides = str | Override | Mapping[str, Any] | Sequence[str | Override | Mapping[str, Any]]


def load_scenario(spec: str | Path, overrides: Overrides = (), *, layers: Sequence[str | Path] = ()) -> Scenario:
    """Load a scenario.

    Args:
        spec: FILE, or FILE:NAME if the file contains several scenarios.
        overrides: fields that are given other values; they win. A mapping of their paths to these, as in
            `{"vehicle.mass": 0.7, "route": {"kind": "circle"}, "control.position.k_p": np.ones(3)}`, where mappings are
            joined with what is there, as by `extends`; or an assignment `"vehicle.mass=0.7"` with the value in YAML; or
            several of either in a list, of which the last wins.
        layers: further FILE:NAMEs that are laid over the scenario one after the other, as if one extended them all.

    Raises:
        InputError: if the file or an override is wrong; the message names the file, line, field, value and the allowed
            values.
    """
    return validated(Scenario, _loaded(spec, overrides, layers))


def with_fields(scenario: Scenario, fields: Mapping[str, Any]) -> Scenario:
    """Return a scenario in which fields of its first level are replaced as a whole.

    Args:
        scenario: scenario to change.
        fields: new values of fields by name, as mappings and numbers.

    Raises:
        InputError: an error of `load_scenario`.
    """
    trees = [*given_trees({**scenario.model_dump(mode="json"), **fields}, Library())]
    return validated(Scenario, reduce(merged, trees))


def model_of(model: type[_Valid], overrides: Overrides) -> _Valid:
    """Return a model whose fields are those that overrides give, and otherwise have their defaults.

    Raises:
        InputError: an override is wrong, see `load_scenario`.
    """
    return validated(model, reduce(merged, _trees_of(overrides, Library()), Tree({}, Mark("", 0))))


# What a scenario has whose gains are still to be designed, unless it says otherwise: the gains do not matter.
_UNDESIGNED = """
route: {kind: figure_eight}
control:
  position: {kind: pd, k_p: [1.0, 1.0, 1.0], k_d: [1.0, 1.0, 1.0], feed_forward: snap}
  attitude: {k_p: [1.0, 1.0, 1.0], k_d: [1.0, 1.0, 1.0]}
"""


def load_undesigned(spec: str | Path, overrides: Overrides = (), *, layers: Sequence[str | Path] = ()) -> Scenario:
    """Load a scenario for the design of its gains, such as a vehicle without route and control.

    The default route is the paper's figure eight, and the default position controller is a PD with feed-forward. If the
    scenario has an autopilot, its cascade leaves attitude control to the autopilot.

    Args:
        spec: FILE, or FILE:NAME if the file contains several scenarios.
        overrides: overrides for `load_scenario`.
        layers: layers for `load_scenario`.

    Raises:
        InputError: an error of `load_scenario`.
    """
    return validated(Scenario, _on_board(_loaded(spec, overrides, layers, beneath=_UNDESIGNED)))


def _on_board(tree: Tree) -> Tree:
    """Return a scenario whose cascade leaves attitude control to the autopilot, if it has one."""
    autopilot = AUTOPILOTS.get(_word(tree, "laboratory", "autopilot", "kind"))
    is_on_ground = autopilot is None or autopilot.command == "wrench"
    if is_on_ground or _word(tree, "control", "kind") not in (None, CONTROLS.silent):
        return tree
    allowed = autopilot.feeds_forward
    mark = tree.value["control"].mark
    changes: dict[str, Tree] = {"attitude": Tree(None, mark)}
    if _word(tree, "control", "position", "feed_forward") not in (None, *allowed):
        changes["position"] = Tree({"feed_forward": Tree(allowed[-1], mark)}, mark)
    return merged(tree, Tree({"control": Tree(changes, mark)}, tree.mark))


def _word(tree: Tree, *path: str) -> Any:
    """Return the scalar at a path; None if there is none."""
    part, depth = tree.at(path)
    return part.value if depth == len(path) and isinstance(part.value, str) else None


def has_control(spec: str | Path) -> bool:
    """Return whether the files of a scenario give it a control; a vehicle alone has none.

    Raises:
        InputError: there is no such file or scenario, or it is not YAML.
    """
    return "control" in Library().find(spec)[1].value


def load_mission(spec: str | Path, overrides: Overrides = ()) -> Mission:
    """Load a mission from a scenario, which may be incomplete otherwise, or from a table of waypoints.

    Args:
        spec: FILE, or FILE:NAME if the file contains several scenarios; or a CSV file, see `waypoint_table`.
        overrides: overrides for `load_scenario`.

    Raises:
        InputError: an error of `load_scenario`, or an override of a field that no mission has.
    """
    others = Scenario.model_fields.keys() - Mission.model_fields.keys()
    tree = _loaded(spec, overrides, foreign=others)
    return validated(Mission, Tree({key: value for key, value in tree.value.items() if key not in others}, tree.mark))


def _loaded(
    spec: str | Path,
    overrides: Overrides,
    layers: Sequence[str | Path] = (),
    *,
    beneath: str = "",
    foreign: Set[str] = frozenset(),
) -> Tree:
    """Return a scenario as a tree with its overrides.

    Raises:
        InputError: if the scenario cannot be read, or an override names an unknown field.
    """
    library = Library()
    name, tree = library.find(spec)
    if beneath:
        tree = merged(library.parse(beneath, "what is not written", numbered=False), tree)._replace(mark=tree.mark)
    for layer in layers:
        tree = laid_over(tree, library.find(layer)[1])
    tree = with_default_vehicle(tree)
    for override in _trees_of(overrides, library):
        for field in override.value.keys() & foreign:
            allowed = ", ".join(Mission.model_fields)
            raise InputError(f"{override.mark}: a plan does not depend on {field}, only on {allowed}")
        # What is missing is missing in the file.
        tree = changed(tree, within_lists(tree, override))._replace(mark=tree.mark)
    if "name" not in tree.value:
        tree = Tree({"name": Tree(name, tree.mark), **tree.value}, tree.mark)
    return _without_relatives(with_named_files(tree, library))


def _without_relatives(tree: Tree) -> Tree:
    """Return a scenario with ordinary instead of relative distributions.

    If `nominal` is wrong, the scenario is returned unchanged, since validation then reports the error.
    """
    refuse_elsewhere(tree)
    nominal = tree.value.get("nominal")
    try:
        believed = Nominal() if nominal is None else Nominal.model_validate(nominal.plain())
    except ValidationError:
        return tree
    absolute, dropped = with_absolute_distributions(tree, believed, Vehicle())
    if dropped:
        _refuse_needed(dropped, absolute)
    return absolute


def _refuse_needed(dropped: Mapping[str, Tree], tree: Tree) -> None:
    """Raise InputError if a vehicle cannot do without one of the relative distributions that were removed from it."""
    data = tree.value["vehicle"].plain()
    try:
        Vehicle.model_validate(data)
    except ValidationError as error:
        problems = error.errors(include_url=False)
    else:
        return
    for problem in problems:
        missing = ".".join(map(str, ("vehicle", *_real_path(problem, data))))
        for path, distribution in dropped.items():
            if problem["type"] in _MISSING and f"{path}.".startswith(f"{missing}."):
                refuse_dropped(distribution, path)


def validated(model: type[_Valid], tree: Tree) -> _Valid:
    """Validate a document and return it as a model.

    Raises:
        InputError: if the document is wrong; the message names the file, line, field, value and the allowed values.
    """
    data = tree.plain()
    try:
        return model.model_validate(data)
    except ValidationError as error:
        problems = error.errors(include_url=False)
    paths = [_real_path(problem, data) for problem in problems if _gives_items(problem)]
    rest = reduce(_without, paths, tree)
    try:
        defaults = model.model_validate(rest.plain()).model_dump(mode="json") if paths else {}
    except ValidationError as error:
        others = error.errors(include_url=False)
        lists_are_missing = any(_real_path(problem, rest.plain()) in paths for problem in others)
        if not lists_are_missing:
            raise InputError(_explain(others, model, rest, rest.plain())) from None
        defaults = {}
    beneath = Tree.of(defaults, tree.mark)
    if not paths or not all(isinstance(beneath.at(path)[0].value, list) for path in paths):
        raise InputError(_explain(problems, model, tree, data))
    return validated(model, within_lists(beneath, tree))


def _without(tree: Tree, path: tuple[Any, ...]) -> Tree:
    """Return the tree without the field at a path."""
    key, *inside = path
    parts = tree.value.copy()
    if inside:
        parts[key] = _without(parts[key], tuple(inside))
    else:
        del parts[key]
    return Tree(parts, tree.mark)


def _gives_items(problem: Any) -> bool:
    """Return whether a problem is a missing list of which items are given by index, as in `vehicle.inertia.0`."""
    given = problem["input"]
    return problem["type"] == "tuple_type" and isinstance(given, dict) and all(map(is_item, given))


def _trees_of(overrides: Overrides, library: Library) -> Iterator[Tree]:
    """Yield a document for each field that is overridden."""
    if isinstance(overrides, str | Override | Mapping) or not isinstance(overrides, Iterable):
        overrides = [overrides]
    for override in overrides:
        if isinstance(override, Mapping):
            yield from given_trees(override, library)
        elif isinstance(override, str | Override):
            yield _parsed(Override.of(override), library)
        else:
            raise InputError(f"the override {shown(override)} must be a mapping, or field.path=value")


def _parsed(override: Override, library: Library) -> Tree:
    source = shortened(override.source, _MOST_OF_A_PATH)
    mark = Mark(source, 0)
    path, equals, text = override.assignment.partition("=")
    if not equals or not all(path.strip().split(".")) or not text.strip():
        raise InputError(f"{mark}: must be field.path=value, for example vehicle.mass=0.7")
    try:
        keys = steps_of(path.strip())
    except InputError as error:
        raise InputError(f"{mark}: {error}") from None
    if len(keys) > MOST_LEVELS:
        raise InputError(f"{mark}: is nested too deep: a scenario may have {MOST_LEVELS} levels")
    tree = library.parse(text, source, numbered=False)
    for key in reversed(keys):
        tree = Tree({key: tree}, mark)
    return tree


def _explain(problems: Sequence[Any], model: type[Model], tree: Tree, data: Any) -> str:
    """Return a sentence on the first of several problems."""
    problem = problems[0]
    context = problem.get("ctx", {})
    path = _real_path(problem, data)
    path = (*path, *context.get("path", ()))
    if problem["type"] in ("union_tag_invalid", "union_tag_not_found"):
        path = (*path, "kind")
    others = [_real_path(other, data) for other in problems[1:]]
    together = all(other["type"] == "missing" for other in problems) and {other[:-1] for other in others} == {path[:-1]}
    more = f" (and {len(others)} more)" if others else ""
    if together:
        more = f", and so {'is' if len(others) == 1 else 'are'} {', '.join(str(other[-1]) for other in others)}"
    place, depth = tree.at(path)
    if depth == len(path):
        complaint = _complaint(problem, shown(place.plain()), path, model)
    else:  # of a default, which stands nowhere
        complaint = _complaint(problem, f"{shown(context.get('value', problem['input']))} by default", path, model)
    return f"{place.mark}: {_written(path)} {complaint}{more}"


def _complaint(problem: Any, value: str, path: tuple[Any, ...], model: type[Model]) -> str:
    """Return a description of the problem with the value at a path, and of the allowed values."""
    context = problem.get("ctx", {})
    match problem["type"]:
        case "unknown_field":
            close = difflib.get_close_matches(str(path[-1]), context["fields"], 1)
            deeper = _further_in(model, str(path[0])) if len(path) == 1 else []
            meant = " or ".join(close or deeper)
            return f"{problem['msg']}; did you mean {meant}?" if meant else problem["msg"]
        case "missing" | "union_tag_not_found":
            return "is missing; `drake-quad plan` plans a route alone" if path == ("control",) else "is missing"
        case "union_tag_invalid":
            return f"is {value}, but must be one of {context['expected_tags']}"
        case "model_type" | "model_attributes_type":
            return f"is {value}, but must be a mapping of fields"
        case "path":
            return f"cannot be flown: {problem['msg']}"
        case "dict_type":
            return f"is {value}, but must be a mapping of names to numbers"
        case "tuple_type":
            alone = "; an item alone can be given where the others have defaults" if _gives_items(problem) else ""
            return f"is {value}, but must be a list{alone}"
    demand = re.sub(r"^(Input|String|Tuple) should", "must", problem["msg"]).replace(" after validation", "")
    return f"is {value}, but {demand}"


def _further_in(model: type[Model], name: str) -> list[str]:
    """Return the paths of the fields of that name in the mappings of a model."""
    return [
        f"{field}.{name}"
        for field, info in model.model_fields.items()
        if any(name in getattr(mapping, "model_fields", ()) for mapping in alternatives(info.annotation, info.metadata))
    ]


def _real_path(problem: Any, data: Any) -> tuple[Any, ...]:
    """Return the path of a problem in the document, without the tags of unions, which do not occur in files.

    The last element of the path of a missing field or item is that field or item.
    """
    path: list[Any] = []
    tagged: Any = None
    location, is_missing = problem["loc"], problem["type"] == "missing"
    for i, key in enumerate(location):
        is_last = i == len(location) - 1
        kinds = (data["kind"],) if isinstance(data, dict) and "kind" in data else _SILENT_KINDS
        # "normal" may be the tag of a normal distribution or a field of a half-space; the problem's input decides.
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


def _written(path: tuple[Any, ...]) -> str:
    """Return the path as in `vehicle.inertia.0`."""
    steps = [key if isinstance(key, int) or str(key).isidentifier() else shown(key) for key in path]
    return shortened(joined(*steps), _MOST_OF_A_PATH) or "the scenario"
