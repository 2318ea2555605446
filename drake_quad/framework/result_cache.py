"""On-disk cache of results that take seconds to compute, in the folder of `code_cache`.

The key of a result is a digest of the function, its arguments, the sources of this package, the versions of the
libraries and the processor. If any of them changes, the result is computed again. A result that depends on a model
class in the user's code is not cached, since the key does not contain that code.
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
_PACKAGE_FOLDER = Path(__file__).parent.parent
_LIBRARIES = ("drake", "numpy", "scipy")  # libraries whose versions can affect results
# Start time of this process, s. Sources that were edited later may differ from the imported modules.
_START_TIME = time.time()


def cached_on_disk(
    function: Callable[_Arguments, _Value], *arguments: _Arguments.args, **named: _Arguments.kwargs
) -> _Value:
    """Return the result of a pure function, which is read from the disk if an earlier call had equal arguments.

    Exceptions are not cached. If the cache is not available, each call computes the result.

    Args:
        function: function of this package whose result can be pickled and depends only on its arguments.
        arguments: positional arguments, which can be pickled.
        named: keyword arguments, which can be pickled.
    """
    environment = _environment()
    if environment is None:
        return function(*arguments, **named)
    identity = _identity((environment, function.__module__, function.__qualname__, arguments, named))
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

    Pydantic pickles the names of the fields that were set explicitly as a Python set, whose order differs between
    processes. Therefore only the field values of a model are pickled.
    """

    def reducer_override(self, value: Any) -> Any:
        """Pickle a model as its field values, and all other values by default."""
        if not isinstance(value, BaseModel):
            return NotImplemented
        kind = type(value)
        if kind.__module__.partition(".")[0] != __name__.partition(".")[0]:
            raise pickle.PicklingError(f"{kind.__qualname__} is defined in the user's code")
        return tuple, ((kind.__qualname__, *((name, getattr(value, name)) for name in kind.model_fields)),)


def _identity(value: Any) -> bytes | None:
    """Return bytes that are equal for equal values; None for a value that contains the user's code."""
    buffer = io.BytesIO()
    pickler = _IdentityPickler(buffer, protocol=pickle.HIGHEST_PROTOCOL)
    # Pickle's fast mode writes a repeated object in full again. The bytes then depend only on the values.
    pickler.fast = True
    try:
        pickler.dump(value)
    except (pickle.PicklingError, AttributeError, TypeError):
        return None
    return buffer.getvalue()


@functools.cache
def _environment() -> tuple[Any, ...] | None:
    """Return digest and versions of all software on which results depend, and the processor.

    None if the sources cannot be read, or were edited after the start of this process.
    """
    digest, sources = hashlib.sha256(), sorted(_PACKAGE_FOLDER.rglob("*.py"))
    with suppress(OSError):
        # If the package is in an archive, its sources cannot be read.
        if not sources or max(source.stat().st_mtime for source in sources) > _START_TIME:
            return None
        for source in sources:
            digest.update(f"{source.relative_to(_PACKAGE_FOLDER)}\0".encode() + source.read_bytes())
        processor = llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()
        libraries = tuple([version(name) for name in _LIBRARIES])
        return (digest.hexdigest(), libraries, platform.python_version(), platform.platform(), processor)
    return None
