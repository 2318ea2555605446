"""Reading of the files of a scenario, and of the scenarios that it extends."""

import os
from collections.abc import Iterator
from pathlib import Path

from drake_quad.errors import InputError, did_you_mean, join_names, short_repr, shorten_text
from drake_quad.scenario.files.documents import parse_document
from drake_quad.scenario.files.layers import DEFAULT_VEHICLE, check_description, with_layer
from drake_quad.scenario.files.marked_tree import Mark, Tree
from drake_quad.scenario.files.piece_table import is_piece_table, parse_piece_table
from drake_quad.scenario.files.reading import read_text
from drake_quad.scenario.files.robot_files import robot_file_error
from drake_quad.scenario.files.shipped import shipped_file, unknown_name_message
from drake_quad.scenario.files.waypoint_table import parse_waypoint_table, scenario_name
from drake_quad.scenario.limits import MAX_BASES, MAX_BYTES, MAX_NODES

_SUFFIXES = (".yaml", ".yml", ".csv")


class Library:
    """Reader of the files of one scenario, with limits on their total size. Each file is read only once."""

    def __init__(self) -> None:
        self._bytes, self._nodes, self._bases = MAX_BYTES, MAX_NODES, MAX_BASES
        self._documents: dict[Path, Tree] = {}
        self._resolved: dict[str, Tree] = {}

    def find(self, spec: str | Path) -> tuple[str, Tree]:
        """Find a scenario and layer it over the scenarios that it extends.

        Args:
            spec: FILE, FILE:NAME if the file contains several scenarios, or the name of a shipped scenario (see
                `shipped`).

        Returns:
            The name of the scenario, and its tree without `extends`.

        Raises:
            InputError: if a file or name does not exist, a scenario extends itself, or the scenario exceeds a limit.
        """
        path, name = locate(str(spec))
        return self._resolve(path, name, Mark(str(spec), 0), ())

    def layers(self, extends: Tree) -> list[Tree]:
        """Return the scenarios that a field `extends` names, by the rules for the file that contains the field."""
        return [*self._extended(extends, Path(extends.mark.source), ("vehicles",))]

    def mapping(self, path: Path) -> Tree:
        """Read a file that contains a single mapping of fields instead of scenarios.

        Raises:
            InputError: if the file cannot be read or contains something else.
        """
        tree = self.parse(read_text(path, max_bytes=self._bytes), str(path), with_line_numbers=True)
        if not isinstance(tree.value, dict):
            raise InputError(f"{tree.mark}: must be a mapping of fields")
        return tree

    def pieces(self, path: Path) -> Tree:
        """Read a file of trajectory pieces; see `parse_piece_table`.

        Raises:
            InputError: if the file cannot be read or has another format.
        """
        text = read_text(path, max_bytes=self._bytes)
        self._bytes -= len(text)
        return parse_piece_table(text, path)

    def parse(self, text: str, source: str, *, with_line_numbers: bool) -> Tree:
        """Parse YAML text with `parse_document`, and count its size towards the limits of the scenario."""
        if len(text) > self._bytes:
            raise InputError(
                f"{Mark(source, 0)}: is too large: a scenario and all that it extends may have at most {MAX_BYTES:,}"
                " bytes"
            )
        # `parse_document` caches its results for the default limit. Only a document that exceeds the remaining limit is
        # parsed again, with this limit, to raise the error.
        document = parse_document(text, source, with_line_numbers=with_line_numbers)
        if document.nodes > self._nodes:
            document = parse_document(text, source, with_line_numbers=with_line_numbers, max_nodes=self._nodes)
        self._bytes -= len(text)
        self._nodes -= document.nodes
        return document.tree

    def count(self, mark: Mark) -> None:
        """Count a key or value that does not come from YAML towards the limits of the scenario.

        Raises:
            InputError: if the scenario has too many keys and values.
        """
        self._nodes -= 1
        if self._nodes < 0:
            raise InputError(
                f"{mark}: is too large: a scenario and all that it extends may have at most {MAX_NODES:,}"
                " keys and values"
            )

    def _document(self, path: Path) -> Tree:
        if path not in self._documents:
            text = read_text(path, max_bytes=self._bytes)
            if path.suffix == ".csv":
                self._bytes -= len(text)
                parse = _parse_trajectory if is_piece_table(text) else parse_waypoint_table
                self._documents[path] = parse(text, path)
            else:
                self._documents[path] = self.parse(text, str(path), with_line_numbers=True)
        return self._documents[path]

    def _resolve(self, path: Path, name: str | None, referrer: Mark, stack: tuple[str, ...]) -> tuple[str, Tree]:
        if stack and not os.path.isfile(path):  # noqa: PTH113 - Path.is_file raises where a name is too long
            raise InputError(f"{referrer}: extends {Mark(str(path), 0)}, which does not exist")
        scenarios = self._document(path).value
        file = Mark(str(path), 0)
        if not isinstance(scenarios, dict) or not scenarios:
            raise InputError(f"{file}: contains no scenario; the top-level keys of the file must be names of scenarios")
        if name is None:
            if len(scenarios) > 1:
                origin = "" if referrer == file else f"{referrer}: "
                # The referrer may be the short name of a shipped scenario instead of a path.
                shown_file = file if stack else str(referrer).removesuffix(":")
                names = join_names([*scenarios])
                raise InputError(
                    f"{origin}{file} contains several scenarios; choose one as {shown_file}:NAME from {names}"
                )
            name = next(iter(scenarios))
        if name not in scenarios:
            question = did_you_mean(name, scenarios, 1)
            raise InputError(
                f"{referrer}: there is no scenario {short_repr(name)} in {file}, which contains"
                f" {join_names([*scenarios])}{f'; {question}' if question else ''}"
            )
        identity = f"{os.path.realpath(path)}:{name}"
        if identity in stack:
            raise InputError(f"{referrer}: {shorten_text(name)} extends itself")
        if identity not in self._resolved:
            self._resolved[identity] = self._with_bases(path, name, scenarios[name], (*stack, identity))
        return name, self._resolved[identity]

    def _with_bases(self, path: Path, name: str, tree: Tree, stack: tuple[str, ...]) -> Tree:
        """Return one scenario of a file, layered over the scenarios that it extends."""
        if not isinstance(tree.value, dict):
            raise InputError(f"{tree.mark}: scenario {shorten_text(name)} must be a mapping of fields")
        document = Tree({key: value for key, value in tree.value.items() if key != "extends"}, tree.mark)
        if DEFAULT_VEHICLE in document.value:
            (default,) = self._extended(tree.value[DEFAULT_VEHICLE], path, stack)
            document.value[DEFAULT_VEHICLE] = default
        if "extends" not in tree.value:
            check_description(document)
            return document
        result: Tree | None = None
        for base in self._extended(tree.value["extends"], path, stack):
            result = base if result is None else with_layer(result, base)
        return document if result is None else with_layer(result, document)

    def _extended(self, names: Tree, path: Path, stack: tuple[str, ...]) -> Iterator[Tree]:
        """Yield the scenarios that one scenario of a file extends."""
        for spec in _bases(names):
            self._bases -= 1
            if self._bases < 0:
                raise InputError(f"{spec.mark}: extends too many scenarios; the limit is {MAX_BASES}")
            base_path, base_name = _base(spec, path, self._document(path))
            yield self._resolve(base_path, base_name, spec.mark, stack)[1]


