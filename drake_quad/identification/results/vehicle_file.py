"""File of an identified vehicle in the scenario language, for `extends` and for studies.

The file extends the vehicle with which the identification began. `vehicle` and `laboratory` contain the estimates as
correlated normal distributions. The distributions describe another stretch of flight: their covariance includes the
error of the mean and, where it is known, the variation from stretch to stretch. Their standard deviations also account
for Student's distribution, so that 95 % of the samples are within the interval for another stretch.

`nominal`, which the planner and the controllers believe, is that of the base unless the estimates are requested there
as well. To predict flights of the controller that flew a log, keep its own values in `nominal`. To design a controller
for the identified vehicle, write the estimates to `nominal`.
"""

import math
import os
import re
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import scipy
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.representer import RoundTripRepresenter

from drake_quad.errors import InputError, shown
from drake_quad.files import output_folder, write_atomically
from drake_quad.identification.results.estimates import (
    CONFIDENCE,
    Estimates,
    declaration_at,
    declaration_of,
    field_path,
    split_name,
)
from drake_quad.scenario.correlation import correlated_normals
from drake_quad.scenario.distributions import Normal
from drake_quad.scenario.files.library import Library, is_shipped, split_spec
from drake_quad.scenario.files.loading import load_undesigned
from drake_quad.scenario.models import NAME, Nominal, Scenario, Vehicle
from drake_quad.scenario.paths import distributions_in, value_at
from drake_quad.statistics.interval import Interval
from drake_quad.vehicle.motors import ThrustCurve, thrust_of
from drake_quad.vehicle.rigid_body import inertia_flaw, nearest_rigid

_COMMENT_WIDTH = 100  # characters
_FILE_WIDTH = 400  # characters, so that the coefficients of shared variables are on one line
_MIN_RATIO = 0.1  # lower limit of a positive parameter, relative to its mean
_LIMIT_SIGMA = 6.0  # distance of a limit from the mean, in standard deviations, where the language requires a limit
_NUM_EXTRA_DECIMALS = 5  # decimals beyond the first digit of the standard deviation
# Limit of the rotor speed relative to the speed at full throttle. The limit allows a fifth more thrust, which exceeds
# the error of a thrust curve.
_SPEED_MARGIN = 1.1


class _Entry(NamedTuple):
    """Value in the file, and the comment above it."""

    value: Any
    comment: str = ""


def write_vehicle(
    path: Path,
    name: str,
    estimates: Estimates,
    *,
    base: str | Path,
    nominal: bool = False,
    given: Sequence[str] = (),
    voltage: float | None = None,
) -> Path:
    """Write an identified vehicle to a file, and return its path.

    The file is written completely or not at all. Fields without an estimate are as in `base`, except those that would
    contradict an estimate: a separate lag of rotors that slow down, if one lag was found for both directions, and
    `linear_drag` and `quadratic_drag` in addition to `body_drag`.

    Args:
        path: path of the file, `.yaml` or `.yml`; its folder is created if needed.
        name: name of the scenario in the file.
        estimates: at least one estimate.
        base: FILE or FILE:NAME of the vehicle that the file extends, or a shipped one.
        nominal: True to write the estimates also to `nominal`, which the planner and the controllers believe. Numbers
            that the logs do not identify stay as in `base` there.
        given: overrides of the base, such as a weighed mass, `nominal.mass=0.03`, with values in YAML.
        voltage: voltage of the battery for which an identified thrust curve holds, V; None if it is unknown.

    Raises:
        InputError: if a name or a path is wrong, the base cannot be loaded, an estimate needs others that are missing,
            or the vehicle cannot fly.
    """
    if path.suffix not in (".yaml", ".yml"):
        raise InputError(f"{shown(str(path))} must end in .yaml or .yml")
    if not re.fullmatch(NAME, name):
        raise InputError(f"a vehicle cannot be called {shown(name)}: allowed are letters, digits, '_', '.' and '-'")
    if not estimates.names:
        raise InputError("there is no estimate to write")
    believed = load_undesigned(base, given)
    folder = output_folder(path.parent)
    fields = _fields(name, estimates, believed, nominal, given, voltage)
    scenario = {"extends": _Entry(_relative(base, folder)), **fields}
    document = CommentedMap({name: _commented(scenario, 2)})
    document.yaml_set_start_comment(_wrapped(_introduction(estimates)))

    def write(target: Path) -> None:
        with target.open("w", encoding="utf-8") as file:
            _yaml().dump(document, file)
        try:
            load_undesigned(target)
        except InputError as error:
            reason = str(error).replace(str(target), str(path))
            raise InputError(f"the vehicle cannot be written: {reason}") from None

    return write_atomically(path, write)


