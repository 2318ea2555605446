"""Errors of an on-board velocity estimate, and the drag that follows from it.

If the same estimator logs the position p̂ and the velocity v̂, the derivative of p̂ is not an independent measurement.
Position measurements correct it in the long run, however, so the difference between the two is an error of v̂. In means
over 0.1 s

    v̂ - dp̂/dt = s v + d

with a scale error s on axes along which the vehicle was flown, and a correlated error d. White noise of the position
adds 14 mm/s for each mm and is not part of d. Its variance follows from the scatter of p̂ - ∫ v̂ dt within 20 ms.
"""

from typing import NamedTuple

import numpy as np
import scipy

from drake_quad.errors import InputError
from drake_quad.identification.logs.attitudes import rotations
from drake_quad.identification.logs.record import FlightRecord
from drake_quad.identification.result import Spread
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.winds.source import steady_wind

_MEAN_WINDOW = 0.1  # s, long enough to average out single corrections of an estimator
_BLOCK = 0.5  # s, duration of the blocks whose scatter gives standard deviations
_SETTLING_TIME = 0.5  # s, time at the start of a log in which an estimator may still settle
_MIN_FLOWN_SPEED = 0.15  # m/s, standard deviation of the speed along an axis that counts as flown
_NOISE_STEP = 0.02  # s, two steps of a Crazyflie's estimator; the velocity error hardly changes within them
_MIN_BLOCKS = 2
_DRAG_WINDOW = 0.1  # s, over which force and air speed are averaged
_MIN_AIR_SPEED = 0.2  # m/s, standard deviation of the air speed that determines drag
_MIN_SPEED_RATIO = 0.3  # an axis with a smaller share of the air speed of the other axis takes the drag of that axis


class VelocityEstimate(NamedTuple):
    """Error of an estimated velocity.

    Attributes:
        share: scale error along each axis. For an axis that was not flown, it is 0 with the mean standard deviation of
            the axes that were flown.
        drift: (3,) standard deviation of the correlated error along each axis, in means over 0.1 s, m/s.
        time: correlation time of that error, averaged over the axes, s.
    """

    share: tuple[Spread, Spread, Spread]
    drift: np.ndarray
    time: float


def velocity_estimate(record: FlightRecord) -> VelocityEstimate:
    """Estimate the error of the velocity that an on-board estimator logs.

    Args:
        record: record of a vehicle in the air, with estimated position and velocity.

    Raises:
        InputError: if position or velocity is not logged, the log is too short, or the vehicle hovers.
    """
    position, velocity = record.of("position"), record.of("velocity")
    inside = (record.time > record.time[0] + _SETTLING_TIME) & (record.time < record.time[-1] - _MEAN_WINDOW)
    after, before = record.time[inside] + 0.5 * _MEAN_WINDOW, record.time[inside] - 0.5 * _MEAN_WINDOW
    blocks = np.floor(record.time / _BLOCK).astype(int)[inside]
    if len(np.unique(blocks)) < _MIN_BLOCKS or len(blocks) <= 2 * _steps(record):
        raise InputError(f"{record.name}: is too short to tell how an estimator sees velocity")
    shares, drifts, times = [], [], []
    for axis in range(3):
        # Means are differences of integrals, because the samples of a log need not be equally spaced.
        gone = scipy.integrate.cumulative_trapezoid(velocity[:, axis], record.time, initial=0.0)
        true, seen = (
            (np.interp(after, record.time, each) - np.interp(before, record.time, each)) / _MEAN_WINDOW
            for each in (position[:, axis], gone)
        )
        off = seen - true
        share = Spread(0.0, np.nan, "1")
        if true.std() > _MIN_FLOWN_SPEED:
            share = _slope(true[:, None], off, blocks, "1")
        rest = off - share.value * true
        noise = (1.0 + share.value) ** 2 * _noise((position[:, axis] - gone)[inside], record, (before, after))
        shares.append(share)
        drifts.append(float(np.sqrt(max(0.0, rest.var() - noise))))
        times.append(_correlation_time(rest, noise) * record.period)
    if np.isnan([share.deviation for share in shares]).all():
        raise InputError(f"{record.name}: hovers, which does not tell how an estimator sees velocity")
    usual = float(np.nanmean([share.deviation for share in shares]))
    filled = [share if np.isfinite(share.deviation) else share._replace(deviation=usual) for share in shares]
    return VelocityEstimate((filled[0], filled[1], filled[2]), np.array(drifts), float(np.mean(times)))


