"""Plausibility checks of a log: zero signals, position jumps, unreachable references and logs without a flight."""

from collections.abc import Iterator

import numpy as np

# The following signals vary in any flight, so a signal that is zero in the whole log was probably not measured.
_NONZERO_SIGNALS = ("position", "velocity", "attitude", "body_rates", "specific_force")
# A step of the position counts as a jump if it exceeds all three limits.
_MIN_POSITION_JUMP = 0.1  # m
_MAX_ACCELERATION = 500.0  # m/s², more than any quadrotor reaches
_MAX_NOISE_RATIO = 8.0  # largest step that noise can cause, relative to the median step
_MIN_FLIGHT_HEIGHT = 0.25  # m; a vehicle that stays below this height may be standing on the ground
_PLAUSIBLE_DISTANCE = 2.0  # m; a reference that is nearer to the vehicle is plausible, even if the vehicle stands still


def position_jumps(time: np.ndarray, position: np.ndarray) -> Iterator[str]:
    """Yield a remark on position steps that no vehicle can make, for example a reset of the estimator.

    Args:
        time: (n,) times of the samples, s.
        position: (n, 3) measured position, m.
    """
    # The log repeats the last value of a slow signal until its next update, so only the updates are compared.
    is_update = np.append(True, (np.diff(position, axis=0) != 0.0).any(axis=1))
    times, positions = time[is_update], position[is_update]
    if len(times) < 4:
        return
    steps, durations = np.diff(positions, axis=0), np.diff(times)
    velocity, inner_durations = steps / durations[:, np.newaxis], durations[1:-1, np.newaxis]
    # An ordinary step is similar to the preceding or the following step; a jump is similar to neither.
    before, after = (
        np.linalg.norm(steps[1:-1] - inner_durations * each, axis=1) for each in (velocity[:-2], velocity[2:])
    )
    size = np.minimum(before, after)
    plausible = np.maximum(_MAX_NOISE_RATIO * np.median(size), _MAX_ACCELERATION * durations[1:-1] ** 2)
    jump_indices = np.flatnonzero(size > np.maximum(_MIN_POSITION_JUMP, plausible))
    if len(jump_indices):
        count_text = "once" if len(jump_indices) == 1 else f"{len(jump_indices):,} times"
        worst = jump_indices[np.argmax(size[jump_indices])]
        yield (
            f"position jumps {count_text}, by up to {size[worst]:.2g} m at {times[worst + 2] - time[0]:.4g} s: the"
            " estimator was reset, or the log is damaged"
        )


def implausible_signals(signals: dict[str, np.ndarray], time: np.ndarray) -> Iterator[str]:
    """Yield remarks on implausible signals of a record.

    Args:
        signals: (n,) or (n, columns) values of each signal, by name, in SI units.
        time: (n,) times since the start of the record, s.
    """
    zero = [name for name in _NONZERO_SIGNALS if name in signals and not signals[name].any()]
    if zero:
        verb, pronoun = ("are", "they") if len(zero) > 1 else ("is", "it")
        yield f"{' and '.join(zero)} {verb} zero throughout: {pronoun} may not have been measured"
    position, reference = signals.get("position"), signals.get("reference_position")
    if position is None:
        return
    height = position[:, 2]
    if np.abs(height).max() < _MIN_FLIGHT_HEIGHT:
        yield (f"the height stays between {height.min():.2g} and {height.max():.2g} m: the vehicle may not have flown")
    if reference is not None:
        distance = np.linalg.norm(reference - position, axis=1)
        max_distance = max(_PLAUSIBLE_DISTANCE, float(np.linalg.norm(np.ptp(position, axis=0))))
        far_samples = np.flatnonzero(distance > max_distance)
        if len(far_samples):
            yield (
                f"reference_position is up to {distance.max():.3g} m away from a vehicle that moves by"
                f" {max_distance:.3g} m, first at {time[far_samples[0]]:.4g} s:"
                " the vehicle does not follow it, or the log is damaged"
            )
