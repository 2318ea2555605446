"""File of an identified vehicle in the scenario language, for `extends` and for studies.

The file extends the vehicle with which the identification began. `vehicle` and `laboratory` contain the estimates as
correlated normal distributions. The distributions describe a flight that was not logged: their covariance includes the
error of the mean and, if it is known, the variation from one stretch of flight to the next. The standard deviations are
widened to match Student's t-distribution, so that 95 % of the samples are within the interval for a further stretch.

`nominal`, which the planner and the controllers assume, is unchanged unless the estimates are requested there as well.
To predict flights under the controller of the log, keep the values that this controller assumed in `nominal`. To
design a controller for the identified vehicle, write the estimates to `nominal`.
"""

import math
import os
import re
import textwrap
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.representer import RoundTripRepresenter

from drake_quad.errors import InputError, short_repr
from drake_quad.files import output_folder, write_atomically
from drake_quad.identification.evidence import quantile
from drake_quad.identification.results.estimates import (
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
from drake_quad.vehicle.motors import ThrustCurve, thrust_from_throttle
from drake_quad.vehicle.rigid_body import explain_invalid_inertia, nearest_rigid_inertia

_COMMENT_WIDTH = 100  # characters
_FILE_WIDTH = 400  # characters, so that the coefficients of shared variables are on one line
_MIN_VALUE_RATIO = 0.1  # lower limit of the distribution of a positive parameter, relative to its mean
_LIMIT_SIGMA = 6.0  # distance of the limits of a distribution from its mean, in standard deviations
_NUM_EXTRA_DECIMALS = 5  # decimals of an estimate after the first significant digit of its standard deviation
# Rotor speed limit, relative to the speed at full throttle. The limit allows 21 % more thrust, which exceeds the error
# of a thrust curve.
_SPEED_LIMIT_RATIO = 1.1


class _Entry(NamedTuple):
    """Value in a vehicle file, and the comment above it."""

    value: Any
    comment: str = ""

    @property
    def mean(self) -> float:
        """The value itself, or its mean if the value is a normal distribution."""
        return float(self.value["normal"]["mean"] if isinstance(self.value, dict) else self.value)

    def shifted_to(self, mean: float, comment: str) -> "_Entry":
        """Return the entry after its mean has been replaced and a comment has been added."""
        rounded = float(f"{mean:.6g}")
        value = {"normal": {**self.value["normal"], "mean": rounded}} if isinstance(self.value, dict) else rounded
        return _Entry(value, "; ".join(filter(None, [self.comment, comment])))


def write_vehicle(
    path: Path | str,
    name: str,
    estimates: Estimates,
    *,
    base: str | Path,
    nominal: bool = False,
    overrides: Sequence[str] = (),
    voltage: float | None = None,
) -> Path:
    """Write an identified vehicle to a file, and return its path.

    The file is written completely or not at all. Fields without an estimate are as in `base`, except fields that would
    contradict an estimate. If one time constant of the rotors was identified for both directions, the separate time
    constant of rotors that slow down is removed. If `body_drag` was identified, `linear_drag` and `quadratic_drag` are
    0.

    Args:
        path: path of the file, `.yaml` or `.yml`; its folder is created if needed.
        name: name of the scenario in the file.
        estimates: at least one estimate.
        base: FILE or FILE:NAME of the vehicle that the file extends, or the name of a shipped scenario.
        nominal: True to write the estimates also to `nominal`, which the planner and the controllers assume. Values
            of parameters that the logs do not identify stay as in `base` there.
        overrides: overrides of the base scenario, such as a weighed mass, `nominal.mass=0.03`, with values in YAML.
        voltage: voltage of the battery for which an identified thrust curve holds, V; None if it is unknown.

    Raises:
        InputError: if a name or a path is wrong, the base scenario cannot be loaded, an estimate requires further
            estimates that are missing, or the vehicle cannot fly.
    """
    path = Path(path)
    if path.suffix not in (".yaml", ".yml"):
        raise InputError(f"{short_repr(str(path))} must end in .yaml or .yml")
    if not re.fullmatch(NAME, name):
        raise InputError(f"a vehicle cannot be called {short_repr(name)}: use only letters, digits, '_', '.' and '-'")
    if not estimates.names:
        raise InputError("a vehicle file needs at least one estimate")
    base_scenario = load_undesigned(base, overrides)
    folder = output_folder(path.parent)
    fields = _fields(name, estimates, base_scenario, nominal, overrides, voltage)
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


def nominal_estimates(scenario: Scenario) -> list[str]:
    """Return the names of the parameters whose estimates are also in `nominal` of a scenario from `write_vehicle`."""
    names = []
    for path, distribution in distributions_in(scenario).items():
        part, _, name = path.partition(".")
        is_nominal = part == "vehicle" and name.partition(".")[0] in Nominal.model_fields
        if (
            is_nominal
            and isinstance(distribution, Normal)
            and value_at(scenario, f"nominal.{name}") == distribution.normal.mean
        ):
            names.append(name)
    return names


def _relative(base: str | Path, folder: Path) -> str:
    """Return the base scenario as a path relative to the new file, or as the name of a shipped scenario."""
    if is_shipped(str(base)):
        file = str(base).partition(":")[0]
        return f"{file}:{Library().find(str(base))[0]}"
    file, name = split_spec(str(base))
    try:
        written_path = Path(os.path.relpath(Path(file).resolve(), folder.resolve())).as_posix()
    except ValueError:  # no relative path exists between different drives
        written_path = Path(file).resolve().as_posix()
    return written_path if name is None else f"{written_path}:{name}"


def _fields(
    name: str, estimates: Estimates, base: Scenario, nominal: bool, overrides: Sequence[str], voltage: float | None
) -> dict[str, Any]:
    """Return the scenario as nested mappings. Each field has an `_Entry` with its value and comment."""
    prefix = re.sub(r"\W", "_", name, flags=re.ASCII)[:50]
    values = _values(estimates, f"v_{prefix}" if prefix[0].isdecimal() else prefix)
    written = {parameter: _Entry(value, _comment(estimates, parameter, value)) for parameter, value in values.items()}
    tree: dict[str, Any] = {"nominal": {}, "vehicle": {}, "laboratory": {}, "control": {}}
    for path in dict.fromkeys(split_name(parameter)[0] for parameter in estimates.names):
        count = declaration_at(path).items
        names = [f"{path}[{index}]" for index in range(count)] if count else [path]
        entries = [
            written[parameter] if parameter in written else _base_entry(base, path, index)
            for index, parameter in enumerate(names)
        ]
        *steps, last = field_path(path).split(".")
        node = tree
        for step in steps:
            node = node.setdefault(step, {})
        node[last] = _as_rigid_body(path, entries) if count else entries[0]
        is_known = [parameter in estimates.identified for parameter in names]
        if nominal and path in Nominal.model_fields and any(is_known):
            # Items that are not identified keep their values in `nominal`.
            old = getattr(base.nominal, path) if count else [None]
            items = [
                _Entry(entry.mean if known else float(value))
                for entry, known, value in zip(entries, is_known, old, strict=True)
            ]
            tree["nominal"][path] = _as_rigid_body(path, items) if count else items[0]
    for assignment in overrides:
        _add_override(tree, assignment)
    # A thrust curve is written as a whole, since its coefficients are correlated.
    curve_known = any(split_name(parameter)[0] == "motors.curve" for parameter in estimates.identified)
    _complete_motors(tree, base, nominal and curve_known, voltage)
    _complete_response(tree, base)
    _switch_off_duplicates(tree["vehicle"])
    return {field: value for field, value in tree.items() if value}


def _add_override(tree: dict[str, Any], assignment: str) -> None:
    """Add an override to the fields, unless an estimate already sets the same field.

    Raises:
        InputError: if the override does not set a whole field of the vehicle, its laboratory or its control.
    """
    path, _, value = assignment.partition("=")
    top, *steps = path.strip().split(".")
    if top not in tree or not steps or any(re.fullmatch(r"(rotor_)?\d", step) for step in steps):
        raise InputError(
            f"{assignment} cannot be written to the file of a vehicle: only fields of {', '.join(tree)} can be set, and"
            " a list can only be set as a whole"
        )
    node = tree[top]
    for step in steps[:-1]:
        node = node.setdefault(step, {})
    if isinstance(node, dict):
        node.setdefault(steps[-1], _Entry(YAML(typ="safe").load(value), "set by the user, not identified"))


def _values(estimates: Estimates, prefix: str) -> dict[str, Any]:
    """Return a number, or a distribution with the limits that the scenario language requires, for each estimate."""
    numbers = {
        name: _number(name, _rounded(value, deviation))
        for name, value, deviation in zip(estimates.names, estimates.values, estimates.deviations, strict=True)
    }
    varying = [name for name in estimates.names if not declaration_of(name).is_whole]
    if not varying:
        return numbers
    part = estimates.for_new_flight().subset(varying)
    # The normal distribution is widened to the 95 % interval of Student's t-distribution.
    widening = part.quantiles() / quantile(np.inf)
    covariance = part.covariance * np.outer(widening, widening)
    for name, distribution in correlated_normals(varying, part.values, covariance, prefix=prefix).items():
        normal = distribution["normal"]
        deviation = float(f"{normal['standard_deviation']:.6g}")
        shared = {"shared": normal["shared"]} if "shared" in normal else {}
        limits = _limits(name, numbers[name], deviation)
        numbers[name] = {"normal": {"mean": numbers[name], "standard_deviation": deviation, **limits, **shared}}
    return numbers


def _rounded(value: float, deviation: float) -> float:
    """Round a number to the decimals that its standard deviation justifies."""
    return round(float(value), _NUM_EXTRA_DECIMALS - math.floor(math.log10(deviation)))


def _number(name: str, value: float) -> Any:
    """Return an estimate as a number that the scenario language allows.

    Raises:
        InputError: if the parameter must be positive, and the estimate is not.
    """
    declared = declaration_of(name)
    if declared.lower > 0.0 >= value:
        raise InputError(
            f"the estimate of {name}, {value:.4g} {declared.unit}, must be larger than 0; if the logs do not determine"
            f" {name}, remove its estimate and list it in not_identified"
        )
    value = min(max(value, declared.lower), declared.upper)
    return round(value) if declared.is_whole else value


def _limits(name: str, mean: float, deviation: float) -> dict[str, float]:
    """Return the limits that the scenario language requires for the distribution of a parameter."""
    declared, half_range = declaration_of(name), _LIMIT_SIGMA * deviation
    limits: dict[str, float] = {}
    if declared.needs_min:
        lowest = (
            _MIN_VALUE_RATIO * mean if declared.lower > 0.0 else 0.0 if declared.lower == 0.0 else mean - half_range
        )
        limits["min"] = max(declared.lower, min(mean, float(f"{lowest:.4g}")))
    if declared.needs_max:
        limits["max"] = min(declared.upper, max(mean, float(f"{mean + half_range:.4g}")))
    return limits


def _comment(estimates: Estimates, name: str, entry: Any) -> str:
    """Return a comment on an estimate with its unit, intervals, explained variance and source."""
    index = estimates.names.index(name)
    unit = "" if declaration_of(name).unit == "1" else declaration_of(name).unit
    value = float(estimates.values[index])
    interval, new_flight = (
        Interval(value, *item.intervals()[index]).text(unit=unit) for item in (estimates, estimates.for_new_flight())
    )
    if name in estimates.not_identified:
        return f"not identified by itself, {interval}: the curve is known only at the thrusts of the flight"
    parts = [f"{interval} with 95 % confidence"]
    flight_variance, stretch_variance = (
        0.0 if item is None else np.nan_to_num(item.covariance[index, index])
        for item in (estimates.flight_variation, estimates.variation)
    )
    if flight_variance > 0.0:
        parts.append(f"{new_flight} in another flight")
    elif stretch_variance > 0.0:
        assert estimates.variation is not None
        parts.append(f"{new_flight} in another {estimates.variation.duration:.2g} s of flight")
    fraction, output = estimates.explained_variance.get(name, (0.0, ""))
    if fraction > 0.0:
        parts.append(f"explains {100.0 * fraction:.3g} % of the variance of {output}")
    parts.append(" and ".join(map(str, estimates.sources_of(index))))
    mean = entry["normal"]["mean"] if isinstance(entry, dict) else entry
    if declaration_of(name).is_whole:
        parts.append("written as a whole number")
    elif abs(mean - value) > estimates.deviations[index]:
        parts.append("the estimate is outside the range of the scenario language, so the limit of the range is written")
    return "; ".join(parts)


def _base_entry(base: Scenario, path: str, index: int) -> _Entry:
    """Return an item of a list in the base scenario.

    Raises:
        InputError: if the base scenario has no such list.
    """
    owner_path, _, field = field_path(path).rpartition(".")
    owner = value_at(base, owner_path)
    if owner is None:  # the effect is switched off in the base scenario
        return _Entry(0.0, "as in the base vehicle")
    if path == "motors.curve" and not base.vehicle.motors.take_throttles and index < 2:
        return _Entry(0.0, "not identified, and 0 at the start of the identification")
    if not hasattr(owner, field):
        raise InputError(f"{path}[{index}] must also be estimated: the base vehicle has no such parameter")
    value = getattr(owner, field)[index]
    written = value if isinstance(value, float) else value.model_dump(mode="json", exclude_none=True)
    return _Entry(written, "as in the base vehicle")


def _as_rigid_body(path: str, items: list[_Entry]) -> list[_Entry]:
    """Return the items of a list, with moments of inertia adjusted to those of a rigid body if needed."""
    is_numeric = all(isinstance(item.value, float) or "normal" in item.value for item in items)
    if path != "inertia" or not is_numeric:
        return items
    moments = [item.mean for item in items]
    flaw = explain_invalid_inertia(moments)
    if not flaw:
        return items
    remark = f"adjusted to the nearest rigid body: in the estimate, {flaw}"
    adjusted = nearest_rigid_inertia(moments).tolist()
    return [item.shifted_to(mean, remark) for item, mean in zip(items, adjusted, strict=True)]


def _complete_motors(tree: dict[str, Any], base: Scenario, nominal: bool, voltage: float | None) -> None:
    """Complete the motors if their thrust curve was estimated, and raise rotor speed limits below full throttle.

    `nominal` also needs throttle motors if `nominal` of the base scenario has none. If the estimated curve is not
    written to `nominal`, its motors produce the full thrust of the base scenario at full throttle.
    """
    if "motors" not in tree["vehicle"]:
        return
    curve = tree["vehicle"]["motors"]["curve"]
    coefficients = [entry.mean for entry in curve]
    tree["vehicle"]["motors"] = {"kind": _Entry("throttle"), "curve": curve}
    if voltage is not None:
        tree["vehicle"]["motors"]["voltage"] = _Entry(float(f"{voltage:.5g}"))
    nominal_curve = coefficients
    if not base.nominal.motors.take_throttles:
        tree["vehicle"].setdefault("min_rotor_speed", _Entry(0.0, "does not limit the thrust curve"))
        if not nominal:
            nominal_curve = [0.0, 0.0, float(f"{base.nominal.thrust_factor * base.nominal.max_rotor_speed**2:.4g}")]
    if nominal or not base.nominal.motors.take_throttles:
        tree["nominal"]["motors"] = {
            "kind": _Entry("throttle"),
            "curve": [_Entry(coefficient) for coefficient in nominal_curve],
        }
    max_thrust = max(0.0, float(thrust_from_throttle(1.0, ThrustCurve(*coefficients))))
    full_speed = _SPEED_LIMIT_RATIO * math.sqrt(max_thrust / base.nominal.thrust_factor)
    for part in ("vehicle", "nominal") if nominal else ("vehicle",):
        limit = getattr(base, part).max_rotor_speed
        if isinstance(limit, float) and limit < full_speed:
            comment = "higher than at full throttle, so that it does not limit the thrust curve"
            tree[part]["max_rotor_speed"] = _Entry(float(f"{full_speed:.4g}"), comment)


def _complete_response(tree: dict[str, Any], base: Scenario) -> None:
    """Add the autopilot and the controller that an estimated attitude response needs, if the base scenario lacks them.

    Raises:
        InputError: if only one of natural frequency and damping is estimated.
    """
    autopilot = tree["laboratory"].get("autopilot", {})
    responds = "natural_frequency" in autopilot or "damping" in autopilot
    if not responds or base.laboratory.autopilot.models_vehicle:
        return
    missing = next((each for each in ("natural_frequency", "damping") if each not in autopilot), None)
    if missing is not None:
        raise InputError(f"autopilot.{missing} must also be estimated: the base vehicle has no attitude response")
    tree["laboratory"]["autopilot"] = {"kind": _Entry("response"), **autopilot}
    tree["control"] = {
        "attitude": _Entry(None, "the autopilot controls the attitude"),
        "position": {"feed_forward": _Entry("acceleration")},
    }
    for effect in base.vehicle.effects_unsupported_by_response():
        off = Vehicle.model_fields[effect].default
        tree["vehicle"][effect] = _Entry(off, "included in the attitude response")


def _switch_off_duplicates(vehicle: dict[str, Any]) -> None:
    """Switch off the effects of the base scenario that an estimate already includes."""
    if "rotor_time_constant" in vehicle and "rotor_time_constant_down" not in vehicle:
        vehicle["rotor_time_constant_down"] = _Entry(None, "one time constant was identified for both directions")
    if "body_drag" in vehicle:
        for name in ("linear_drag", "quadratic_drag"):
            vehicle.setdefault(name, _Entry(0.0, "included in body_drag"))


def _introduction(estimates: Estimates) -> list[str]:
    """Return the paragraphs of the comment at the top of a vehicle file."""
    logs = dict.fromkeys(source.log for i in range(len(estimates.names)) for source in estimates.sources_of(i))
    variation_clause = " and its variation among these flights" if estimates.variation_known.any() else ""
    pairs = zip(estimates.names, estimates.variation_known, strict=True)
    unknown = [name for name, known in pairs if variation_clause and not known]
    exception = f". The variation is unknown for {', '.join(unknown)}" if unknown else ""
    distributions = (
        f"Each distribution describes the uncertainty of a parameter{variation_clause}{exception}. Fields that share a"
        " variable are correlated."
    )
    not_identified = [f"{name} is not identified: {reason}" for name, reason in estimates.not_identified.items()]
    return [f"Identified from {', '.join(logs)}. {distributions}", *not_identified]


def _wrapped(paragraphs: list[str], width: int = _COMMENT_WIDTH) -> str:
    lines: Iterator[str] = (line for text in paragraphs for line in textwrap.wrap(text, width, break_long_words=False))
    return "\n".join(lines)


def _commented(node: Any, indent: int) -> Any:
    """Return mappings and lists of entries as YAML with comments. A list without comments is written on one line."""
    if isinstance(node, _Entry):
        return _yaml_node(node.value)
    is_mapping = isinstance(node, dict)
    items = dict(node.items() if is_mapping else enumerate(node))
    values = {key: _commented(item, indent + 2) for key, item in items.items()}
    container = CommentedMap(values) if is_mapping else CommentedSeq(values.values())
    comments = {key: item.comment for key, item in items.items() if isinstance(item, _Entry) and item.comment}
    for key, comment in comments.items():
        container.yaml_set_comment_before_after_key(key, before=_wrapped([comment]), indent=indent)
    if not is_mapping and not comments:
        container.fa.set_flow_style()
    return container


def _yaml_node(value: Any) -> Any:
    """Return a number, or a distribution whose innermost mapping is written on one line."""
    if not isinstance(value, dict):
        return value
    mapping = CommentedMap({key: _yaml_node(each) for key, each in value.items()})
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
