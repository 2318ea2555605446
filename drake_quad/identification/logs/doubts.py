"""What looks wrong in a log: numbers that nothing measures or commands, jumps, and flights that are none."""

from collections.abc import Iterator

import numpy as np

# Signals that no flight leaves at zero throughout.
_NEVER_ZERO = ("position", "velocity", "attitude", "body_rates", "specific_force")
# What a position jumps by in a step, at least, m; and the acceleration that no vehicle has, m/s². Noise is less than so
# many of its medians.
_LEAST_JUMP, _LARGEST_ACCELERATION, _NOISE = 0.1, 500.0, 8.0
# A vehicle that stays as near to the ground does not fly, m.
_LOW = 0.25
# A reference that is so far away is out of reach, m, if the vehicle never moves as far.
_OUT_OF_REACH = 2.0


def jumps(time: np.ndarray, position: np.ndarray) -> Iterator[str]:
    """Yield a sentence on steps of a position that no vehicle makes, as where its estimator is reset.

    Args:
        time: (n,) of the samples, s.
        position: (n, 3) m.
    """
    moved = np.append(True, (np.diff(position, axis=0) != 0.0).any(axis=1))  # a slow signal is held on a fast clock
    instants, places = time[moved], position[moved]
    if len(instants) < 4:
        return
    steps, durations = np.diff(places, axis=0), np.diff(instants)
    velocity, inner = steps / durations[:, np.newaxis], durations[1:-1, np.newaxis]
    # A step beside a jump goes on as the step at its other side.
    before, after = (np.linalg.norm(steps[1:-1] - inner * each, axis=1) for each in (velocity[:-2], velocity[2:]))
    size = np.minimum(before, after)
    least = np.maximum(_LEAST_JUMP, np.maximum(_NOISE * np.median(size), _LARGEST_ACCELERATION * durations[1:-1] ** 2))
    found = np.flatnonzero(size > least)
    if len(found):
        times = "once" if len(found) == 1 else f"{len(found):,} times"
        worst = found[np.argmax(size[found])]
        yield (
            f"position jumps {times}, at most by {size[worst]:.2g} m at {instants[worst + 2] - time[0]:.4g} s: its"
            " estimator was reset, or the log is damaged"
        )


def doubts(signals: dict[str, np.ndarray], time: np.ndarray) -> Iterator[str]:
    """Yield sentences on what looks wrong in the signals of a record.

    Args:
        signals: (n,) or (n, columns) by name, in SI.
        time: (n,) s, from 0 on.
    """
    zero = [name for name in _NEVER_ZERO if name in signals and not signals[name].any()]
    if zero:
        yield f"{' and '.join(zero)} {'are' if len(zero) > 1 else 'is'} zero throughout: nothing may have measured it"
    position, reference = signals.get("position"), signals.get("reference_position")
    if position is None:
        return
    height = position[:, 2]
    if np.abs(height).max() < _LOW:
        yield (f"the height stays between {height.min():.2g} and {height.max():.2g} m: the vehicle may not have flown")
    if reference is not None:
        distance = np.linalg.norm(reference - position, axis=1)
        reach = max(_OUT_OF_REACH, float(np.linalg.norm(np.ptp(position, axis=0))))
        far = np.flatnonzero(distance > reach)
        if len(far):
            yield (
                f"reference_position is up to {distance.max():.3g} m from a vehicle that moves by {reach:.3g} m, first"
                f" at {time[far[0]]:.4g} s: it does not follow it there, or the log is damaged"
            )
