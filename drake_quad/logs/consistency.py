"""Checks of logged signals against each other: signs, units, frames and time shifts.

Signals that are physically related are compared over short windows:

- the change of position with the mean velocity,
- the change of attitude with the mean body rates,
- the change of velocity with the specific force and with the tilt,
- a command with the signal that follows it.

If two signals disagree, every possible single fault is tried: a wrong sign, unit or frame. The fault whose repair
improves the agreement most is reported. Signals that agree after the repair are then checked for a time shift.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
import scipy

from drake_quad.logs.attitudes import rotation_matrices
from drake_quad.logs.faults import AXES, GRAVITY, Fault, faults

_GRID_STEP = 0.01  # s; finer samples are averaged
_MAX_GRID_SIZE = 6_000  # a minute with steps of 10 ms; only the middle part of a longer log is checked
_MIN_WINDOWS = 50  # smallest number of windows in which two signals are compared
_TRANSLATION_WINDOW = 0.2  # s, long enough to average out the noise of positions
_ROTATION_WINDOW = 0.1  # s, window in which rotations are compared
_SEARCH_STRIDE = 0.04  # s, distance between the windows in the search for faults
_MIN_SPEED = 0.05  # m/s, smallest standard deviation of a usable velocity; a disabled estimator logs zeros
_MIN_TILT_COSINE = 0.2  # lower limit of the cosine of the tilt, so that its tangent does not diverge
# Values are clipped to this quantile of their magnitude, so that a crash or a landing does not dominate.
_CLIPPED_QUANTILE = 0.9
_MAX_FAULTS = 3  # largest number of faults that are reported
# A fault is reported if its repair reduces a disagreement from d to less than (d - `_MIN_IMPROVEMENT`) / 2.
_MIN_IMPROVEMENT = 0.4
_TIE = 0.02  # if the repairs of two faults improve the agreement equally within this value, the first one is reported
_AXIS_COST = 0.05  # penalty for each axis of a fault, so that the simplest fault is preferred
# At small tilts, world and body axes hardly differ. A wrong frame is therefore reported if the other frame fits better
# in at least `_MIN_BETTER_PARTS` of `_NUM_PARTS` parts of the log, and reduces the error below `_MAX_FRAME_ERROR_RATIO`
# times its value. In correct logs, the other frame increases the error.
_NUM_PARTS = 8  # number of parts of a log
_MIN_BETTER_PARTS = 6  # smallest number of parts in which the other frame is better
_MAX_FRAME_ERROR_RATIO = 0.75  # error with the other frame, relative to the error with the declared one
_MAX_SHIFT = 0.3  # s, largest time shift that is tried
_MIN_SHIFT_AMPLITUDE = 0.1  # SI units, smallest amplitude of signals whose time shift is determined
_MIN_SHIFT = 0.025  # s; filters and radio links of correct logs shift signals by up to 20 ms
_SHIFT_SIGMAS = 4.0  # a shift is reported if it exceeds `_MIN_SHIFT` by this many standard errors
_CLOCK_PART_DURATION = 2.0  # s, duration of each part of a log in which two clocks are compared
_MAX_CLOCK_SHIFT = 0.1  # s, largest shift between two clocks that is tried
# Largest power of the difference between shifted signals, relative to the power of the signals.
_MAX_CLOCK_ERROR = 0.4
_MAX_RESPONSE_TIME = 0.5  # s, largest delay from a command to the signal that follows it
# Two signals contradict each other if they disagree by at least this value and no single fault explains it.
_MIN_CONTRADICTION = 0.85
_OPPOSITE_DISAGREEMENT = 1.2  # signals with a larger disagreement are opposite rather than independent
_ROUNDING_ERROR = 1e-9  # a signal with a smaller amplitude, relative to the signal it is compared with, is constant
_TINY = float(np.finfo(float).tiny)


class Inconsistency(NamedTuple):
    """Disagreement between signals.

    Attributes:
        text: remark on the disagreement.
        faulty: names of the faulty signals; empty if the signals agree except for a time shift.
    """

    text: str
    faulty: tuple[str, ...] = ()


class ClockShifts(NamedTuple):
    """Time shifts between attitude and body rates in parts of a log.

    Attributes:
        lags: (parts,) lag of the body rates behind the derivative of the attitude, s.
        deviations: (parts,) standard deviation of the error of each lag due to noise, s.
    """

    lags: np.ndarray
    deviations: np.ndarray


class _Pair(NamedTuple):
    """Two signals that should be equal.

    Attributes:
        name: name of the checked signal.
        other: phrase that names the quantity with which the signal is compared, for messages.
        expected: (windows, axes) values that follow from the other signals.
        measured: (windows, axes) values of the checked signal.
        threshold: smallest amplitude that is compared, in SI units. Axes with smaller amplitudes are skipped.
        axes: names of the axes.
        centred: True if the medians of both signals are subtracted before the comparison.
        is_exact: False if the two signals may differ by a delay or by an unmodelled effect.
        suspicious: disagreement above which faults are searched for.
    """

    name: str
    other: str
    expected: np.ndarray
    measured: np.ndarray
    threshold: float
    axes: tuple[str, ...]
    centred: bool = True
    is_exact: bool = True
    suspicious: float = _MIN_IMPROVEMENT

    def clipped(self) -> tuple[np.ndarray, np.ndarray]:
        """Return expected and measured values, minus their medians if centred, clipped to their typical amplitude."""
        return _clipped(self.expected, self.centred), _clipped(self.measured, self.centred)

    def disagreement(self) -> np.ndarray:
        """Return the disagreement of each axis: 0 for equal, 1 for independent and 2 for opposite values."""
        expected, measured = self.clipped()
        power = np.mean(expected**2, axis=0) + np.mean(measured**2, axis=0)
        return np.asarray(np.mean((expected - measured) ** 2, axis=0) / np.maximum(power, _TINY))

    def excited(self, *, factor: float = 1.0) -> np.ndarray:
        """Return a mask of the axes whose amplitude exceeds `factor` times the threshold."""
        amplitudes = [np.sqrt(np.mean(side**2, axis=0)) for side in self.clipped()]
        return np.asarray(np.maximum(*amplitudes) > factor * self.threshold)

    def text(self, axis: int) -> str:
        """Return a phrase that describes the disagreement along an axis."""
        expected, measured = (side[:, axis] for side in self.clipped())
        amplitude, other_amplitude = (math.sqrt(float(np.mean(each**2))) for each in (measured, expected))
        if not self.centred:
            comparison = f"mean {float(np.mean(measured)):.3g} instead of {float(np.mean(expected)):.3g} m/s²"
        else:
            correlation = float(np.mean(expected * measured)) / max(amplitude * other_amplitude, _TINY)
            is_constant = other_amplitude <= _ROUNDING_ERROR * amplitude
            ratio = ", which is constant" if is_constant else f", amplitudes {amplitude:.2g} and {other_amplitude:.2g}"
            comparison = f"correlation {correlation:.2f}{ratio}"
        return (
            f"{self.other} {'in' if self.axes[axis] in AXES['attitude'] else 'along'} {self.axes[axis]} ({comparison})"
        )


_MOTION_SIGNALS = ("position", "velocity")


def _clipped(values: np.ndarray, centred: bool) -> np.ndarray:
    """Return values (w, axes), minus their medians if centred, clipped to their typical amplitude."""
    deviation = values - _quantile(values, 0.5) if centred else values
    limit = _quantile(np.abs(deviation), _CLIPPED_QUANTILE)
    return np.minimum(np.maximum(deviation, -limit), limit)


def _quantile(values: np.ndarray, probability: float) -> np.ndarray:
    """Return a quantile (axes,) of values (w, axes), ten times as fast as `np.quantile`."""
    position = probability * (len(values) - 1)
    low = int(position)
    high = min(low + 1, len(values) - 1)
    ordered = np.partition(values, (low, high), axis=0)
    return np.asarray(ordered[low] + (position - low) * (ordered[high] - ordered[low]))


class _Grid:
    """Signals of a log as means over the steps of a regular grid.

    Signals are compared in windows, which start at steps of the grid. A window that contains a gap is left out.

    Attributes:
        signals: (n, columns) values of each signal, by name.
        step: step of the grid, s.
        usable: (n,) False where the log has a gap.
        stride: number of steps from one window to the next.
    """

    def __init__(self, signals: Mapping[str, np.ndarray], step: float, usable: np.ndarray, *, stride: int = 1) -> None:
        self.signals, self.step, self.usable, self.stride = signals, step, usable, stride
        self._starts: dict[int, np.ndarray] = {}

    def with_stride(self, stride: int) -> "_Grid":
        """Return a copy of the grid whose windows are `stride` steps apart."""
        return _Grid(self.signals, self.step, self.usable, stride=stride)

    def repaired(self, fault: Fault) -> "_Grid":
        """Return this grid with a fault repaired. Cached quantities that do not depend on the fault are kept."""
        result = _Grid({**self.signals, **fault.repaired(self.signals)}, self.step, self.usable, stride=self.stride)
        result._starts = self._starts
        for quantity, sources in _SOURCES.items():
            if quantity in vars(self) and not set(sources).intersection(fault.signals):
                vars(result)[quantity] = vars(self)[quantity]
        return result

    def num_steps(self, duration: float) -> int:
        """Return the number of grid steps in a duration (s), at least one."""
        return max(1, round(duration / self.step))

    def starts(self, width: int) -> np.ndarray:
        """Return the first step (w,) of each window that has `width` steps and no gap."""
        if width not in self._starts:
            num_unusable = np.concatenate([[0], np.cumsum(~self.usable)])
            is_complete = num_unusable[width + 1 :] == num_unusable[: len(num_unusable) - width - 1]
            self._starts[width] = np.flatnonzero(is_complete)[:: self.stride]
        return self._starts[width]

    def mean(self, values: np.ndarray, width: int) -> np.ndarray:
        """Return the means (w, columns) of values (n, columns) over each window of `width` steps."""
        return _all_means(values, width)[self.starts(width)]

    def rate(self, values: np.ndarray, width: int) -> np.ndarray:
        """Return the mean time derivatives (w, columns) of values (n, columns) over each window of `width` steps."""
        starts = self.starts(width)
        return np.asarray((values[starts + width] - values[starts]) / (width * self.step))

    @cached_property
    def rotation(self) -> "scipy.spatial.transform.Rotation":
        """Rotations (n,) from the body to the world frame, from the logged attitude."""
        return rotation_matrices(self.signals["attitude"])

    @cached_property
    def turn_rate(self) -> np.ndarray:
        """Mean body rates (w, 3) that follow from the attitudes at both ends of each window."""
        width = self.num_steps(_ROTATION_WINDOW)
        starts = self.starts(width)
        rotation_vectors: np.ndarray = (self.rotation[starts].inv() * self.rotation[starts + width]).as_rotvec()
        return rotation_vectors / (width * self.step)

    @cached_property
    def tilt_tangent(self) -> np.ndarray:
        """Mean tangents (w, 2) of the tilt angles along x and y of the world."""
        axis = self.rotation.apply([0.0, 0.0, 1.0])
        tangents = axis[:, :2] / np.maximum(axis[:, 2:], _MIN_TILT_COSINE)
        return self.mean(tangents, self.num_steps(_TRANSLATION_WINDOW))

    @property
    def velocity(self) -> np.ndarray | None:
        """Logged velocity, or the derivative of the logged position if no velocity is logged, m/s."""
        if "velocity" in self.signals or "position" not in self.signals:
            return self.signals.get("velocity")
        return np.asarray(np.gradient(self.signals["position"], self.step, axis=0))

    @cached_property
    def is_moving(self) -> bool:
        """True if the velocity varies enough to determine accelerations."""
        return self.velocity is not None and float(np.std(self.velocity, axis=0).max()) > _MIN_SPEED

    @cached_property
    def expected_force(self) -> np.ndarray:
        """Mean specific force (w, 3) along the world axes that follows from the velocity."""
        assert self.velocity is not None
        return self.rate(self.velocity, self.num_steps(_TRANSLATION_WINDOW)) + np.array([0.0, 0.0, GRAVITY])

    @cached_property
    def expected_force_in_body(self) -> np.ndarray:
        """`expected_force` (w, 3) along the body axes in the middle of each window."""
        width = self.num_steps(_TRANSLATION_WINDOW)
        in_body: np.ndarray = self.rotation[self.starts(width) + width // 2].inv().apply(self.expected_force)
        return in_body

    @cached_property
    def force_in_world(self) -> np.ndarray:
        """Mean specific force (w, 3) along the world axes."""
        return self.mean(self.rotation.apply(self.signals["specific_force"]), self.num_steps(_TRANSLATION_WINDOW))


# Signals on which each cached quantity of `_Grid` depends.
_SOURCES = {
    "rotation": ("attitude",),
    "turn_rate": ("attitude",),
    "tilt_tangent": ("attitude",),
    "is_moving": _MOTION_SIGNALS,
    "expected_force": _MOTION_SIGNALS,
    "expected_force_in_body": ("attitude", *_MOTION_SIGNALS),
    "force_in_world": ("attitude", "specific_force"),
}


def inconsistencies(signals: Mapping[str, np.ndarray], time: np.ndarray) -> Iterator[Inconsistency]:
    """Yield each disagreement between signals.

    Args:
        signals: (n,) or (n, columns) values of each signal, by name, in SI units and the frames of this library.
        time: (n,) increasing times, s.
    """
    grid = _on_grid(signals, time)
    if grid is None:
        return
    for _ in range(_MAX_FAULTS):
        worst = _worst_fault(grid)
        if worst is None:
            break
        fault, pair, axis = worst
        yield Inconsistency(f"{pair.name} disagrees with {pair.text(axis)}: {fault.text}", fault.signals)
        grid = grid.repaired(fault)
    for exact_pair in (each for each in _pairs(grid).values() if each.is_exact):
        excited = exact_pair.excited(factor=2.0)
        if excited.any() and exact_pair.disagreement()[excited].min() > _MIN_CONTRADICTION:
            text = f"{exact_pair.name} contradicts {exact_pair.text(int(np.argmax(excited)))}"
            yield Inconsistency(text, (exact_pair.name,))
        elif excited.any():
            centred_pair = exact_pair._replace(centred=True, threshold=min(exact_pair.threshold, _MIN_SHIFT_AMPLITUDE))
            for text in _shift(centred_pair, grid.step, centred_pair.excited(factor=2.0)):
                yield Inconsistency(text)


def _on_grid(signals: Mapping[str, np.ndarray], time: np.ndarray) -> _Grid | None:
    """Return the signals on a grid; None if the log is too short to compare them."""
    period = float(np.median(np.diff(time)))
    step = max(period, _GRID_STEP)
    count = int((time[-1] - time[0]) / step)
    first = max(count - _MAX_GRID_SIZE, 0) // 2
    edges = time[0] + step * np.arange(first, min(count, first + _MAX_GRID_SIZE) + 1)
    if len(edges) < _MIN_WINDOWS:
        return None
    means = {}
    for name in AXES:
        if name in signals:
            values = np.unwrap(signals[name], axis=0) if name.startswith("attitude") else signals[name]
            integral = _cumulative_integral(values, np.diff(time))
            at_edges = np.column_stack([np.interp(edges, time, column) for column in integral.T])
            means[name] = np.diff(at_edges, axis=0) / step
    usable = np.ones(len(edges) - 1, dtype=bool)
    for gap in np.flatnonzero(np.diff(time) > max(3.0 * period, 0.5 * _ROTATION_WINDOW)):
        usable &= (edges[1:] <= time[gap]) | (edges[:-1] >= time[gap + 1])
    return _Grid(means, step, usable)


def _all_means(values: np.ndarray, width: int) -> np.ndarray:
    """Return the means (n - width, columns) over all windows of `width` steps."""
    integral = _cumulative_integral(values, 1.0)
    return np.asarray((integral[width:] - integral[:-width]) / width)


def _cumulative_integral(values: np.ndarray, steps: np.ndarray | float) -> np.ndarray:
    """Return the integral (n, columns) from the first sample to each sample, by the trapezoidal rule."""
    areas = 0.5 * (values[1:] + values[:-1]) * np.reshape(steps, (-1, 1))
    return np.vstack([np.zeros(values.shape[1]), np.cumsum(areas, axis=0)])


def _pairs(grid: _Grid, changed: Iterable[str] | None = None) -> dict["_Comparison", _Pair]:
    """Return the pairs of signals that can be compared. The keys are the functions of `_COMPARISONS`.

    Pairs with too few windows, and pairs that need motion in a log without motion, are left out.

    Args:
        grid: signals of the log.
        changed: names of signals; if given, only the pairs that depend on them are returned.
    """
    pairs = {}
    for compare, groups in _COMPARISONS:
        is_logged = all(any(name in grid.signals for name in names) for names in groups)
        is_affected = changed is None or any(not set(names).isdisjoint(changed) for names in groups)
        if is_logged and is_affected and (_MOTION_SIGNALS not in groups or grid.is_moving):
            pair = compare(grid)
            if len(pair.expected) >= _MIN_WINDOWS:
                pairs[compare] = pair
    return pairs


def _derivative(position: str, velocity: str, grid: _Grid, *, is_exact: bool = True) -> _Pair:
    width = grid.num_steps(_TRANSLATION_WINDOW)
    expected, measured = grid.rate(grid.signals[position], width), grid.mean(grid.signals[velocity], width)
    other = f"the derivative of {position}"
    return _Pair(velocity, other, expected, measured, 0.05, AXES[velocity], is_exact=is_exact)


def _attitude_and_rates(grid: _Grid) -> _Pair:
    measured = grid.mean(grid.signals["body_rates"], grid.num_steps(_ROTATION_WINDOW))
    return _Pair("body_rates", "the derivative of attitude", grid.turn_rate, measured, 0.05, AXES["body_rates"])


def _horizontal_force(grid: _Grid) -> _Pair:
    expected, measured = grid.expected_force[:, :2], grid.force_in_world[:, :2]
    return _Pair("specific_force", "the acceleration and the tilt", expected, measured, 0.2, ("x", "y"))


def _vertical_force(grid: _Grid) -> _Pair:
    expected, measured = grid.expected_force[:, 2:], grid.force_in_world[:, 2:]
    return _Pair("specific_force", "the acceleration and gravity", expected, measured, 1.0, ("z",), centred=False)


def _force_in_body(grid: _Grid) -> _Pair:
    expected = grid.expected_force_in_body[:, :2]
    measured = grid.mean(grid.signals["specific_force"], grid.num_steps(_TRANSLATION_WINDOW))[:, :2]
    # The specific force along x and y of the body is only drag, which is smaller than the error caused by the tilt.
    # Expected and measured values therefore often differ in correct logs, but never have opposite signs.
    other = "the acceleration and the tilt, in the body,"
    return _Pair(
        "specific_force", other, expected, measured, 0.1, ("x", "y"), is_exact=False, suspicious=_OPPOSITE_DISAGREEMENT
    )


def _size_of_force(grid: _Grid) -> _Pair:
    force = grid.signals["specific_force"]
    size = np.linalg.norm(force, axis=1, keepdims=True)[grid.starts(0)] * np.sign(np.median(force[:, 2]))
    expected = np.full_like(size, GRAVITY)
    return _Pair("specific_force", "gravity", expected, size, 1.0, ("z",), centred=False, is_exact=False)


def _tilt(grid: _Grid) -> _Pair:
    """Return a pair of horizontal accelerations: from the velocity, and from the tilt, with a thrust along body z."""
    expected, measured = grid.expected_force[:, :2], grid.tilt_tangent * np.maximum(grid.expected_force[:, 2:], 0.0)
    return _Pair("attitude", "the horizontal acceleration", expected, measured, 0.2, ("x", "y"), is_exact=False)


def _response(command: str, signal: str, threshold: float, columns: int, grid: _Grid) -> _Pair:
    """Return the pair of a command and the signal that follows it, shifted by the delay with the best correlation."""
    width = grid.num_steps(_ROTATION_WINDOW)
    # The delay is estimated from all windows, including those with a gap. The values are transposed, since NumPy sums
    # rows faster than columns.
    commanded, followed = (
        np.ascontiguousarray(_all_means(grid.signals[each][:, :columns], width).T) for each in (command, signal)
    )
    best, best_fit = (followed, commanded), -1.0
    num_windows = commanded.shape[1]
    for delay in range(0, min(round(_MAX_RESPONSE_TIME / grid.step), num_windows // 2), width):
        pair = followed[:, delay:], commanded[:, : num_windows - delay]
        late, early = (values - values.mean(axis=1, keepdims=True) for values in pair)
        # The absolute value makes the choice independent of the command's sign.
        norms = np.sqrt(np.vecdot(early, early) * np.vecdot(late, late))
        fit = float(np.sum(np.abs(np.vecdot(early, late)) / np.maximum(norms, _TINY)))
        if fit > best_fit:
            best, best_fit = pair, fit
    starts = grid.starts(width)
    expected, measured = (side.T[starts[starts < side.shape[1]]] for side in best)
    return _Pair(command, signal, expected, measured, threshold, AXES[signal][:columns], is_exact=False)


# Comparisons of redundant signals. Each comparison has groups of signals. It is possible if at least one signal of
# each group is logged.
_Comparison = Callable[[_Grid], _Pair]
_COMPARISONS: list[tuple[_Comparison, tuple[tuple[str, ...], ...]]] = [
    (partial(_derivative, "position", "velocity"), (("position",), ("velocity",))),
    (_attitude_and_rates, (("attitude",), ("body_rates",))),
    (_horizontal_force, (("attitude",), _MOTION_SIGNALS, ("specific_force",))),
    (_vertical_force, (("attitude",), _MOTION_SIGNALS, ("specific_force",))),
    (_force_in_body, (("attitude",), _MOTION_SIGNALS, ("specific_force",))),
    (_size_of_force, (("specific_force",),)),
    (_tilt, (("attitude",), _MOTION_SIGNALS)),
    # A reference is held between setpoints, which delays the derivative of its position by half a period.
    (
        partial(_derivative, "reference_position", "reference_velocity", is_exact=False),
        (("reference_position",), ("reference_velocity",)),
    ),
    (partial(_response, "reference_position", "position", 0.1, 3), (("reference_position",), ("position",))),
    (partial(_response, "attitude_command", "attitude", 0.03, 2), (("attitude_command",), ("attitude",))),
    (partial(_response, "body_rate_command", "body_rates", 0.1, 3), (("body_rate_command",), ("body_rates",))),
]


def _worst_fault(grid: _Grid) -> tuple[Fault, _Pair, int] | None:
    """Return the fault whose repair makes the signals agree best, with the pair and the axis that it improves most."""
    # Consecutive windows overlap almost completely, so the search uses one window per `_SEARCH_STRIDE`.
    grid = grid.with_stride(grid.num_steps(_SEARCH_STRIDE))
    pairs = _pairs(grid)
    excited = {compare: pair.excited() for compare, pair in pairs.items()}
    before = {compare: pair.disagreement() for compare, pair in pairs.items()}
    is_suspicious = any((before[compare][excited[compare]] > pair.suspicious).any() for compare, pair in pairs.items())
    best, best_gain = None, -_TIE
    for fault in faults(grid.signals):
        if not (is_suspicious or fault.is_frame):
            continue
        gain, max_change, candidate = -_AXIS_COST * fault.num_axes, 0.0, None
        for compare, repaired in _pairs(grid.repaired(fault), fault.signals).items():
            if compare not in pairs:
                continue
            new = repaired.disagreement()
            change = np.where(excited[compare], before[compare] - new, 0.0)
            gain += float(change.sum())
            axis = int(np.argmax(change))
            is_gross = change[axis] > _MIN_IMPROVEMENT + new[axis]
            if change[axis] > max_change and (
                is_gross or (fault.is_frame and _is_other_frame(pairs[compare], repaired))
            ):
                max_change, candidate = float(change[axis]), (fault, pairs[compare], axis)
        if candidate is not None and gain > best_gain + _TIE:
            best, best_gain = candidate, gain
    return best


def _is_other_frame(pair: _Pair, other: _Pair) -> bool:
    """Return whether a pair agrees better in another frame, over the whole log and in most of its parts."""
    errors = []
    for each in (pair, other):
        expected, measured = each.clipped()
        squares = np.mean((expected - measured) ** 2, axis=1)
        errors.append([float(part.mean()) for part in np.array_split(squares, _NUM_PARTS)])
    old, new = np.array(errors)
    return bool(np.sum(new < old) >= _MIN_BETTER_PARTS and new.sum() < _MAX_FRAME_ERROR_RATIO * old.sum())


def clock_shifts(signals: Mapping[str, np.ndarray], time: np.ndarray) -> ClockShifts:
    """Return the lags of the body rates behind the derivative of the attitude, in parts of the log.

    A part lasts two seconds. Parts in which the two signals do not match are left out. If the lags differ by more than
    their errors, the clocks of the two sensors are not synchronised, for example because one sensor is received over a
    radio link.

    Args:
        signals: (n, columns) values of signals, including attitude and body_rates, in SI units and the frames of this
            library.
        time: (n,) increasing times, s.
    """
    grid = _on_grid(signals, time)
    if grid is None:
        return ClockShifts(np.zeros(0), np.zeros(0))
    expected, measured = _attitude_and_rates(grid).clipped()
    max_shift, count = grid.num_steps(_MAX_CLOCK_SHIFT), grid.num_steps(_CLOCK_PART_DURATION)
    rows = []
    for first in range(max_shift, len(expected) - count - max_shift, count):
        errors = _shift_errors(measured, expected, first, first + count, max_shift)
        lead = _refined_minimum(errors)
        if lead is not None and errors.min() < _MAX_CLOCK_ERROR * np.sum(measured[first : first + count] ** 2):
            # If the second derivative of the sum of squared errors is E'' and the errors are independent with the
            # variance σ², the variance of the lag is 2 σ² / E''. Here, overlapping windows have dependent errors, so
            # the variance is multiplied by the number of windows that overlap.
            variance = grid.num_steps(_ROTATION_WINDOW) * errors.min() / measured[first : first + count].size
            index = int(np.argmin(errors))
            curvature = errors[index - 1] - 2.0 * errors[index] + errors[index + 1]
            rows.append([grid.step * (max_shift - lead), grid.step * math.sqrt(2.0 * variance / curvature)])
    return ClockShifts(*np.array(rows).reshape(-1, 2).T)


def _shift_errors(values: np.ndarray, others: np.ndarray, first: int, end: int, max_shift: int) -> np.ndarray:
    """Return the squared errors (2 max_shift + 1,) between two signals, for each shift of the second one.

    Args:
        values: (w, axes) values.
        others: (w, axes) values of the other signal.
        first: first row that is compared.
        end: row after the last row that is compared.
        max_shift: largest shift, in rows.
    """
    shifts = range(-max_shift, max_shift + 1)
    return np.array([np.sum((values[first:end] - others[first + shift : end + shift]) ** 2) for shift in shifts])


def _refined_minimum(errors: np.ndarray) -> float | None:
    """Return the fractional index of the smallest error, refined by a parabola; None if it is the first or last one."""
    index = int(np.argmin(errors))
    if not 0 < index < len(errors) - 1:
        return None
    before, lowest, after = errors[index - 1 : index + 2]
    return index + 0.5 * (before - after) / (before - 2.0 * lowest + after)


def _shift(pair: _Pair, step: float, excited: np.ndarray) -> Iterator[str]:
    """Yield a remark if one side of a pair lags the other, as the parts of the log consistently show."""
    max_shift = round(_MAX_SHIFT / step)
    expected, measured = (side[:, excited] for side in pair.clipped())
    if max_shift < 1 or not excited.any() or len(expected) < 2 * max_shift + _NUM_PARTS * _MIN_WINDOWS // 2:
        return
    shifts = []
    for part in np.array_split(np.arange(max_shift, len(expected) - max_shift), _NUM_PARTS):
        lowest = _refined_minimum(_shift_errors(expected, measured, part[0], part[-1] + 1, max_shift))
        if lowest is None:
            return
        shifts.append(lowest - max_shift)
    mean = step * float(np.mean(shifts))
    error = step * float(np.std(shifts, ddof=1)) / math.sqrt(_NUM_PARTS)
    if abs(mean) > _MIN_SHIFT + _SHIFT_SIGMAS * error:
        yield (
            f"{pair.name} is {1e3 * abs(mean):.0f} ± {2e3 * error:.0f} ms {'behind' if mean > 0.0 else 'ahead of'}"
            f" {pair.other}: their clocks are shifted, or one of them is filtered"
        )
