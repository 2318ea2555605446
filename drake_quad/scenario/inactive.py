"""Inactive settings: settings without effect on the flight, because another setting is zero, missing or different.

Two declarations of a mapping describe the conditions. The annotation `needs` of a field names the fields on which it
depends, and `strength_fields` names the fields of which one must differ from zero. The method `inactive_settings` of
the mapping checks other conditions. `drake_quad.flight.remarks` collects these settings.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol


class InactiveSetting(NamedTuple):
    """Setting without an effect on the flight.

    Attributes:
        path: path of the field or the mapping in the scenario.
        reason: clause that names the setting responsible, such as `vehicle.rotor_inertia is 0`.
    """

    path: str
    reason: str


class FlightConditions(Protocol):
    """Properties of a flight on which the effect of a setting can depend."""

    @property
    def scenario(self) -> Any:
        """Scenario that is flown."""

    @property
    def end(self) -> float:
        """Time at which the flight ends, s; infinite if it is unknown."""

    @property
    def lowest_height(self) -> float:
        """Smallest height of the reference, m; minus infinity if it is unknown."""


@dataclass(frozen=True)
class Needs:
    """Condition under which a field has an effect, as metadata of its annotation.

    Attributes:
        fields: names of fields of the same mapping, one of which must be given and differ from zero.
        value: value that one of the fields must have; None if a value different from zero suffices.
    """

    fields: tuple[str, ...]
    value: str | None = None

    def unmet(self, mapping: Any) -> tuple[str, ...]:
        """Return the names of the fields that do not meet the condition; empty if one field meets it."""
        values = [getattr(mapping, name) for name in self.fields]
        is_met = self.value in values if self.value is not None else any(map(can_have_effect, values))
        return () if is_met else self.fields


def needs(*fields: str, value: str | None = None) -> Needs:
    """Return the condition under which a field has an effect.

    Without `value`, at least one of the named fields must differ from zero. With `value`, at least one of them must
    have this value.
    """
    return Needs(fields, value)


def can_have_effect(value: Any) -> bool:
    """Return whether a value in a scenario can have an effect, that is, is not missing, false, empty or zero.

    A mapping can have an effect if one of its `strength_fields` can, or if it has no `strength_fields`.
    """
    if hasattr(value, "strength_fields"):
        return not value.strength_fields or any(can_have_effect(getattr(value, name)) for name in value.strength_fields)
    if isinstance(value, tuple):
        return any(map(can_have_effect, value))
    if isinstance(value, bool | int | float | Mapping):
        return bool(value)
    return value is not None


def declared_inactive_settings(mapping: Any, path: str) -> Iterator[InactiveSetting]:
    """Yield the settings of a mapping that are inactive according to its declarations.

    Only fields that differ from their defaults are reported, because saved scenarios contain all fields.
    """
    if not can_have_effect(mapping):
        yield InactiveSetting(path, _reason(mapping, mapping.strength_fields, path))
        return
    for name, field in type(mapping).model_fields.items():
        for condition in field.metadata:
            if isinstance(condition, Needs) and is_set(mapping, name) and (unmet := condition.unmet(mapping)):
                yield InactiveSetting(f"{path}.{name}", _reason(mapping, unmet, path))


def is_set(mapping: Any, name: str) -> bool:
    """Return whether the value of a field differs from its default."""
    field = type(mapping).model_fields[name]
    return bool(field.is_required() or getattr(mapping, name) != field.get_default(call_default_factory=True))


def late_setting(mapping: Any, name: str, flight: FlightConditions, path: str) -> Iterator[InactiveSetting]:
    """Yield a field that contains a time, if this time is certain to be after the end of the flight.

    Args:
        mapping: mapping of a scenario.
        name: name of the field with the time, s.
        flight: properties of the flight.
        path: path of the mapping in the scenario.
    """
    value: Any = getattr(mapping, name)
    earliest = value if value is None or isinstance(value, float) else value.extremes()[0]
    if earliest is not None and earliest > flight.end:
        yield InactiveSetting(f"{path}.{name}", f"the flight ends at {flight.end:.2f} s, before {earliest:g} s")


def _reason(mapping: Any, fields: tuple[str, ...], path: str) -> str:
    """Return a clause that names the fields that make a setting inactive, and their values.

    Fields that are None are left out. If all fields are None, the clause says that they are not given.
    """
    specified = [name for name in fields if getattr(mapping, name) is not None]
    if not specified:
        return f"{_joined(fields, path)} {'is' if len(fields) == 1 else 'are'} not given"
    texts = {_text(getattr(mapping, name)) for name in specified}
    return (
        f"{_joined(specified, path)} {'is' if len(specified) == 1 else 'are'}"
        f" {texts.pop() if len(texts) == 1 else 'zero'}"
    )


def _joined(names: Any, path: str) -> str:
    return " and ".join(f"{path}.{name}" for name in names)


def _text(value: Any) -> str:
    if isinstance(value, tuple):
        return "[" + ", ".join(f"{each:g}" for each in value) + "]"
    return f"{value:g}" if isinstance(value, float) else "empty" if isinstance(value, Mapping) else str(value)
