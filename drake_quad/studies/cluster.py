"""The workers of a Dask cluster."""

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

# Longer than a handshake, and than an answer of a scheduler on a machine that has much else to do, s.
_HANDSHAKE, _PATIENCE = 10.0, 30.0
# A look at the futures costs microseconds, a question to the scheduler milliseconds, s.
_BETWEEN_LOOKS, _BETWEEN_QUESTIONS = 0.05, 2.0
# A cluster that grows and shrinks by itself may be without workers for a while, s.
_LONGEST_WITHOUT_WORKERS = 60.0


class DaskCrew(Crew):
    """The workers of a Dask cluster, as long as its scheduler answers.

    Args:
        client: of Dask, connected.
        address: of the scheduler, for messages.
        num_workers: how many tasks they do at a time.
    """

    def __init__(self, client: Any, address: str, num_workers: int) -> None:
        self.num_workers = num_workers
        self.capacity = 2 * num_workers  # one more each, so that none waits for the network
        self._client, self._address = client, address
        self._under_way: dict[Any, Any] = {}
        self._asked = self._had_workers = time.monotonic()

    def begin(self, function: Callable[[Any], Any], given: Any) -> None:
        """As `Crew.begin`."""
        self._check_connection()
        self._under_way[self._client.submit(attempt, function, given, pure=False)] = given

    def finished(self) -> list[Outcome]:
        """As `Crew.finished`.

        Raises:
            ConnectionError: the scheduler is gone, or all workers have been for a while.
        """
        while True:
            done = [future for future in self._under_way if future.done()]
            self._check_connection()
            if done:
                return [self._outcome(future, self._under_way.pop(future)) for future in done]
            self._check_scheduler()
            time.sleep(_BETWEEN_LOOKS)

    def give_up(self) -> None:
        """As `Crew.give_up`, but a worker goes on with what it has begun."""
        self._under_way.clear()  # the scheduler drops what nobody waits for

    def _outcome(self, future: Any, given: Any) -> Outcome:
        try:
            outcome: Outcome = future.result(timeout=_PATIENCE)
        except TimeoutError:
            raise self._silence() from None
        except Exception as error:  # its worker died, or could not read what it was sent
            return failed(given, error)
        return outcome

    def _silence(self) -> ConnectionError:
        """The error of a question that has no answer."""
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
        """Asks the scheduler for its workers now and then."""
        now = time.monotonic()
        if now < self._asked + _BETWEEN_QUESTIONS:
            return
        try:
            threads = self._client.sync(self._client.scheduler.ncores, callback_timeout=_PATIENCE)
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
        return client(address, timeout=_HANDSHAKE, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
    # Dask leaves an incomplete client, which closes when it is garbage-collected. At the end of the process, closing
    # would take 20 s and print a traceback.
    gc.collect()
    raise InputError(f"no Dask scheduler can be reached at {address}: {reason}")


def _check_code(client: Any) -> None:
    """Raises InputError if a worker has other versions or other sources than this process."""
    here = provenance()
    for worker, there in client.run(provenance, on_error="return").items():
        if not isinstance(there, dict):
            raise InputError(f"the worker at {worker} cannot fly: {type(there).__name__}: {there}")
        other = difference(here, there)
        if other is not None:
            raise InputError(f"the worker at {worker} has {other}")


def _close(client: Any) -> None:
    """Closes a client; a scheduler that does not answer is not waited for."""
    with suppress(TimeoutError):
        client.close(timeout=_HANDSHAKE)


@contextmanager
def _silent(*packages: str) -> Iterator[None]:
    """Keeps packages from logging what a person is told in a sentence; their loggers have levels of their own."""
    names = [name for name in logging.root.manager.loggerDict if name.split(".")[0] in packages]
    before = {name: logging.getLogger(name).level for name in names}
    for name in names:
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for name, level in before.items():
            logging.getLogger(name).setLevel(level)


# Tornado runs the event loop of the client, and logs the tasks that Ctrl-C interrupts.
_silently = ProcessSetting(lambda: _silent("distributed", "tornado"))
