"""Import of optional libraries, which pip installs with the extras of the package."""

from importlib import import_module
from typing import Any


class MissingLibraryError(ImportError):
    """Error for an optional library that is not installed. The message says how to install it."""


def import_extra(module: str, extra: str) -> Any:
    """Import a module of an optional library and return it.

    Args:
        module: name of the module.
        extra: name of the extra of drake_quad that installs the library.

    Raises:
        MissingLibraryError: if the library is not installed.
    """
    try:
        return import_module(module)
    except ImportError as error:
        library = module.partition(".")[0]
        if error.name is None or error.name.partition(".")[0] != library:
            raise
        raise MissingLibraryError(
            f"{library} is not installed; install it with: pip install 'drake_quad[{extra}]'"
        ) from None
