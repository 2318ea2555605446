"""Extensible unions and extensible optional fields in the scenario language.

The members of a union are models that the field `kind` distinguishes. The members of open fields are the models of
these fields. Once a member has been registered, the language, its schema and its documentation contain it. Code outside
the union never tests the kind of a member. It calls methods that the common base class declares.
"""

import functools
import importlib
import operator
import pkgutil
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Set
from types import UnionType
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin

from pydantic import BeforeValidator, Field, GetCoreSchemaHandler
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema, PydanticCustomError

from drake_quad.errors import join_names
from drake_quad.scenario.distributions import Model, validation_error

_Member = TypeVar("_Member", bound=type[Model])


class _Members(ABC):
    """Models that extend a base class and are registered by name.

    Args:
        base: class that all members extend.
        fields: names of fields or class attributes that each member must define, in addition to the abstract methods
            of the base class and its class attributes without a value.
        default_kind: kind that is assumed for a mapping without `kind`; None if every mapping must give its kind.

    Attributes:
        members: members by name, in the order of their registration.
    """

    def __init__(self, base: type[Model], *fields: str, default_kind: str | None = None) -> None:
        self._base, self.default_kind = base, default_kind
        without_value = [
            name for name in base.__annotations__ if name in base.__class_vars__ and not hasattr(base, name)
        ]
        self._required_names = [*fields, *without_value]
        self.members: dict[str, type[Any]] = {}
        self._rebuilders: list[Callable[[], Any]] = []

    def get(self, name: Any) -> Any:
        """Return the member with a name, or None if there is no such member."""
        return self.members.get(name) if isinstance(name, str) else None

    def register(self, model: _Member) -> _Member:
        """Register a model, as a decorator of its class.

        Raises:
            TypeError: if the model does not extend the base class or does not define all required names.
            ValueError: if another model has the same name.
        """
        if not issubclass(model, self._base):
            raise TypeError(f"{model.__name__} must extend {self._base.__name__}")
        name, fields = self._name_of(model), getattr(model, "model_fields")  # noqa: B009
        missing = [each for each in self._required_names if not (each in fields or hasattr(model, each))]
        if missing := [*missing, *sorted(getattr(model, "__abstractmethods__", ()))]:
            raise TypeError(f"{model.__name__} must define {' and '.join(missing)}")
        if self.members.get(name, model).__qualname__ != model.__qualname__:
            raise ValueError(f"the name {name} of {model.__name__} is taken by {self.members[name].__name__}")
        self.members[name] = model
        self._rebuild()
        return model

    def remove(self, name: str) -> None:
        """Remove a member, such as one that was registered for a test."""
        del self.members[name]
        self._rebuild()

    def add_dependent_models(self, *models: type[Model]) -> None:
        """Add models to rebuild after each registration, since they contain the members; the innermost comes first."""
        self._rebuilders += [lambda model=model: model.model_rebuild(force=True) for model in models]  # type: ignore[misc]

    def _rebuild(self) -> None:
        for rebuild in self._rebuilders:
            rebuild()

    @abstractmethod
    def _name_of(self, model: type[Any]) -> str:
        """Return the name under which a model is registered."""


class OpenUnion(_Members):
    """Extensible union of models with a field `kind`, for the annotation `Annotated[Base, union]` of a field."""

    def _name_of(self, model: type[Any]) -> str:
        fields: dict[str, FieldInfo] = model.model_fields
        kinds = get_args(fields["kind"].annotation) if "kind" in fields else ()
        if len(kinds) != 1:
            name = model.__name__
            raise TypeError(f'{name} must have a field kind with one value, as in kind: Literal["{name.lower()}"]')
        return str(kinds[0])

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return the schema of the union of the currently registered members."""
        union = functools.reduce(operator.or_, self.members.values())
        return handler.generate_schema(Annotated[union, Field(discriminator="kind"), BeforeValidator(self._with_kind)])

    def _with_kind(self, value: Any) -> Any:
        """Add the default kind to a mapping that does not give its kind."""
        kinds = f"the kinds are {join_names([*self.members], 20)}"
        if isinstance(value, dict):
            if "kind" not in value and not self.default_kind:
                raise PydanticCustomError("kind_missing", "is missing; {kinds}", {"path": ("kind",), "kinds": kinds})
            return value if "kind" in value else {"kind": self.default_kind, **value}
        if not isinstance(value, Model):
            example = value if value in self.members else next(iter(self.members))
            raise validation_error(f"must be a mapping of fields, as in {{kind: {example}}}; {kinds}")
        return value


def alternatives(hint: Any, metadata: Iterable[Any]) -> tuple[Any, ...]:
    """Return the types that a field may have: the members of its union, or the annotated type if it has no union."""
    members = [member for union in metadata if isinstance(union, OpenUnion) for member in union.members.values()]
    return tuple(members) or (get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,))


class OpenFields(_Members):
    """Extensible set of optional model fields, which are None if they are not given.

    Each member defines the class attributes `field`, the field name, and `description`, the field description.
    """

    _taken: Set[str] = frozenset()

    def extend(self, model: type[Model]) -> None:
        """Add the fields to a model, now and whenever a further member is registered."""
        fields = self._taken = {*model.model_fields}

        def rebuild() -> None:
            for name in {*model.model_fields} - fields:
                del model.model_fields[name]
                delattr(model, name)
            for name, member in self.members.items():
                model.model_fields[name] = FieldInfo(
                    annotation=member | None,  # type: ignore[arg-type]
                    default=None,
                    description=member.description,
                )
                # Instances that were created before the registration lack the field.
                setattr(model, name, None)
            model.model_rebuild(force=True)

        rebuild()
        self._rebuilders.append(rebuild)

    def _name_of(self, model: type[Any]) -> str:
        name = getattr(model, "field", "")
        if name in self._taken:
            raise ValueError(f"the name {name} of {model.__name__} is taken by another field")
        return str(name)


def import_members(package: str, path: Any) -> None:
    """Import all modules of a package to register the members that they define."""
    for module in pkgutil.iter_modules(path):
        importlib.import_module(f"{package}.{module.name}")