def believed_estimates(scenario: Scenario) -> list[str]:
    """Return the names of the parameters whose estimates are also in `nominal`, as `write_vehicle` can write them."""
    found = []
    for path, drawn in distributions_in(scenario).items():
        part, _, name = path.partition(".")
        is_believed = part == "vehicle" and name.partition(".")[0] in Nominal.model_fields
        if is_believed and isinstance(drawn, Normal) and value_at(scenario, f"nominal.{name}") == drawn.normal.mean:
            found.append(name)
    return found


def _relative(base: str | Path, folder: Path) -> str:
    """Return the base as a path relative to the folder of the file, or as the name of a shipped scenario."""
    if is_shipped(str(base)):
        file = str(base).partition(":")[0]
        return f"{file}:{Library().find(str(base))[0]}"
    file, name = split_spec(str(base))
    try:
        found = Path(os.path.relpath(Path(file).resolve(), folder.resolve())).as_posix()
    except ValueError:  # no relative path exists if the two are on different drives
        found = Path(file).resolve().as_posix()
    return found if name is None else f"{found}:{name}"


def _fields(
    name: str, estimates: Estimates, base: Scenario, nominal: bool, given: Sequence[str], voltage: float | None
) -> dict[str, Any]:
    """Return the scenario as nested mappings with an entry at each leaf."""
    prefix = re.sub(r"\W", "_", name, flags=re.ASCII)[:50]
    written = _values(estimates, f"v_{prefix}" if prefix[0].isdecimal() else prefix)
    comments = {each: _comment(estimates, each, written[each]) for each in estimates.names}
    tree: dict[str, Any] = {"nominal": {}, "vehicle": {}, "laboratory": {}, "control": {}}
    for path in dict.fromkeys(split_name(each)[0] for each in estimates.names):
        whole = {each: _Entry(written[each], comments[each]) for each in estimates.names if split_name(each)[0] == path}
        value = _rigid(path, _listed(path, whole, base)) if declaration_at(path).items else whole[path]
        *steps, last = field_path(path).split(".")
        node = tree
        for step in steps:
            node = node.setdefault(step, {})
        node[last] = value
        if nominal and path in Nominal.model_fields and any(each in estimates.identified for each in whole):
            # An item that is not identified keeps its value in `nominal`.
            own: Any = getattr(base.nominal, path)
            names = [f"{path}[{place}]" for place in range(declaration_at(path).items)]
            known = {each: written[each] for each in names if each in estimates.identified}
            items = [_Entry(_median(known.get(each, own[i]))) for i, each in enumerate(names)]
            tree["nominal"][path] = _rigid(path, items) if items else _Entry(_median(written[path]))
    for assignment in given:
        _put(tree, assignment)
    # A thrust curve is written as a whole, since its coefficients are correlated.
    curve_known = any(split_name(each)[0] == "motors.curve" for each in estimates.identified)
    _with_motors(tree, base, nominal and curve_known, voltage)
    _with_response(tree, base)
    _without_contradictions(tree["vehicle"])
    return {field: value for field, value in tree.items() if value}


def _put(tree: dict[str, Any], assignment: str) -> None:
    """Add an override to the fields, unless there is an estimate.

    Raises:
        InputError: if the override does not set a whole field of the vehicle, its laboratory or its control.
    """
    path, _, value = assignment.partition("=")
    top, *steps = path.strip().split(".")
    if top not in tree or not steps or any(re.fullmatch(r"(rotor_)?\d", step) for step in steps):
        raise InputError(
            f"{assignment} cannot be written with a vehicle: allowed are whole fields of"
            f" {', '.join(tree)}, no items of lists"
        )
    node = tree[top]
    for step in steps[:-1]:
        node = node.setdefault(step, {})
    if isinstance(node, dict):
        node.setdefault(steps[-1], _Entry(YAML(typ="safe").load(value), "given, not identified"))


