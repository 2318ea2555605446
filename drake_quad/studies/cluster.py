"""Pool of Dask cluster workers that fly the batches of a study."""

import gc
import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

from drake_quad.errors import InputError
from drake_quad.extras import MissingLibraryError, import_extra
from drake_quad.process_settings import ProcessSetting
from drake_quad.studies.provenance import code_difference, provenance
from drake_quad.studies.worker_pool import Outcome, WorkerPool, failed_outcome, run_task

# The timeouts are long, since the scheduler may run on a busy machine.
_CONNECTION_TIMEOUT = 10.0  # s, for the connection to the scheduler
_REPLY_TIMEOUT = 30.0  # s, for a reply of the scheduler
_POLL_PERIOD = 0.05  # s between checks of the futures; a check takes microseconds
_REQUEST_PERIOD = 2.0  # s between requests to the scheduler; a request takes milliseconds
_MAX_TIME_WITHOUT_WORKERS = 60.0  # s; an automatically scaled cluster may have no workers for a while


class DaskPool(WorkerPool):
    """Pool of Dask cluster workers, which can be used as long as the scheduler replies.

    Args:
        client: connected Dask client.
        address: address of the scheduler, for error messages.
        num_workers: number of simultaneous tasks.
    """

    def __init__(self, client: Any, address: str, num_workers: int) -> None:
        self.num_workers = num_workers
        self.capacity = 2 * num_workers  # a queued task for each worker, so that no worker waits for the network
        self._client, self._address = client, address
        self._pending: dict[Any, Any] = {}
        self._last_request = self._last_time_with_workers = time.monotonic()

    def submit(self, function: Callable[[Any], Any], argument: Any) -> None:
        """Start a task, as `WorkerPool.submit` does."""
        self._check_connection()
        self._pending[self._client.submit(run_task, function, argument, pure=False)] = argument

    def next_outcomes(self) -> list[Outcome]:
        """Wait for outcomes, as `WorkerPool.next_outcomes` does.

        Raises:
            ConnectionError: if the scheduler does not reply, or the cluster has had no workers for a minute.
        """
        while True:
            done = [future for future in self._pending if future.done()]
            self._check_connection()
            if done:
                return [self._outcome(future, self._pending.pop(future)) for future in done]
            self._check_scheduler()
            time.sleep(_POLL_PERIOD)

    def abandon(self) -> None:
        """Cancel all pending tasks; workers complete the tasks that are already running."""
        self._pending.clear()  # the scheduler cancels a task when its future is garbage-collected

    def _outcome(self, future: Any, argument: Any) -> Outcome:
        try:
            outcome: Outcome = future.result(timeout=_REPLY_TIMEOUT)
        except TimeoutError:
            raise self._timeout_error() from None
        except Exception as error:  # the worker died, or could not unpickle the task
            return failed_outcome(argument, error)
        return outcome

    def _timeout_error(self) -> ConnectionError:
        """Return the error for a request to which the scheduler does not reply."""
        self._check_connection()
        return self._connection_error("does not reply")

    def _connection_error(self, problem: str) -> ConnectionError:
        return ConnectionError(f"the Dask scheduler at {self._address} {problem}")

    def _check_connection(self) -> None:
        # A client that loses its scheduler cancels its futures, even if it connects to another scheduler later. The
        # status "lost" is no reason to stop: it means that the worker with the result died, and the scheduler repeats
        # the task.
        if self._client.status != "running" or any(future.status == "cancelled" for future in self._pending):
            raise self._connection_error("has closed the connection")

    def _check_scheduler(self) -> None:
        """Request the number of workers from the scheduler, at most every two seconds."""
        now = time.monotonic()
        if now < self._last_request + _REQUEST_PERIOD:
            return
        try:
            threads = self._client.sync(self._client.scheduler.ncores, callback_timeout=_REPLY_TIMEOUT)
        except (OSError, TimeoutError, AttributeError):
            raise self._timeout_error() from None
        self._last_request = time.monotonic()
        if threads:
            self._last_time_with_workers = now
        elif now > self._last_time_with_workers + _MAX_TIME_WITHOUT_WORKERS:
            raise self._connection_error("has had no workers for a minute; start workers and resume the study")


@contextmanager
def dask_pool(address: str, num_workers: int | None = None) -> Iterator[DaskPool]:
    """Connect to a Dask cluster, check that its workers have the code of this process, and yield their pool.

    Args:
        address: address of the scheduler, such as tcp://localhost:8786.
        num_workers: number of simultaneous tasks; by default, one for each thread of the cluster's workers.

    Raises:
        InputError: if Dask is not installed, no scheduler or no worker can be reached, or a worker has different code.
    """
    try:
        client_class = import_extra("distributed", "cluster").Client
    except MissingLibraryError as error:
        raise InputError(str(error)) from None
    with _silently():
        client = _connected(client_class, address)
        try:
            try:
                client.wait_for_workers(1, timeout=_MAX_TIME_WITHOUT_WORKERS)
            except TimeoutError:
                raise InputError(
                    f"the Dask scheduler at {address} has no workers; start some with dask worker {address}"
                ) from None
            _check_code(client)
            threads = sum(client.nthreads().values())
            yield DaskPool(client, address, threads if num_workers is None else num_workers)
        finally:
            _close(client)


def _connected(client: Callable[..., Any], address: str) -> Any:
    """Return a client that is connected to the scheduler at an address.

    Raises:
        InputError: if no scheduler can be reached at this address.
    """
    try:
        return client(address, timeout=_CONNECTION_TIMEOUT, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
    # Dask leaves an incomplete client behind, which is closed here by garbage collection. At the end of the process,
    # closing it would take 20 s and print a traceback.
    gc.collect()
    raise InputError(f"no Dask scheduler can be reached at {address}: {reason}")


def _check_code(client: Any) -> None:
    """Check that all workers have the same versions and sources as this process.

    Raises:
        InputError: if a worker has different code, or cannot import it.
    """
    here = provenance()
    for worker, there in client.run(provenance, on_error="return").items():
        if not isinstance(there, dict):
            raise InputError(f"the worker at {worker} cannot import drake_quad: {type(there).__name__}: {there}")
        mismatch = code_difference(here, there)
        if mismatch is not None:
            raise InputError(f"the worker at {worker} has {mismatch}")


def _close(client: Any) -> None:
    """Close a client, without waiting for a scheduler that does not reply."""
    with suppress(TimeoutError):
        client.close(timeout=_CONNECTION_TIMEOUT)


@contextmanager
def _silent(*packages: str) -> Iterator[None]:
    """Silence the loggers of packages whose errors are reported by this module.

    Each logger is silenced separately, since a logger that has its own level ignores the level of its parent.
    """
    names = [name for name in logging.root.manager.loggerDict if name.split(".")[0] in packages]
    before = {name: logging.getLogger(name).level for name in names}
    for name in names:
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for name, level in before.items():
            logging.getLogger(name).setLevel(level)


# Tornado, which runs the event loop of the client, would log an error for each task that Ctrl-C interrupts.
_silently = ProcessSetting(lambda: _silent("distributed", "tornado"))
