"""Bars on a terminal while something takes long."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

_BAR = "{desc}: {percentage:3.0f}% |{bar}| {n:.0f} of {total:.0f} s flown, {remaining} to go"


def new_bar(*items: Any, **options: Any) -> Any:
    """Returns a progress bar of tqdm, which is only seen on a terminal and only while it is under way."""
    from tqdm import tqdm

    # Worker processes are forked only from a process with a single thread, and tqdm's monitor would be a second one.
    tqdm.monitor_interval = 0
    return tqdm(*items, leave=False, disable=None, **options)


@contextmanager
def flight_progress() -> Iterator[Callable[[float, float], None]]:
    """Show a bar on a terminal if a flight takes long, and give the function to tell the time flown and to fly, s."""
    with new_bar(total=0.0, desc="flying", delay=1.0, bar_format=_BAR) as bar:

        def show(flown: float, duration: float) -> None:
            bar.total = duration
            bar.update(flown - bar.n)

        yield show


@contextmanager
def study_progress(name: str) -> Iterator[Callable[[int, int], None]]:
    """Show a bar on a terminal, and give the function to tell how many samples are done, and how many there are."""
    with new_bar(desc=name, unit=" flights", mininterval=0.2) as bar:

        def show(done: int, total: int) -> None:
            if bar.total is None:
                bar.reset(total)
                bar.initial = done
            bar.update(done - bar.n)

        yield show


@contextmanager
def job_progress() -> Iterator[Callable[[str, int, int], None]]:
    """Show a bar on a terminal, and give the function to tell the job, and how much is done of how much."""
    with new_bar(desc="flying") as bar:

        def show(name: str, done: int, total: int) -> None:
            bar.total = total
            bar.set_postfix_str(name, refresh=False)
            bar.update(done - bar.n)

        yield show


def bar_over(items: Sequence[str], words: str) -> Iterator[str]:
    """Gives items one after another and shows a bar on a terminal."""
    with new_bar(items, desc=words) as bar:
        for item in bar:
            bar.set_postfix_str(item)
            yield item
