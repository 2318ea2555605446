"""Documentation page with the arguments of all commands."""

import argparse
import re

from drake_quad.command_line.main import COMMANDS, COMMANDS_BY_PURPOSE, module_of

_MARK = "<!-- What follows is written by scripts/development/document_scenarios.py. -->\n"


def command_page(page: str) -> str:
    """Return the page on the command line with an updated generated part.

    Args:
        page: current text of the page. The generated part follows the line `_MARK`.
    """
    before, mark, _ = page.partition(_MARK)
    parts = []
    for purpose, commands in COMMANDS_BY_PURPOSE.items():
        parts.append(f"\n## {purpose.capitalize()}\n")
        parts += [f"\n### {name}\n{_section(name, module_of(name).options())}" for name in commands]
    return before + mark + "".join(parts)


def _section(name: str, parser: argparse.ArgumentParser) -> str:
    """Return the description of a command in Markdown: its purpose, its arguments, and an example."""
    formatter = parser._get_formatter()
    rows = []
    for action in parser._actions:
        if isinstance(action, argparse._HelpAction):
            continue
        value = "" if action.nargs == 0 else formatter._format_args(action, action.dest.upper()).replace(",", ", ")
        names = " ".join([", ".join(action.option_strings), value]).strip() or action.dest
        words = formatter._expand_help(action) if action.help else ""
        rows.append(f"| {_cell(f'`{names}`')} | {_cell(words)} |")
    example = re.sub(r"^examples?: ", "", parser.epilog or "")
    table = ["| argument | |", "|---|---|", *rows]
    return "\n".join(["", parser.description or COMMANDS[name], "", *table, "", "```text", example, "```", ""])


def _cell(text: str) -> str:
    """Return a text in which characters are escaped that a cell of a Markdown table cannot contain."""
    return text.replace("|", r"\|").replace("\n", " ").replace("<", "&lt;")
