"""How the consequents learn by a law, as loops over arrays.

It is machine code for numbers, and Python for other scalar types. The functions of the laws have one signature. In
place they change the weights F (R, n), in m/s², and the memory (m, n) of an axis, for some vehicles from `first` on,
given all firing strengths W (R, n), the signal (count,) that those vehicles learn from, the rows (k, count) of their
law, and the period h, in s. A covariance is kept as its upper triangle, row by row.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from drake_quad.compiled import TILE, compiled, loop
from drake_quad.control.fuzzy.laws import CovarianceLaw, GradientLaw, SignLaw
from drake_quad.elementary import exp, log_of_1_plus, maximum, minimum, where


@compiled
def weighted_firing(weights: np.ndarray, firing: np.ndarray, axes: np.ndarray, num_rules: int) -> np.ndarray:
    """τ_f = Fᵀ W, (3 N,) in m/s², zero on axes that the network does not have.

    Args:
        weights: F, R rows for each axis of the network, m/s².
        firing: W, likewise.
        axes: where they are among X, Y, Z.
        num_rules: R.
    """
    n = len(weights) // (len(axes) * num_rules)
    result, row = np.zeros_like(weights[0 : 3 * n]), 0
    for axis in axes:
        on_axis = result[axis * n : (axis + 1) * n]
        for _ in range(num_rules):
            f, w = weights[row * n : (row + 1) * n], firing[row * n : (row + 1) * n]
            for i in range(n):
                on_axis[i] += f[i] * w[i]
            row += 1
    return result


@compiled
def traces(memory: np.ndarray, num_axes: int, num_rules: int) -> np.ndarray:
    """Tr P, a row for each axis, of covariances of R (R + 1) / 2 rows each."""
    rows = memory.reshape((num_axes, num_rules * (num_rules + 1) // 2, -1))
    result = np.zeros_like(rows[:, 0])
    for axis in range(num_axes):
        on_axis = trace(rows[axis], num_rules)
        for i in range(len(on_axis)):
            result[axis, i] = on_axis[i]
    return result.ravel()


@loop
def trace(memory: np.ndarray, size: int) -> np.ndarray:
    """Tr P, (n,).

    Args:
        memory: the upper triangles of P, row by row, (R (R + 1) / 2, n).
        size: R.
    """
    total, row = np.zeros_like(memory[0]), 0
    for i in range(size):
        on_diagonal = memory[row]
        for c in range(len(total)):
            total[c] += on_diagonal[c]
        row += size - i
    return total


@loop
def covariance_times(memory: np.ndarray, vector: np.ndarray, first: int, last: int) -> np.ndarray:
    """P W of the channels from `first` to before `last`, (R, last - first).

    Args:
        memory: the upper triangles of P, row by row, (R (R + 1) / 2, n).
        vector: W, (R, n).
        first: of the channels.
        last: of the channels, and one more.
    """
    size, count, row = len(vector), last - first, 0
    product = np.zeros_like(vector[:, first:last])
    for i in range(size):
        v_i = vector[i, first:last]
        for j in range(i, size):
            p_ij, v_j = memory[row, first:last], vector[j, first:last]
            for c in range(count):
                product[i, c] += p_ij[c] * v_j[c]
            if j > i:
                for c in range(count):
                    product[j, c] += p_ij[c] * v_i[c]
            row += 1
    return product


@loop
def subtract_square(memory: np.ndarray, vector: np.ndarray, factor: np.ndarray, first: int) -> None:
    """P - factor g gᵀ of the channels from `first` on, in place.

    Args:
        memory: the upper triangles of P, row by row, (R (R + 1) / 2, n).
        vector: g of those channels, (R, count).
        factor: (count,).
        first: of the channels.
    """
    (size, count), row = vector.shape, 0
    scaled = np.empty_like(factor)
    for i in range(size):
        for c in range(count):
            scaled[c] = factor[c] * vector[i, c]
        for j in range(i, size):
            p_ij, g_j = memory[row, first : first + count], vector[j]
            for c in range(count):
                p_ij[c] -= scaled[c] * g_j[c]
            row += 1


@loop
def _learn_by_covariance(
    weights: np.ndarray,
    memory: np.ndarray,
    firing: np.ndarray,
    signal: np.ndarray,
    law: np.ndarray,
    first: int,
    period: float,
) -> None:
    """Eqs (16) and (17); law: K_D, p₀, μ."""
    size, count = len(firing), len(signal)
    last = first + count
    information = covariance_times(memory, firing, first, last)
    variance, factor = np.zeros_like(signal), np.zeros_like(signal)
    for i in range(size):
        w_i, g_i = firing[i, first:last], information[i]
        for c in range(count):
            variance[c] += w_i[c] * g_i[c]
    for c in range(count):
        factor[c] = period / (1.0 + period * variance[c])
    subtract_square(memory, information, factor, first)
    for c in range(count):
        factor[c] = law[0, c] * signal[c] * log_of_1_plus(period * variance[c]) / variance[c]
    for i in range(size):
        f_i, g_i = weights[i, first:last], information[i]
        for c in range(count):
            f_i[c] -= factor[c] * g_i[c]
    forgets = False
    for c in range(count):
        forgets = forgets or law[2, c] < 1.0
    if forgets:
        kept = trace(memory[:, first:last], size)
        for c in range(count):
            kept[c] = 1.0 - (1.0 - law[2, c]) * maximum(1.0 - kept[c] / (size * law[1, c]), 0.0)
        for row in range(len(memory)):
            p_ij = memory[row, first:last]
            for c in range(count):
                p_ij[c] /= kept[c]


@loop
def _learn_by_gradient(
    weights: np.ndarray,
    memory: np.ndarray,
    firing: np.ndarray,
    signal: np.ndarray,
    law: np.ndarray,
    first: int,
    period: float,
) -> None:
    """Eq (16) with a constant covariance; law: γ."""
    for i in range(len(firing)):
        f_i, w_i = weights[i, first:], firing[i, first:]
        for c in range(len(signal)):
            f_i[c] -= period * law[0, c] * signal[c] * w_i[c]


@loop
def _learn_by_sign(
    weights: np.ndarray,
    memory: np.ndarray,
    firing: np.ndarray,
    signal: np.ndarray,
    law: np.ndarray,
    first: int,
    period: float,
) -> None:
    """The law of `SignLaw`; law: γ, α₀."""
    count, step, slope = len(signal), np.zeros_like(signal), memory[0, first:]
    for i in range(len(firing)):
        w_i = firing[i, first:]
        for c in range(count):
            step[c] += w_i[c] * w_i[c]
    for c in range(count):
        sign = where(signal[c] > 0.0, 1.0, where(signal[c] < 0.0, -1.0, 0.0))
        step[c] = period * slope[c] * sign / step[c]
        slope[c] += 2.0 * period * law[0, c] * abs(signal[c])
    for i in range(len(firing)):
        f_i, w_i = weights[i, first:], firing[i, first:]
        for c in range(count):
            f_i[c] -= w_i[c] * step[c]


@loop
def _learn(
    step: Callable[..., None],
    weights: np.ndarray,
    memory: np.ndarray,
    firing: np.ndarray,
    error: np.ndarray,
    rate: np.ndarray,
    parameters: np.ndarray,
    axes: np.ndarray,
    num_rules: int,
    period: float,
) -> None:
    """Learns for a period, in place, within limits.

    Args:
        step: the function of the law.
        weights: F, R rows for each axis of the network, m/s².
        memory: of the law, its rows for each axis.
        firing: W, R rows for each axis.
        error: 3 rows, of which s_p = rate + λ error is made on each axis. A signal to learn from as it is stands for
            both, with λ = 0.
        rate: 3 rows.
        parameters: λ, the rows of the law, those of `Limits`: (k, N), or (k, 1) for all vehicles.
        axes: of the network, where they are among X, Y, Z.
        num_rules: R.
        period: h, s.
    """
    n = len(error) // 3
    all_weights = weights.reshape((len(axes), num_rules, n))
    all_firing = firing.reshape((len(axes), num_rules, n))
    all_memory = memory.reshape((len(axes), len(memory) // (len(axes) * n), n))
    for a in range(len(axes)):
        e, e_dot = error[axes[a] * n : (axes[a] + 1) * n], rate[axes[a] * n : (axes[a] + 1) * n]
        for first in range(0, n, TILE):
            last = min(first + TILE, n)
            own = _columns(parameters, first, last)
            limit, deadzone, leakage = own[-3], own[-2], own[-1]
            signal, kept = np.zeros_like(error[first:last]), np.zeros_like(error[first:last])
            part, part_dot = e[first:last], e_dot[first:last]
            for c in range(last - first):
                surface = part_dot[c] + own[0, c] * part[c]
                signal[c] = where(abs(surface) < deadzone[c], 0.0 * surface, surface)
                kept[c] = exp(-leakage[c] * period)
            for i in range(num_rules):
                f_i = all_weights[a, i, first:last]
                for c in range(last - first):
                    f_i[c] *= kept[c]
            step(all_weights[a], all_memory[a], all_firing[a], signal, own[1:], first, period)
            for i in range(num_rules):
                f_i = all_weights[a, i, first:last]
                for c in range(last - first):
                    f_i[c] = minimum(maximum(f_i[c], -limit[c]), limit[c])


@loop
def _columns(rows: np.ndarray, first: int, last: int) -> np.ndarray:
    """A copy of some columns of an array; its only one stands for all."""
    result = np.empty((rows.shape[0], last - first), rows.dtype)
    for k in range(rows.shape[0]):
        if rows.shape[1] == 1:
            for c in range(last - first):
                result[k, c] = rows[k, 0]
        else:
            row = rows[k, first:last]
            for c in range(last - first):
                result[k, c] = row[c]
    return result


@compiled
def learn_by_covariance(*arguments: Any) -> None:
    """`CovarianceLaw`, within limits; see `LEARNING`."""
    _learn(_learn_by_covariance, *arguments)


@compiled
def learn_by_gradient(*arguments: Any) -> None:
    """`GradientLaw`, within limits; see `LEARNING`."""
    _learn(_learn_by_gradient, *arguments)


@compiled
def learn_by_sign(*arguments: Any) -> None:
    """`SignLaw`, within limits; see `LEARNING`."""
    _learn(_learn_by_sign, *arguments)


# What learns by a law; arguments as for `_learn`, from the weights on.
LEARNING = {CovarianceLaw: learn_by_covariance, GradientLaw: learn_by_gradient, SignLaw: learn_by_sign}
