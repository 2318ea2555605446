"""Progress bars for the terminal."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

# Options of tqdm for a bar that counts seconds of flight, and that appears after `delay` seconds.
FLIGHT_BAR: dict[str, Any] = {
    "bar_format": "{desc}: {percentage:3.0f}% |{bar}| {n:.0f} of {total:.0f} s flown, {remaining} remaining",
    "delay": 1.0,
}


def new_bar(*items: Any, **options: Any) -> Any:
    """Return a tqdm progress bar that is shown only on a terminal, and disappears when it is finished."""
    from tqdm import tqdm

    # tqdm must not start its monitor thread, since worker processes can be forked only from a single-threaded process.
    tqdm.monitor_interval = 0
    return tqdm(*items, leave=False, disable=None, **options)


@contextmanager
def progress_bar(description: str, **options: Any) -> Iterator[Callable[..., None]]:
    """Show a progress bar on a terminal, and yield the function that updates it.

    The function takes the number of finished steps, their total number, and optionally the name of the last step.
    """
    with new_bar(desc=description, **options) as bar:

        def show(done: float, total: float, name: str = "") -> None:
            if not bar.total:
                bar.total, bar.initial = total, done
            bar.set_postfix_str(name, refresh=False)
            bar.update(done - bar.n)

        yield show


@contextmanager
def counting_bar(description: str, num_flights: int) -> Iterator[Callable[[int, str], None]]:
    """Show a progress bar for a number of flights, and yield the function that updates it.

    The function takes the number of flights since its last call, and a description of the state.
    """
    with new_bar(desc=description, unit=" flights", total=num_flights) as bar:

        def show(count: int, state: str) -> None:
            bar.set_postfix_str(state, refresh=False)
            bar.update(count)

        yield show
