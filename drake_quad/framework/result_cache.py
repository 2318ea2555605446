"""On-disk cache of results that take seconds to compute, in the folder of `code_cache`.

The key of a result is a digest of the function, its arguments, the sources of this package, the versions of the
libraries and the processor. After any change of these, the result is computed again. The result for a
model whose class is the user's code is not cached, since the key does not contain that code.
"""

import functools
import hashlib
import io
import pickle
import platform
import time
from collections.abc import Callable
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from llvmlite import binding as llvm
from pydantic import BaseModel

from drake_quad.framework import code_cache

_Arguments = ParamSpec("_Arguments")
_Value = TypeVar("_Value")
_PACKAGE = Path(__file__).parent.parent
_LIBRARIES = ("drake", "numpy", "scipy")  # libraries whose versions can affect results
# Time, s, after which edited sources may differ from the modules that this process has imported.
_START_TIME = time.time()


def cached_on_disk(
    function: Callable[_Arguments, _Value], *arguments: _Arguments.args, **named: _Arguments.kwargs
) -> _Value:
    """Return the result of a pure function, from the disk if it was computed before with equal arguments.

    Exceptions are not cached. If the cache is not available, the function is called.

    Args:
        function: function of this package whose result can be pickled and depends only on its arguments.
        arguments: positional arguments, which can be pickled.
        named: keyword arguments, which can be pickled.
    """
    program = _program()
    if program is None:
        return function(*arguments, **named)
    identity = _identity((program, function.__module__, function.__qualname__, arguments, named))
    if identity is None:
        return function(*arguments, **named)
    name = f"result_{hashlib.sha256(identity).hexdigest()[:32]}"
    cached = code_cache.read(name)
    if cached is not None:
        value: _Value = pickle.loads(cached)
        return value
    value = function(*arguments, **named)
    code_cache.write(name, pickle.dumps(value))
    return value


class _IdentityPickler(pickle.Pickler):
    """Pickler whose output is the same in every process for equal values.

    Pydantic pickles the names of the given fields as a set, whose order differs between processes. In models, only the
    values of the fields are therefore pickled.
    """

    def reducer_override(self, value: Any) -> Any:
        """Return what is pickled instead of a model; for other values, the default applies."""
        if not isinstance(value, BaseModel):
            return NotImplemented
        kind = type(value)
        if kind.__module__.partition(".")[0] != __name__.partition(".")[0]:
            raise pickle.PicklingError(f"{kind.__qualname__} is the user's code")
        return tuple, ((kind.__qualname__, *((name, getattr(value, name)) for name in kind.model_fields)),)


def _identity(value: Any) -> bytes | None:
    """Return bytes that are equal for equal values; None for a value that contains code of the user."""
    buffer = io.BytesIO()
    pickler = _IdentityPickler(buffer, protocol=pickle.HIGHEST_PROTOCOL)
    # In the fast mode, pickle writes a repeated object in full again. The bytes then depend only on the values.
    pickler.fast = True
    try:
        pickler.dump(value)
    except (pickle.PicklingError, AttributeError, TypeError):
        return None
    return buffer.getvalue()


@functools.cache
def _program() -> tuple[Any, ...] | None:
    """Return everything except for arguments on which results depend; None if it cannot be determined."""
    digest, sources = hashlib.sha256(), sorted(_PACKAGE.rglob("*.py"))
    with suppress(OSError):
        # If the package is in an archive, its sources cannot be read.
        if not sources or max(source.stat().st_mtime for source in sources) > _START_TIME:
            return None
        for source in sources:
            digest.update(f"{source.relative_to(_PACKAGE)}\0".encode() + source.read_bytes())
        processor = llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()
        libraries = tuple([version(name) for name in _LIBRARIES])
        return (digest.hexdigest(), libraries, platform.python_version(), platform.platform(), processor)
    return None