def _values(estimates: Estimates, prefix: str) -> dict[str, Any]:
    """Return the number, or the distribution with the limits that the language requires, for each estimate."""
    numbers = {
        name: _number(name, _rounded(value, deviation))
        for name, value, deviation in zip(estimates.names, estimates.values, estimates.deviations, strict=True)
    }
    drawn = [name for name in estimates.names if not declaration_of(name).is_whole]
    if not drawn:
        return numbers
    part = estimates.for_new_flight().part(drawn)
    # The normal distribution is widened to the 95 % interval of Student's distribution.
    wider = part.quantiles() / scipy.stats.norm.ppf(0.5 * (1.0 + CONFIDENCE))
    covariance = part.covariance * np.outer(wider, wider)
    for name, each in correlated_normals(drawn, part.values, covariance, prefix=prefix).items():
        bell = each["normal"]
        spread = float(f"{bell['standard_deviation']:.6g}")
        shared = {"shared": bell["shared"]} if "shared" in bell else {}
        limits = _limits(name, numbers[name], spread)
        numbers[name] = {"normal": {"mean": numbers[name], "standard_deviation": spread, **limits, **shared}}
    return numbers


def _rounded(value: float, deviation: float) -> float:
    """Return a number with the decimals that its standard deviation justifies."""
    return round(float(value), _NUM_EXTRA_DECIMALS - math.floor(math.log10(deviation)))


def _number(name: str, value: float) -> Any:
    """Return an estimate as a number that the language allows.

    Raises:
        InputError: if the parameter must be positive, and the estimate is not.
    """
    declared = declaration_of(name)
    if declared.lower > 0.0 >= value:
        raise InputError(
            f"the estimate of {name}, {value:.4g} {declared.unit}, must be larger than 0; list such a parameter as not"
            " identified"
        )
    value = min(max(value, declared.lower), declared.upper)
    return round(value) if declared.is_whole else value


def _limits(name: str, mean: float, deviation: float) -> dict[str, float]:
    """Return the limits that the language requires for the distribution of a parameter."""
    declared, reach = declaration_of(name), _LIMIT_SIGMA * deviation
    limits: dict[str, float] = {}
    if declared.needs_min:
        lowest = _MIN_RATIO * mean if declared.lower > 0.0 else 0.0 if declared.lower == 0.0 else mean - reach
        limits["min"] = max(declared.lower, min(mean, float(f"{lowest:.4g}")))
    if declared.needs_max:
        limits["max"] = min(declared.upper, max(mean, float(f"{mean + reach:.4g}")))
    return limits


def _comment(estimates: Estimates, name: str, written: Any) -> str:
    """Return a comment on an estimate with its unit, intervals, explained variance and source."""
    place = estimates.names.index(name)
    unit = "" if declaration_of(name).unit == "1" else declaration_of(name).unit
    value = float(estimates.values[place])
    own, new_flight = (
        Interval(value, *each.intervals()[place]).text(unit=unit) for each in (estimates, estimates.for_new_flight())
    )
    if name in estimates.not_identified:
        return f"not identified, {own}: as in what this extends, as far as the log narrows it"
    parts = [f"{own} with 95 % confidence"]
    between, within = (
        0.0 if each is None else np.nan_to_num(each.covariance[place, place])
        for each in (estimates.flight_variation, estimates.variation)
    )
    if between > 0.0:
        parts.append(f"{new_flight} in another flight")
    elif within > 0.0:
        assert estimates.variation is not None
        parts.append(f"{new_flight} in another {estimates.variation.duration:.2g} s of flight")
    share, output = estimates.explained.get(name, (0.0, ""))
    if share > 0.0:
        parts.append(f"explains {100.0 * share:.3g} % of the variance of {output}")
    parts.append(" and ".join(map(str, estimates.sources_of(place))))
    mean = written["normal"]["mean"] if isinstance(written, dict) else written
    if declaration_of(name).is_whole:
        parts.append("written as a whole number")
    elif abs(mean - value) > estimates.deviations[place]:
        parts.append("the estimate is outside the limits of the language, and the limit is written")
    return "; ".join(parts)


