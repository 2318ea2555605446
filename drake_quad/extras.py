"""Libraries that not everybody needs: the extras of the package."""

from importlib import import_module
from typing import Any


def needed(module: str, extra: str) -> Any:
    """Return a module of an extra.

    Args:
        module: its name.
        extra: of the package, that has it.

    Raises:
        ImportError: it is not installed.
    """
    try:
        return import_module(module)
    except ImportError as error:
        library = module.partition(".")[0]
        if error.name is None or error.name.partition(".")[0] != library:
            raise
        raise ImportError(
            f"{library} is not installed; pip install 'drake_quad[{extra}]' has it", name=library
        ) from None
