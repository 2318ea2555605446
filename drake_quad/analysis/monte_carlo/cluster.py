"""The workers of a Dask cluster."""

from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager

from drake_quad.errors import InputError

# Longer than any handshake on a network that works, s.
_PATIENCE = 5.0


@contextmanager
def dask_executor(address: str) -> Iterator[tuple[Executor, int]]:
    """Connects to a Dask cluster, and gives its executor and how many batches its workers can fly at a time.

    Args:
        address: of the scheduler, such as tcp://localhost:8786.

    Raises:
        InputError: Dask is not installed, or no scheduler or no worker can be reached.
    """
    try:
        from distributed import Client
    except ImportError:
        raise InputError(
            "Dask is not installed; pip install --constraint constraints.txt --editable '.[cluster]' has it"
        ) from None
    try:
        client = Client(address, timeout=_PATIENCE)
    except (OSError, ValueError, TypeError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"no Dask scheduler can be reached at {address}: {reason}") from None
    with client:
        threads = sum(client.nthreads().values())
        if threads == 0:
            raise InputError(f"the Dask scheduler at {address} has no workers")
        yield client.get_executor(), threads
