"""Documentation pages with the arguments of all commands, and with the functions that formulas can call."""

import argparse
import inspect
import re
from typing import Any

from drake_quad.command_line.main import COMMANDS, COMMANDS_BY_PURPOSE, command_module
from drake_quad.framework import elementary
from drake_quad.framework.replacements import names_and_replacements

_GENERATED_PART_MARK = "<!-- What follows is written by scripts/development/document_scenarios.py. -->\n"


def command_page(page: str) -> str:
    """Return the page on the command line with an updated generated part.

    Args:
        page: current text of the page. The generated part follows the line `_GENERATED_PART_MARK`.
    """
    parts = []
    for purpose, commands in COMMANDS_BY_PURPOSE.items():
        parts.append(f"\n## {purpose.capitalize()}\n")
        parts += [f"\n### {name}\n{_section(name, command_module(name).options())}" for name in commands]
    return _updated(page, "".join(parts))


def formula_page(page: str) -> str:
    """Return the page on formulas with an updated generated part: its functions, and replacements for NumPy functions.

    Args:
        page: current text of the page, as in `command_page`.
    """
    functions = [
        f"| `{name}{_short_signature(function)}` | {_cell(_first_line(function))} |"
        for name, function in vars(elementary).items()
        if inspect.isfunction(function) and function.__module__ == elementary.__name__ and not name.startswith("_")
    ]
    replacements = [
        "| {} | `{}` |".format(", ".join(f"`{name}`" for name in names), expression.replace("|", r"\|"))
        for names, expression in names_and_replacements()
        if not all(hasattr(elementary, name) for name in names)
    ]
    lines = [
        *("", "## Functions of `drake_quad.framework.elementary`", "", "| function | |", "|---|---|", *functions, ""),
        "## Replacements for functions of NumPy and `math`",
        "",
        "`x` and `y` are rows, and `v` is a list of rows. The functions above have the same names in NumPy.",
        *("", "| function | in a formula |", "|---|---|", *replacements, ""),
    ]
    return _updated(page, "\n".join(lines))


def _updated(page: str, text: str) -> str:
    """Return a page with a new text after the line `_GENERATED_PART_MARK`."""
    before, mark, _ = page.partition(_GENERATED_PART_MARK)
    return before + mark + text


def _short_signature(function: Any) -> str:
    """Return the arguments of a function with their default values, without types."""
    signature = inspect.signature(function)
    parameters = [each.replace(annotation=inspect.Parameter.empty) for each in signature.parameters.values()]
    return str(signature.replace(parameters=parameters, return_annotation=inspect.Signature.empty))


def _first_line(function: Any) -> str:
    """Return the first line of a docstring, without the full stop at its end."""
    first, *_ = (inspect.getdoc(function) or "").splitlines()
    return first.removesuffix(".")


def _section(name: str, parser: argparse.ArgumentParser) -> str:
    """Return the description of a command in Markdown: its purpose, its arguments, and an example."""
    formatter = parser._get_formatter()
    rows = []
    for action in parser._actions:
        if isinstance(action, argparse._HelpAction):
            continue
        value = "" if action.nargs == 0 else formatter._format_args(action, action.dest.upper()).replace(",", ", ")
        names = " ".join([", ".join(action.option_strings), value]).strip() or action.dest
        words = formatter._expand_help(action)
        rows.append(f"| {_cell(f'`{names}`')} | {_cell(words)} |")
    example = re.sub(r"^examples?: ", "", parser.epilog or "")
    table = ["| argument | |", "|---|---|", *rows]
    return "\n".join(["", parser.description or COMMANDS[name], "", *table, "", "```text", example, "```", ""])


def _cell(text: str) -> str:
    """Return a text as a cell of a Markdown table, with special characters escaped."""
    return text.replace("|", r"\|").replace("\n", " ").replace("<", "&lt;")