def _listed(path: str, whole: Mapping[str, _Entry], base: Scenario) -> list[_Entry]:
    """Return all items of a list. Items that are not estimated are those of the base.

    Raises:
        InputError: if the base has no such list.
    """
    names = [f"{path}[{place}]" for place in range(declaration_at(path).items)]
    return [whole[name] if name in whole else _of_base(base, path, place) for place, name in enumerate(names)]


def _of_base(base: Scenario, path: str, place: int) -> _Entry:
    """Return an item of a list of the base.

    Raises:
        InputError: if the base has no such list.
    """
    holder, _, field = field_path(path).rpartition(".")
    owner = value_at(base, holder)
    if owner is None:  # the effect is switched off in the base
        return _Entry(0.0, "as in what this extends")
    if path == "motors.curve" and not base.vehicle.motors.take_throttles and place < 2:
        return _Entry(0.0, "not identified, and 0 at the start of the identification")
    if not hasattr(owner, field):
        raise InputError(f"{path}[{place}] must be estimated, too: what the vehicle extends has none")
    value = getattr(owner, field)[place]
    written = value if isinstance(value, float) else value.model_dump(mode="json", exclude_none=True)
    return _Entry(written, "as in what this extends")


def _rigid(path: str, items: list[_Entry]) -> list[_Entry]:
    """Return moments of inertia, adjusted to those of a rigid body if needed; return any other list unchanged."""
    known = all(isinstance(item.value, float) or "normal" in item.value for item in items)
    if path != "inertia" or not known:
        return items
    found = [_median(item.value) for item in items]
    flaw = inertia_flaw(found)
    if not flaw:
        return items
    why = f"adjusted to the nearest rigid body: in the estimate, {flaw}"
    return [
        _Entry(_moved(item.value, float(there - here)), "; ".join(filter(None, [item.comment, why])))
        for item, here, there in zip(items, found, nearest_rigid(found), strict=True)
    ]


def _moved(value: Any, step: float) -> Any:
    """Return a number or a normal distribution, shifted by a step."""
    if isinstance(value, dict):
        return {"normal": {**value["normal"], "mean": _significant(value["normal"]["mean"] + step)}}
    return _significant(value + step)


def _with_motors(tree: dict[str, Any], base: Scenario, nominal: bool, voltage: float | None) -> None:
    """Complete the motors if their thrust curve was estimated, and raise speed limits that would limit the curve.

    If the curve is not written to `nominal`, and `nominal` of the base has no throttle motors, `nominal` gets motors
    that give its full thrust at full throttle.
    """
    if "motors" not in tree["vehicle"]:
        return
    curve = tree["vehicle"]["motors"]["curve"]
    numbers = [_median(entry.value) for entry in curve]
    tree["vehicle"]["motors"] = {"kind": _Entry("throttle"), "curve": curve}
    if voltage is not None:
        tree["vehicle"]["motors"]["voltage"] = _Entry(float(f"{voltage:.5g}"))
    believed = numbers
    if not base.nominal.motors.take_throttles:
        tree["vehicle"].setdefault("min_rotor_speed", _Entry(0.0, "does not limit the thrust curve"))
        if not nominal:
            believed = [0.0, 0.0, float(f"{base.nominal.thrust_factor * base.nominal.max_rotor_speed**2:.4g}")]
    if nominal or not base.nominal.motors.take_throttles:
        tree["nominal"]["motors"] = {"kind": _Entry("throttle"), "curve": [_Entry(each) for each in believed]}
    full = max(0.0, float(thrust_of(1.0, ThrustCurve(*numbers))))
    top = _SPEED_MARGIN * math.sqrt(full / base.nominal.thrust_factor)
    for part in ("vehicle", "nominal") if nominal else ("vehicle",):
        limit = getattr(base, part).max_rotor_speed
        if isinstance(limit, float) and limit < top:
            why = "higher than at full throttle, so that it does not limit the thrust curve"
            tree[part]["max_rotor_speed"] = _Entry(float(f"{top:.4g}"), why)


def _significant(number: float) -> float:
    return float(f"{number:.6g}")


def _median(value: Any) -> float:
    return float(value["normal"]["mean"] if isinstance(value, dict) else value)


