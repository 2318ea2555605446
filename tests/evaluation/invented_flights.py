"""Invented flights with known statistics."""

import numpy as np

from drake_quad.evaluation.families import FAMILIES
from drake_quad.evaluation.results import SENSITIVITY_VARIANTS, Evaluation, Traits, laboratory_with_laps
from drake_quad.laboratory.metrics import Metrics

NUM_FLIGHTS = 40  # flights of each controller in each laboratory
# The first row contains random deviations that all controllers share. The second row is scaled for each controller.
NOISE = np.random.default_rng(3).normal(size=(2, NUM_FLIGHTS))


def flights(error, *, scatter=0, crashed=()):
    """Return metrics of invented flights.

    Args:
        error: mean error, m.
        scatter: size of the random deviations that only this controller has, in thousandths of the error.
        crashed: samples that crash.
    """
    rmse = error * (1.0 + 0.1 * NOISE[0]) + 0.001 * error * NOISE[1] * scatter
    time = np.full(NUM_FLIGHTS, np.inf)
    time[list(crashed)] = 3.0
    others = {name: np.full(NUM_FLIGHTS, 0.25 + i) for i, name in enumerate(Metrics._fields[1:-1])}
    return Metrics(rmse=rmse, **others, crash_time=time)


def evaluation(type_1_ratio=0.9, type_2_ratio=0.8, *, crashed=()):
    """Return an invented evaluation of PD and INDI, each with and without networks, in the laboratory and outdoors.

    The evaluation also contains `indi@1.6` and `indi@3`, designs with other limits on the peak sensitivity, and flights
    of one to three laps.

    Args:
        type_1_ratio: mean error of PD with a type-1 network, relative to PD.
        type_2_ratio: mean error of PD with a type-2 network, relative to PD with a type-1 network.
        crashed: samples in which PD with a type-2 network crashes outdoors.
    """
    errors = {
        "pd": 0.2,
        "pd_t1fnn": 0.2 * type_1_ratio,
        "pd_t2fnn": 0.2 * type_1_ratio * type_2_ratio,
        "indi": 0.04,
        "indi_t2fnn": 0.04,
    }
    result = {
        laboratory: {name: flights(error, scatter=scatter) for scatter, (name, error) in enumerate(errors.items())}
        for laboratory in (*FAMILIES["laboratory"].laboratories, "outdoor")
    }
    result["outdoor"]["pd_t2fnn"] = flights(0.2 * type_1_ratio * type_2_ratio, scatter=2, crashed=crashed)
    result["high wind"] |= {"indi@1.6": flights(0.06, scatter=5), "indi@3": flights(0.03, scatter=6)}
    for count, error in enumerate((0.2, 0.1, 0.05), start=1):
        result[laboratory_with_laps(count)] = {"pd": flights(0.2), "pd_t2fnn_map": flights(error, scatter=count)}
    traits = {name: Traits(2.2, 0.06, 0.09, 80e-6, 1e-6) for name in errors}
    designs_by_sensitivity = {f"indi@{limit:g}": Traits(limit, 0.05, 0.1 / limit, 1e-4, 1e-6) for limit in (1.6, 3.0)}
    return Evaluation(result, {"laboratory": traits, "outdoor": traits, SENSITIVITY_VARIANTS: designs_by_sensitivity})
