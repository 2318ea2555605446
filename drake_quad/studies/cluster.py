"""Workers of a Dask cluster that fly the batches of a study."""

import gc
import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

from drake_quad.errors import InputError
from drake_quad.process_settings import ProcessSetting
from drake_quad.studies.crew import Crew, Outcome, attempt, failed
from drake_quad.studies.provenance import difference, provenance

# Timeouts of a connection and of an answer from the scheduler, s. They are generous, since the scheduler may run on a
# busy machine.
_CONNECTION_TIMEOUT, _ANSWER_TIMEOUT = 10.0, 30.0
# Periods, s. Checking the futures takes microseconds, whereas a request to the scheduler takes milliseconds.
_POLL_PERIOD, _BETWEEN_QUESTIONS = 0.05, 2.0
# Time limit, s. A cluster that scales automatically may have no workers for a while.
_LONGEST_WITHOUT_WORKERS = 60.0


class DaskCrew(Crew):
    """Crew of the workers of a Dask cluster, which can be used while the scheduler answers.

    Args:
        client: connected Dask client.
        address: address of the scheduler, for error messages.
        num_workers: number of simultaneous tasks.
    """

    def __init__(self, client: Any, address: str, num_workers: int) -> None:
        self.num_workers = num_workers
        self.capacity = 2 * num_workers  # each worker has a second task in its queue and does not wait for the network
        self._client, self._address = client, address
        self._under_way: dict[Any, Any] = {}
        self._asked = self._had_workers = time.monotonic()

    def begin(self, function: Callable[[Any], Any], given: Any) -> None:
        """Begin a task, as `Crew.begin` does."""
        self._check_connection()
        self._under_way[self._client.submit(attempt, function, given, pure=False)] = given

    def finished(self) -> list[Outcome]:
        """Wait for outcomes, as `Crew.finished` does.

        Raises:
            ConnectionError: the scheduler is gone, or the cluster has had no workers for a minute.
        """
        while True:
            done = [future for future in self._under_way if future.done()]
            self._check_connection()
            if done:
                return [self._outcome(future, self._under_way.pop(future)) for future in done]
            self._check_scheduler()
            time.sleep(_POLL_PERIOD)

    def give_up(self) -> None:
        """Abandon all tasks, as `Crew.give_up` does, except that workers complete the tasks that they have begun."""
        self._under_way.clear()  # the scheduler cancels tasks whose futures are garbage-collected

    def _outcome(self, future: Any, given: Any) -> Outcome:
        try:
            outcome: Outcome = future.result(timeout=_ANSWER_TIMEOUT)
        except TimeoutError:
            raise self._silence() from None
        except Exception as error:  # the worker died, or could not unpickle the task
            return failed(given, error)
        return outcome

    def _silence(self) -> ConnectionError:
        """Return the error for a request that the scheduler does not answer."""
        self._check_connection()
        return self._lost("does not answer")

    def _lost(self, how: str) -> ConnectionError:
        return ConnectionError(f"the Dask scheduler at {self._address} {how}")

    def _check_connection(self) -> None:
        # A client that loses its scheduler cancels its futures, even if it finds another scheduler later. The status
        # "lost" has another meaning: the worker with the result died, and the scheduler repeats the computation.
        if self._client.status != "running" or any(future.status == "cancelled" for future in self._under_way):
            raise self._lost("is gone")

    def _check_scheduler(self) -> None:
        """Request the number of workers from the scheduler, at most every two seconds."""
        now = time.monotonic()
        if now < self._asked + _BETWEEN_QUESTIONS:
            return
        try:
            threads = self._client.sync(self._client.scheduler.ncores, callback_timeout=_ANSWER_TIMEOUT)
        except (OSError, TimeoutError, AttributeError):
            raise self._silence() from None
        self._asked = time.monotonic()
        if threads:
            self._had_workers = now
        elif now > self._had_workers + _LONGEST_WITHOUT_WORKERS:
            raise self._lost("has had no workers for a minute")


@contextmanager
def dask_crew(address: str, num_workers: int | None = None) -> Iterator[DaskCrew]:
    """Connect to a Dask cluster whose workers have the same code as this process, and yield its crew.

    Args:
        address: address of the scheduler, such as tcp://localhost:8786.
        num_workers: number of simultaneous tasks; one for each thread of the cluster's workers if not given.

    Raises:
        InputError: Dask is not installed, no scheduler or no worker can be reached, or a worker has different code.
    """
    try:
        from distributed import Client
    except ImportError:
        raise InputError("Dask is not installed; pip install 'drake_quad[cluster]' has it") from None
    with _silently():
        client = _connected(Client, address)
        try:
            try:
                client.wait_for_workers(1, timeout=_LONGEST_WITHOUT_WORKERS)
            except TimeoutError:
                raise InputError(f"the Dask scheduler at {address} has no workers") from None
            _check_code(client)
            threads = sum(client.nthreads().values())
            yield DaskCrew(client, address, threads if num_workers is None else num_workers)
        finally:
            _close(client)


def _connected(client: Callable[..., Any], address: str) -> Any:
    """Return a client that is connected to the scheduler at an address.

    Raises:
        InputError: no scheduler can be reached at this address.
    """
    try:
        return client(address, timeout=_CONNECTION_TIMEOUT, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
    # Dask leaves an incomplete client, which closes when it is garbage-collected. At the end of the process, closing
    # would take 20 s and print a traceback.
    gc.collect()
    raise InputError(f"no Dask scheduler can be reached at {address}: {reason}")


def _check_code(client: Any) -> None:
    """Check that all workers have the same versions and sources as this process.

    Raises:
        InputError: a worker has different code, or cannot import it.
    """
    here = provenance()
    for worker, there in client.run(provenance, on_error="return").items():
        if not isinstance(there, dict):
            raise InputError(f"the worker at {worker} cannot fly: {type(there).__name__}: {there}")
        other = difference(here, there)
        if other is not None:
            raise InputError(f"the worker at {worker} has {other}")


def _close(client: Any) -> None:
    """Close a client, without waiting for a scheduler that does not answer."""
    with suppress(TimeoutError):
        client.close(timeout=_CONNECTION_TIMEOUT)


@contextmanager
def _silent(*packages: str) -> Iterator[None]:
    """Silence the loggers of packages whose errors are reported by this module.

    Each logger is silenced separately, since loggers with a level of their own ignore the level of their parent.
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


# Tornado runs the event loop of the client and would log the tasks that Ctrl-C interrupts.
_silently = ProcessSetting(lambda: _silent("distributed", "tornado"))
