"""On-disk cache of results that take seconds, in the folder of `code_cache` and by the same rules.

A result is found again by a digest of its function, its arguments, and everything that computes it: the sources of this
package, the libraries and the processor. So a result is never outdated when the package changes.
"""

import functools
import hashlib
import pickle
import platform
import time
from collections.abc import Callable
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from llvmlite import binding as llvm

from drake_quad.framework import code_cache

_Arguments = ParamSpec("_Arguments")
_Value = TypeVar("_Value")
_PACKAGE = Path(__file__).parent.parent
_LIBRARIES = ("drake", "numpy", "scipy")
# Sources that are edited later may differ from what this process has loaded.
_STARTED = time.time()


def kept(function: Callable[_Arguments, _Value], *arguments: _Arguments.args, **named: _Arguments.kwargs) -> _Value:
    """Return what a pure function returns, from the disk if it has been called with equal arguments before.

    Exceptions are not kept. If the cache cannot be used, the function is called.

    Args:
        function: function of this package whose result depends on nothing but its arguments.
        arguments: its arguments, which can be pickled, as can the result.
        named: its keyword arguments, likewise.
    """
    program = _program()
    if program is None:
        return function(*arguments, **named)
    identity = pickle.dumps((program, function.__module__, function.__qualname__, arguments, named))
    name = f"result_{hashlib.sha256(identity).hexdigest()[:32]}"
    found = code_cache.read(name)
    if found is not None:
        value: _Value = pickle.loads(found)
        return value
    value = function(*arguments, **named)
    code_cache.write(name, pickle.dumps(value))
    return value


@functools.cache
def _program() -> tuple[Any, ...] | None:
    """Return everything besides arguments that results depend on; None if it is not known."""
    digest, sources = hashlib.sha256(), sorted(_PACKAGE.rglob("*.py"))
    with suppress(OSError):
        # A package inside of an archive has no sources that could be read.
        if not sources or max(source.stat().st_mtime for source in sources) > _STARTED:
            return None
        for source in sources:
            digest.update(f"{source.relative_to(_PACKAGE)}\0".encode() + source.read_bytes())
        processor = llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()
        libraries = tuple([version(name) for name in _LIBRARIES])
        return (digest.hexdigest(), libraries, platform.python_version(), platform.platform(), processor)
    return None