def linear_drag(record: FlightRecord, scenario: Scenario) -> tuple[Spread, Spread]:
    """Estimate the linear drag along x and y of the body, N s/m, for a flight too short to determine quadratic drag.

    The drag is the least-squares slope of the force over the air speed. Its standard deviation follows from the scatter
    of blocks. An axis with little air speed takes the drag of the other axis.

    Args:
        record: record with velocity and attitude.
        scenario: scenario with the mass, and with the steady wind if the record has none.

    Raises:
        InputError: if a signal is not logged, the log is too short, or the vehicle hovers.
    """
    turned = rotations(record.of("attitude")).inv()
    velocity = record.of("velocity")
    wind = np.asarray(steady_wind(scenario.laboratory.wind), dtype=float) if record.wind is None else record.wind
    weight = np.array([0.0, 0.0, scenario.vehicle.gravity])
    forces = turned.apply(scenario.vehicle.mass * (np.gradient(velocity, record.time, axis=0) + weight))
    speeds = turned.apply(wind - velocity)
    width = max(1, round(_DRAG_WINDOW / record.period))
    box, inside = np.ones(width) / width, slice(2 * width, -2 * width)
    blocks = np.floor(record.time / _BLOCK).astype(int)[inside]
    if len(np.unique(blocks)) < _MIN_BLOCKS:
        raise InputError(f"{record.name}: is too short to determine drag")
    if speeds[:, :2].std(axis=0).max() < _MIN_AIR_SPEED:
        raise InputError(f"{record.name}: hovers, which does not determine drag")
    airs, pushes = (
        np.stack([np.convolve(column, box, "same")[inside] for column in each[:, :2].T]) for each in (speeds, forces)
    )
    moved = airs.std(axis=1)
    chosen = [axis if moved[axis] > _MIN_SPEED_RATIO * moved.max() else int(np.argmax(moved)) for axis in range(2)]
    lines = [np.column_stack([airs[axis], np.ones_like(airs[axis])]) for axis in chosen]
    along, across = (_slope(rows, pushes[axis], blocks, "N s/m") for rows, axis in zip(lines, chosen, strict=True))
    return along, across


def _slope(rows: np.ndarray, values: np.ndarray, blocks: np.ndarray, unit: str) -> Spread:
    """Return the first least-squares coefficient, with the standard deviation from the scatter of blocks.

    Args:
        rows: (n, k) regressors.
        values: (n,) values that are fitted.
        blocks: (n,) block number of each row.
        unit: unit of the coefficient.
    """
    inverse = np.linalg.inv(rows.T @ rows)
    coefficients = inverse @ rows.T @ values
    left = rows * (values - rows @ coefficients)[:, None]
    scores = np.stack([left[blocks == block].sum(axis=0) for block in np.unique(blocks)])
    covariance = len(scores) / (len(scores) - 1) * inverse @ scores.T @ scores @ inverse
    return Spread(float(coefficients[0]), float(np.sqrt(covariance[0, 0])), unit, len(scores) - 1.0)


def _steps(record: FlightRecord) -> int:
    """Return the number of samples over which the velocity error hardly changes."""
    return max(1, round(_NOISE_STEP / record.period))


def _noise(left: np.ndarray, record: FlightRecord, ends: tuple[np.ndarray, np.ndarray]) -> float:
    """Return the variance that white noise of a signal adds to means of the derivative of the signal.

    Args:
        left: (n,) consecutive samples of the signal, at the times of the means only, since a jump while the estimator
            settles is not noise.
        record: record that contains the samples.
        ends: end and start of each mean, two arrays (n,) of times, s.
    """
    step = _steps(record)
    variance = float(np.mean((left[2 * step :] - 2.0 * left[step:-step] + left[: -2 * step]) ** 2)) / 6.0
    between = [np.interp(end, record.time, np.arange(len(record.time))) % 1.0 for end in ends]
    return variance / _MEAN_WINDOW**2 * float(sum(np.mean(share**2 + (1.0 - share) ** 2) for share in between))


def _correlation_time(rest: np.ndarray, noise: float) -> int:
    """Return the number of samples after which the autocorrelation, without that of the noise, has fallen to 1/e."""
    off = rest - rest.mean()
    # The correlation uses Fourier transforms, since direct summation takes seconds for a log of several minutes.
    correlation = scipy.signal.correlate(off, off, method="fft")[len(off) - 1 :]
    left = max(0.0, correlation[0] - len(off) * noise)
    return max(1, int(np.argmax(correlation < left / np.e)) or len(off))
