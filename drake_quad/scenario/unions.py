"""Unions of the scenario language to which members can be added.

The members of a union are models that `kind` tells apart. A member registers itself, and the language, its schema and
its documentation then contain it. Code outside the union does not ask for the kind of a member. It asks the questions
that the union's base class declares, and every member answers them.
"""

import importlib
import pkgutil
from collections.abc import Callable, Iterator
from typing import Annotated, Any, TypeVar, get_args

from pydantic import BeforeValidator, Field, GetCoreSchemaHandler
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema

from drake_quad.scenario.distributions import Model

_Member = TypeVar("_Member", bound=type[Model])


class OpenUnion:
    """Union of models with a field `kind`, used as the annotation `Annotated[Base, union]` of a field.

    Args:
        base: class that all members extend.
        questions: names of class attributes or fields that each member must define, since no default is safe. It must
            also define the abstract methods of the base class.
        silent: kind of a mapping that does not state its kind; None if every mapping must.
    """

    def __init__(self, base: type[Model], *questions: str, silent: str | None = None) -> None:
        self._base, self._questions, self.silent = base, questions, silent
        self._members: dict[str, type[Model]] = {}
        self._rebuilders: list[Callable[[], Any]] = []

    def __iter__(self) -> Iterator[type[Model]]:
        """Iterate over the members, in the order of their registration."""
        return iter(self._members.values())

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of the members, in the order of their registration."""
        return tuple(self._members)

    def get(self, kind: Any) -> Any:
        """Return the member of a kind; None if there is none."""
        return self._members.get(kind) if isinstance(kind, str) else None

    def member(self, model: _Member) -> _Member:
        """Register a model, as a decorator of its class.

        Raises:
            TypeError: if the model does not extend the base class, has no `kind`, or does not define what it must.
            ValueError: if another model has the same kind.
        """
        name = model.__name__
        if not issubclass(model, self._base):
            raise TypeError(f"{name} must extend {self._base.__name__}")
        fields: dict[str, FieldInfo] = model.model_fields  # type: ignore[call-overload]
        kinds = get_args(fields["kind"].annotation) if "kind" in fields else ()
        if len(kinds) != 1:
            raise TypeError(f'{name} must have a field kind of one word, as in kind: Literal["{name.lower()}"]')
        missing = [name for name in self._questions if not (name in fields or hasattr(model, name))]
        if missing := [*missing, *sorted(getattr(model, "__abstractmethods__", ()))]:
            raise TypeError(f"{name} must define {' and '.join(missing)}")
        (kind,) = kinds
        if self._members.get(kind, model).__qualname__ != model.__qualname__:
            raise ValueError(f"there is another {self._base.__name__} of kind {kind}: {self._members[kind].__name__}")
        self._members[kind] = model
        for rebuild in self._rebuilders:
            rebuild()
        return model

    def remove(self, kind: str) -> None:
        """Remove a member, such as one that was registered for a test."""
        del self._members[kind]
        for rebuild in self._rebuilders:
            rebuild()

    def rebuild(self, *models: type[Model]) -> None:
        """Name the models that contain the union, innermost first. They are built again for each further member."""
        self._rebuilders += [lambda model=model: model.model_rebuild(force=True) for model in models]  # type: ignore[misc]

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return the schema of the union of the members that are registered now."""
        union: Any = None
        for member in self:
            union = member if union is None else union | member
        return handler.generate_schema(Annotated[union, Field(discriminator="kind"), BeforeValidator(self._with_kind)])

    def _with_kind(self, value: Any) -> Any:
        """Return a mapping with the silent kind if it does not state its kind."""
        return {"kind": self.silent, **value} if self.silent and isinstance(value, dict) else value


def import_members(package: str, path: Any) -> None:
    """Import all modules of a package, so that the members in them are registered."""
    for module in pkgutil.iter_modules(path):
        importlib.import_module(f"{package}.{module.name}")
