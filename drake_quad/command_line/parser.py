"""Command-line parser that reports a mistake in one sentence, with the nearest valid name."""

import argparse
import sys
from collections.abc import Iterable
from typing import Any, NoReturn

from drake_quad.errors import InputError, did_you_mean, lookup, short_repr, shorten_text


class Parser(argparse.ArgumentParser):
    """Command-line parser with short error messages.

    After a mistake, argparse prints all options of the command, but this parser prints one sentence.
    """

    def parse_args(self, args: Iterable[str] | None = None, namespace: Any = None) -> Any:
        """Return the values of the arguments; exit with status 2 and an error message if they are wrong."""
        arguments, unknown = self.parse_known_args(args, namespace)
        if unknown:
            self._refuse(unknown)
        return arguments

    def parse_known_args(self, args: Iterable[str] | None = None, namespace: Any = None) -> Any:
        """Return the values of known arguments, and the unknown arguments; exit if one of these begins with two dashes.

        A misspelt option is reported before anything else, such as a missing argument. An empty argument, which a shell
        passes for a variable without a value, is refused: as a path, it would mean the current folder.
        """
        given = sys.argv[1:] if args is None else [*args]
        for i, each in enumerate(given):
            if not each or (each.startswith("--") and each.endswith("=")):
                name = each or (given[i - 1] if i and given[i - 1].startswith("-") else "an argument")
                self.error(f"{name.removesuffix('=')} is empty; was a shell variable without a value used?")
        options = given[: given.index("--")] if "--" in given else given
        self._refuse([each for each in options if each.startswith("--") and not self._is_option(each)])
        return super().parse_known_args(given, namespace)

    def error(self, message: str) -> NoReturn:
        """Exit with status 2 and a message."""
        self.exit(2, f"error: {message.removeprefix('argument ')}\n")

    def _print_message(self, message: str, file: Any = None) -> None:
        """Print a message; raise OSError if the standard output cannot be written, which argparse ignores."""
        if message and file is not None and file is sys.stdout:
            file.write(message)
        else:
            super()._print_message(message, file)

    def _is_option(self, argument: str) -> bool:
        """Return whether an argument is an option or an abbreviated option."""
        name = argument.partition("=")[0]
        return any(option.startswith(name) for option in self._option_string_actions)

    def _refuse(self, unknown: Iterable[str]) -> None:
        """Exit with an error message about the first unknown option, or else the first unknown argument."""
        for argument in sorted(unknown, key=lambda each: not each.startswith("-")):
            name, advice = argument.partition("=")[0], f"`{self.prog} --help` describes all arguments"
            if not name.startswith("-"):
                self.error(f"{self.prog} does not take the argument {short_repr(argument)}; {advice}")
            question = did_you_mean(name, self._option_string_actions, 1)
            self.error(f"{self.prog} has no option {shorten_text(name)}; {question or advice}")

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Exit with an error message that suggests the nearest choice, unless a value is one of the choices."""
        if action.choices is None or value in action.choices:
            return
        kind = f"value of {action.option_strings[-1]}" if action.option_strings else action.dest
        try:
            lookup({str(choice): choice for choice in action.choices}, str(value), kind)
        except InputError as error:
            self.error(str(error))