def _with_response(tree: dict[str, Any], base: Scenario) -> None:
    """Complete the autopilot and the control if an attitude response was estimated and the base has none.

    Raises:
        InputError: if only one of natural frequency and damping is estimated.
    """
    autopilot = tree["laboratory"].get("autopilot", {})
    responds = "natural_frequency" in autopilot or "damping" in autopilot
    if not responds or base.laboratory.autopilot.models_vehicle:
        return
    missing = next((each for each in ("natural_frequency", "damping") if each not in autopilot), None)
    if missing is not None:
        raise InputError(f"autopilot.{missing} must be estimated, too: what the vehicle extends has no such response")
    tree["laboratory"]["autopilot"] = {"kind": _Entry("response"), **autopilot}
    tree["control"] = {"attitude": _Entry(None, "on board"), "position": {"feed_forward": _Entry("acceleration")}}
    for effect in base.vehicle.without_response():
        off = Vehicle.model_fields[effect].default
        tree["vehicle"][effect] = _Entry(off, "is in the response of the attitude")


def _without_contradictions(vehicle: dict[str, Any]) -> None:
    """Switch off the effects of the base that an estimate already includes."""
    if "rotor_time_constant" in vehicle and "rotor_time_constant_down" not in vehicle:
        vehicle["rotor_time_constant_down"] = _Entry(None, "one lag was found for both directions")
    if "body_drag" in vehicle:
        for name in ("linear_drag", "quadratic_drag"):
            vehicle.setdefault(name, _Entry(0.0, "is in body_drag"))


def _introduction(estimates: Estimates) -> list[str]:
    """Return the paragraphs of the comment at the top of the file."""
    logs = dict.fromkeys(source.log for i in range(len(estimates.names)) for source in estimates.sources_of(i))
    among = " and how it varies among them" if estimates.variation_known.any() else ""
    pairs = zip(estimates.names, estimates.variation_known, strict=True)
    unknown = [name for name, known in pairs if among and not known]
    but = f", which is not known of {', '.join(unknown)}" if unknown else ""
    drawn = (
        f"A distribution has what the flights say of a number{among}{but}. Fields that share a variable are correlated."
    )
    unseen = [f"{name} is not identified: {why}" for name, why in estimates.not_identified.items()]
    return [f"Identified from {', '.join(logs)}. {drawn}", *estimates.remarks, *unseen]


def _wrapped(paragraphs: list[str], width: int = _COMMENT_WIDTH) -> str:
    lines: Iterator[str] = (line for text in paragraphs for line in textwrap.wrap(text, width, break_long_words=False))
    return "\n".join(lines)


def _commented(node: Any, indent: int) -> Any:
    """Return mappings and lists of entries as YAML with comments."""
    if isinstance(node, _Entry):
        return _block(node.value)
    if isinstance(node, dict):
        mapping = CommentedMap({key: _commented(value, indent + 2) for key, value in node.items()})
        return _with_comments(mapping, node.items(), indent)
    if any(item.comment or isinstance(item.value, dict) for item in node):
        items = CommentedSeq([_commented(item, indent + 2) for item in node])
        return _with_comments(items, enumerate(node), indent)
    sequence = CommentedSeq([item.value for item in node])
    sequence.fa.set_flow_style()
    return sequence


def _with_comments(container: Any, items: Any, indent: int) -> Any:
    for key, item in items:
        if isinstance(item, _Entry) and item.comment:
            text = _wrapped([item.comment])
            container.yaml_set_comment_before_after_key(key, before=text, indent=indent)
    return container


def _block(value: Any) -> Any:
    """Return a number, or a distribution whose innermost mapping is written on one line."""
    if not isinstance(value, dict):
        return value
    mapping = CommentedMap({key: _block(each) for key, each in value.items()})
    if not any(isinstance(each, dict) for each in value.values()):
        mapping.fa.set_flow_style()
    return mapping


class _Representer(RoundTripRepresenter):
    """Representer that writes `null` for a field that is switched off."""

    def represent_none(self, data: None) -> Any:
        return self.represent_scalar("tag:yaml.org,2002:null", "null")


_Representer.add_representer(type(None), _Representer.represent_none)


def _yaml() -> YAML:
    yaml = YAML()
    yaml.Representer = _Representer
    yaml.width = _FILE_WIDTH
    yaml.indent(mapping=2, sequence=4, offset=2)
    return yaml
