"""Units and bounds that the fields of the scenario language declare for their quantities."""

from collections.abc import Iterator, Sequence
from typing import Annotated, Any, NamedTuple, get_args, get_origin

from drake_quad.scenario.description import unit_from_description
from drake_quad.scenario.distributions import Model, is_number_or_distribution
from drake_quad.scenario.limits import MAX_MAGNITUDE
from drake_quad.scenario.quantities import Rule
from drake_quad.scenario.unions import alternatives


class Declaration(NamedTuple):
    """Declared unit and bounds of a quantity: a number or a list of numbers, each of which may be a distribution.

    Attributes:
        unit: unit of the quantity; "1" for a ratio or a count.
        lower: smallest number that the language allows.
        upper: largest number that the language allows.
        needs_min: whether a normal distribution needs a lower limit.
        needs_max: whether a normal distribution needs an upper limit.
        is_whole: whether numbers must be whole.
        items: number of items of a list; 0 for a single number.
    """

    unit: str
    lower: float
    upper: float
    needs_min: bool
    needs_max: bool
    is_whole: bool
    items: int = 0


def quantities_in(model: type[Model]) -> Iterator[tuple[str, Declaration]]:
    """Yield the path and the declaration of each quantity in a mapping and its nested mappings.

    Quantities in lists of mappings, such as the wind sources, are omitted.
    """
    for name, field in model.model_fields.items():
        for path, declaration in _quantities(field.annotation, field.metadata, field.description or ""):
            yield name + path, declaration


def _quantities(hint: Any, metadata: Sequence[Any], description: str) -> Iterator[tuple[str, Declaration]]:
    """Yield the path and the declaration of each quantity in a type hint.

    The path is empty if the hint itself is a quantity, and ".field" for a field of a mapping.
    """
    if get_origin(hint) is Annotated:
        hint, *inner = get_args(hint)
        yield from _quantities(hint, [*inner, *metadata], description)
    elif is_number_or_distribution(hint):
        yield (
            "",
            _declaration(
                unit_from_description(description) or "1", [rule for rule in metadata if isinstance(rule, Rule)]
            ),
        )
    elif get_origin(hint) is tuple:
        items = get_args(hint)
        for path, declaration in _quantities(items[0], (), description) if Ellipsis not in items else ():
            if not path:
                yield path, declaration._replace(items=len(items))
    else:
        for choice in alternatives(hint, metadata):
            if isinstance(choice, type) and issubclass(choice, Model):
                yield from ((f".{path}", declaration) for path, declaration in quantities_in(choice))
            elif choice is not hint:
                yield from _quantities(choice, (), description)


def _declaration(unit: str, rules: Sequence[Rule]) -> Declaration:
    """Return the declaration of a single number, given its unit and its rules."""
    binding = [rule for rule in rules if not rule.applies_to_written_numbers]
    return Declaration(
        unit,
        max([-MAX_MAGNITUDE, *(rule.lower for rule in rules if rule.lower is not None)]),
        min([MAX_MAGNITUDE, *(rule.upper for rule in rules if rule.upper is not None)]),
        any(rule.lower is not None for rule in binding),
        any(rule.upper is not None for rule in binding),
        any(rule.is_whole for rule in rules),
    )