def _base(spec: Tree, path: Path, document: Tree) -> tuple[Path, str | None]:
    """Return the path of the file and the name of a scenario that another scenario extends.

    A file name is relative to the folder of the file with `extends`. A name without a file suffix is a scenario in the
    same file or, if there is none, a shipped scenario.

    Args:
        spec: text in `extends` that names the scenario.
        path: path of the file with `extends`.
        document: content of the file with `extends`.
    """
    file, name = split_spec(spec.value)
    if file.endswith(_SUFFIXES):
        return path.parent / file, name
    if file not in document.value and (flaw := robot_file_error(file)):
        raise InputError(f"{spec.mark}: extends {short_repr(file)}, which {flaw}")
    may_be_in_file = ":" not in file and "/" not in file
    if may_be_in_file and file in document.value:
        return path, file
    shipped = _shipped(file)
    if shipped is not None:
        return shipped
    if may_be_in_file:
        return path, file
    raise InputError(f"{spec.mark}: extends {unknown_name_message(file)}")


def _parse_trajectory(text: str, path: Path) -> Tree:
    """Convert a table of pieces to a document with one scenario, which is named after the file and has only a route."""
    pieces = parse_piece_table(text, path)
    route = {"kind": Tree("trajectory", pieces.mark), "pieces": pieces}
    scenario = Tree({"route": Tree(route, pieces.mark)}, pieces.mark)
    return Tree({scenario_name(path): scenario}, pieces.mark)


def locate(spec: str) -> tuple[Path, str | None]:
    """Return the path of the file that a spec names, and the name of the scenario in the file if the spec has one.

    Raises:
        InputError: if the spec names neither a scenario file nor a shipped scenario, or names a robot file such as a
            URDF.
    """
    file, name = split_spec(spec)
    if flaw := robot_file_error(file):
        raise InputError(f"{Mark(file, 0)}: {flaw}")
    if file.endswith(_SUFFIXES) or os.path.isfile(file):  # noqa: PTH113 - Path.is_file raises where a name is too long
        return Path(file), name
    shipped = _shipped(file)
    if shipped is not None:
        return shipped
    if os.path.exists(file):  # noqa: PTH110 - as above
        return Path(file), name
    raise InputError(unknown_name_message(file))


def is_shipped(spec: str) -> bool:
    """Return whether a spec names a shipped scenario instead of a file."""
    return not split_spec(spec)[0].endswith(_SUFFIXES) and not os.path.isfile(spec) and _shipped(spec) is not None  # noqa: PTH113 - as above


def _shipped(spec: str) -> tuple[Path, str | None] | None:
    file, _, name = spec.partition(":")
    path = shipped_file(file)
    return None if path is None else (path, name or None)


def split_spec(spec: str) -> tuple[str, str | None]:
    """Split FILE or FILE:NAME into the file and the name, which is None for FILE."""
    path, separator, name = spec.rpartition(":")
    if separator and path.endswith(_SUFFIXES):
        return path, name
    return spec, None


def _bases(tree: Tree) -> list[Tree]:
    bases = tree.value if isinstance(tree.value, list) else [tree]
    if not bases or not all(isinstance(base.value, str) and base.value for base in bases):
        raise InputError(f"{tree.mark}: extends must be FILE, FILE:NAME or NAME of a scenario, or a list of these")
    return bases
