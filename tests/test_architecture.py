"""Tests of the folder table in CONTRIBUTING.md, of the command table in README.md, and of the direction of imports."""

import ast
import functools
import re
from collections import defaultdict
from pathlib import Path

import pytest

from drake_quad.command_line.main import COMMANDS

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "drake_quad"
# Rows of the table: | level | `folder/` | contents |
ROW_PATTERN = re.compile(r"^\| (\d+) \| `(\w+)/` \| (.+) \|$", re.MULTILINE)
LEVELS = {folder: int(level) for level, folder, _ in ROW_PATTERN.findall((ROOT / "CONTRIBUTING.md").read_text())}
# Modules outside the folders are at level 0, except for these modules, which may import from all folders.
TOP_MODULES = ("__init__", "__main__", "testing")


def folder_of(module):
    """Return the folder of a module, or its own name if it is not in a folder."""
    return module.removeprefix("drake_quad").lstrip(".").partition(".")[0] or "__init__"


def level_of(module):
    folder = folder_of(module)
    return LEVELS.get(folder, max(LEVELS.values()) + 1 if folder in TOP_MODULES else 0)


def imported_modules(path):
    """Return the modules of the package that a file imports, including imports inside functions."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module:
            submodules = [f"{node.module}.{alias.name}" for alias in node.names]
            names |= {name if is_module(name) else node.module for name in submodules}
        elif isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
    return {name for name in names if name.partition(".")[0] == "drake_quad"}


def is_module(name):
    path = ROOT.joinpath(*name.split("."))
    return path.is_dir() or path.with_suffix(".py").is_file()


@functools.cache
def imports():
    """Return the imports of each module of the package."""
    modules = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        name = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        modules[name] = imported_modules(path)
    return modules


def test_the_folder_table_repeats_the_docstring_of_each_folder():
    rows = {folder: contents for _, folder, contents in ROW_PATTERN.findall((ROOT / "CONTRIBUTING.md").read_text())}
    docstrings = {
        path.parent.name: ast.get_docstring(ast.parse(path.read_text())).partition("\n")[0].rstrip(".")
        for path in PACKAGE.glob("*/__init__.py")
    }
    assert rows == docstrings


@pytest.mark.long
def test_folders_import_only_from_folders_at_lower_levels():
    """Folders at the same level must not import each other either."""
    # Imports of the package itself are allowed, since they only read its version.
    upward = [
        (module, target)
        for module, targets in imports().items()
        for target in targets - {"drake_quad"}
        if folder_of(module) != folder_of(target) and level_of(target) >= level_of(module) > 0
    ]
    assert not upward


@pytest.mark.long
def test_modules_of_the_top_folder_do_not_import_subfolders():
    upward = [
        (module, target)
        for module, targets in imports().items()
        for target in targets
        if level_of(module) == 0 and level_of(target) > 0
    ]
    assert not upward


@pytest.mark.long
def test_imports_of_modules_contain_no_cycle():
    remaining = imports()
    while free := [module for module, targets in remaining.items() if not targets & remaining.keys()]:
        for module in free:
            del remaining[module]
    users = defaultdict(set)
    for module, targets in remaining.items():
        for target in targets & remaining.keys():
            users[target].add(module)
    in_cycles = {module: targets & remaining.keys() for module, targets in remaining.items() if users[module]}
    assert not in_cycles


def test_the_readme_lists_each_command_once():
    _, _, after = (ROOT / "README.md").read_text().partition("| `drake-quad` |")
    table, _, _ = after.partition("\n\n")
    listed = [name for row in table.split("\n")[2:] for name in re.findall(r"`([\w-]+)`", row.split("|")[1])]
    assert sorted(listed) == sorted(COMMANDS)
