"""Unions and optional fields of the scenario language to which members can be added.

The members of a union are models that `kind` tells apart. The members of open fields are the models of these fields. A
member registers itself, and the language, its schema and its documentation then contain it. Code outside the union does
not ask for the kind of a member. It asks the questions that the base class of all members declares, and every member
answers them.
"""

import importlib
import pkgutil
from collections.abc import Callable, ItemsView, Iterator
from typing import Annotated, Any, TypeVar, get_args

from pydantic import Field, GetCoreSchemaHandler
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema

from drake_quad.scenario.distributions import Model

_Member = TypeVar("_Member", bound=type[Model])


class _Members:
    """Models that extend a base class and are registered by name."""

    def __init__(self, base: type[Model], *questions: str) -> None:
        self._base, self._questions = base, questions
        self._members: dict[str, type[Model]] = {}
        self._rebuilders: list[Callable[[], Any]] = []

    def __iter__(self) -> Iterator[type[Any]]:
        """Iterate over the members, in the order of their registration."""
        return iter(self._members.values())

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the members, in the order of their registration."""
        return tuple(self._members)

    def items(self) -> ItemsView[str, type[Any]]:
        """Return the members with their names, in the order of their registration."""
        return self._members.items()

    def remove(self, name: str) -> None:
        """Remove a member, such as one that was registered for a test."""
        del self._members[name]
        self._rebuild()

    def rebuild(self, *models: type[Model]) -> None:
        """Name the models that contain the members, innermost first. They are built again for each further member."""
        self._rebuilders += [lambda model=model: model.model_rebuild(force=True) for model in models]  # type: ignore[misc]

    def _rebuild(self) -> None:
        for rebuild in self._rebuilders:
            rebuild()

    def _check_base(self, model: type[Model]) -> None:
        if not issubclass(model, self._base):
            raise TypeError(f"{model.__name__} must extend {self._base.__name__}")

    def _register(self, name: str, model: type[Model], of_name: str) -> None:
        missing = [question for question in self._questions if not hasattr(model, question)]
        if missing := [*missing, *sorted(getattr(model, "__abstractmethods__", ()))]:
            raise TypeError(f"{model.__name__} must define {' and '.join(missing)}")
        if self._members.get(name, model).__qualname__ != model.__qualname__:
            raise ValueError(f"there is another {self._base.__name__} {of_name}: {self._members[name].__name__}")
        self._members[name] = model
        self._rebuild()


class OpenUnion(_Members):
    """Union of models with a field `kind`, used as the annotation `Annotated[Base, union]` of a field.

    Args:
        base: class that all members extend.
        questions: names of class attributes that each member must define, since no default is safe. It must also define
            the abstract methods of the base class.
    """

    def member(self, model: _Member) -> _Member:
        """Register a model, as a decorator of its class.

        Raises:
            TypeError: if the model does not extend the base class, has no `kind`, or does not define what it must.
            ValueError: if another model has the same kind.
        """
        self._check_base(model)
        fields: dict[str, FieldInfo] = model.model_fields  # type: ignore[call-overload]
        kinds = get_args(fields["kind"].annotation) if "kind" in fields else ()
        if len(kinds) != 1:
            name = model.__name__
            raise TypeError(f'{name} must have a field kind of one word, as in kind: Literal["{name.lower()}"]')
        self._register(kinds[0], model, f"of kind {kinds[0]}")
        return model

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return the schema of the union of the members that are registered now."""
        union: Any = None
        for member in self:
            union = member if union is None else union | member
        return handler.generate_schema(Annotated[union, Field(discriminator="kind")])


class OpenFields(_Members):
    """Optional fields of a model, to which further ones can be added. A field that is not given is None.

    Args:
        base: class that the models of all fields extend.
        questions: names of class attributes that each model must define, since no default is safe. It must also define
            the abstract methods of the base class.
    """

    def __init__(self, base: type[Model], *questions: str) -> None:
        super().__init__(base, *questions)
        self._descriptions: dict[str, str] = {}
        self._extended: type[Model] | None = None

    def field(self, name: str, description: str) -> Callable[[_Member], _Member]:
        """Return a decorator that registers a model as that of a field.

        Args:
            name: name of the field.
            description: description of the field in the documentation.

        Raises:
            TypeError: if the model does not extend the base class or does not define what it must.
            ValueError: if another model has the same field.
        """

        def registered(model: _Member) -> _Member:
            self._check_base(model)
            own = self._extended is not None and name in self._extended.model_fields and name not in self._members
            if own:
                raise ValueError(f"there is another field {name}")
            self._descriptions[name] = description
            self._register(name, model, f"in the field {name}")
            return model

        return registered

    def extend(self, model: type[Model]) -> None:
        """Add the fields to a model, now and whenever another one is registered."""
        self._extended = model
        self._rebuild()

    def _rebuild(self) -> None:
        if self._extended is None:
            return
        fields = self._extended.model_fields
        for name in self._descriptions.keys() - self._members.keys():
            fields.pop(name, None)
        for name, member in self.items():
            fields[name] = FieldInfo(annotation=member | None, default=None, description=self._descriptions[name])  # type: ignore[arg-type]
        self._extended.model_rebuild(force=True)
        super()._rebuild()


def import_members(package: str, path: Any) -> None:
    """Import all modules of a package, so that the members in them are registered."""
    for module in pkgutil.iter_modules(path):
        importlib.import_module(f"{package}.{module.name}")
