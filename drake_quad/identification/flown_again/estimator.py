"""What an estimator on board makes of velocity, beside the motion that it estimates.

Where the same estimator logs position p̂ and velocity v̂, the derivative of its position is no independent measurement,
but measurements of position keep it true for good: what v̂ has beside it is an error of v̂. Over means of 0.1 s

    v̂ - dp̂/dt = s v + d

with a share s on axes along which the vehicle was flown, and a rest d that stays on for a while. White noise of the
position, which adds 14 mm/s for each mm, is no part of d: its variance is that by which
p̂ - ∫ v̂ dt scatters within 20 ms.
"""

from typing import NamedTuple

import numpy as np
import scipy

from drake_quad.errors import InputError
from drake_quad.identification.logs.record import FlightRecord
from drake_quad.identification.result import Spread

# Of the mean in which single corrections of an estimator vanish, of the blocks for deviations, and of the beginning of
# a log in which an estimator may still settle, s.
_MEAN, _BLOCK, _BEGINNING = 0.1, 0.5, 0.5
# An axis along which speed varies more is flown, m/s.
_FLOWN = 0.15
# In which a rest hardly changes, s: two steps of a Crazyflie's estimator, which stays the same for 10 ms each time.
_STEP = 0.02
# Blocks by which deviations can be told.
_FEWEST = 2


class VelocityEstimate(NamedTuple):
    """By how much an estimated velocity is off.

    Attributes:
        share: of the velocity on each axis by which it is seen too large; of an axis that was not flown 0, with the
            deviation that those have that were flown.
        drift: (3,) standard deviation of the rest on each axis, in means of 0.1 s, m/s.
        time: correlation time of the rest, mean of the axes, s.
    """

    share: tuple[Spread, Spread, Spread]
    drift: np.ndarray
    time: float


def velocity_estimate(record: FlightRecord) -> VelocityEstimate:
    """How an estimator on board sees velocity.

    Args:
        record: of a vehicle in the air, with estimated position and velocity.

    Raises:
        InputError: one of them is not logged, the log is too short, or the vehicle hovers.
    """
    position, velocity = record.of("position"), record.of("velocity")
    inside = (record.time > record.time[0] + _BEGINNING) & (record.time < record.time[-1] - _MEAN)
    after, before = record.time[inside] + 0.5 * _MEAN, record.time[inside] - 0.5 * _MEAN
    blocks = np.floor(record.time / _BLOCK).astype(int)[inside]
    if len(np.unique(blocks)) < _FEWEST or len(blocks) <= 2 * _steps(record):
        raise InputError(f"{record.name}: is too short to tell how an estimator sees velocity")
    shares, drifts, times = [], [], []
    for axis in range(3):
        # Means by differences of what is integrated: a log need not be even in time.
        gone = scipy.integrate.cumulative_trapezoid(velocity[:, axis], record.time, initial=0.0)
        true, seen = (
            (np.interp(after, record.time, each) - np.interp(before, record.time, each)) / _MEAN
            for each in (position[:, axis], gone)
        )
        off = seen - true
        share = Spread(0.0, np.nan, "1")
        if true.std() > _FLOWN:
            share = _share(true, off, blocks)
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


def _share(true: np.ndarray, off: np.ndarray, blocks: np.ndarray) -> Spread:
    """Slope through zero, with the deviation by which blocks scatter."""
    whole = float(true @ true)
    share = float(true @ off) / whole
    left = np.array([np.sum((true * (off - share * true))[blocks == block]) for block in np.unique(blocks)])
    count = len(left)
    return Spread(share, float(np.sqrt(count / (count - 1) * np.sum(left**2))) / whole, "1")


def _steps(record: FlightRecord) -> int:
    """Return the number of samples over which the velocity error hardly changes."""
    return max(1, round(_STEP / record.period))


def _noise(left: np.ndarray, record: FlightRecord, ends: tuple[np.ndarray, np.ndarray]) -> float:
    """Return the variance that white noise of a signal adds to means of the signal's derivative.

    Args:
        left: (n,) consecutive samples of the signal, at the times of the means only: a jump while the estimator still
            settles is not noise.
        record: record that contains the samples.
        ends: end and start of each mean, two arrays (n,) of times, s.
    """
    step = _steps(record)
    variance = float(np.mean((left[2 * step :] - 2.0 * left[step:-step] + left[: -2 * step]) ** 2)) / 6.0
    between = [np.interp(end, record.time, np.arange(len(record.time))) % 1.0 for end in ends]
    return variance / _MEAN**2 * float(sum(np.mean(share**2 + (1.0 - share) ** 2) for share in between))


def _correlation_time(rest: np.ndarray, noise: float) -> int:
    """Return the number of samples after which the autocorrelation, without that of noise, has fallen to 1/e."""
    off = rest - rest.mean()
    # Direct summation would take seconds for a log of several minutes, so the correlation uses Fourier transforms.
    correlation = scipy.signal.correlate(off, off, method="fft")[len(off) - 1 :]
    left = max(0.0, correlation[0] - len(off) * noise)
    return max(1, int(np.argmax(correlation < left / np.e)) or len(off))
