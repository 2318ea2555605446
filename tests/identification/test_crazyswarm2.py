"""Tests of the scenarios of four real Crazyflies: the gains of their controllers, and stability."""

import numpy as np
import pytest

from drake_quad import load_scenario
from drake_quad.linear.closed_loop import closed_loop

# KR (N m), Kw (N m s) and KI (N m/s) of roll, pitch and yaw, from info*.yaml. The gains of log145 are from the log
# itself.
FIRMWARE_GAINS = {
    "08": ([0.010, 0.010, 0.012], [0.0013, 0.0013, 0.002], [0.012, 0.018, 0.015]),
    "100": ([0.009, 0.009, 0.008], [0.001, 0.001, 0.002], [0.024, 0.024, 0.024]),
    "145": ([0.009, 0.009, 0.008], [0.001125, 0.001125, 0.00225], [0.04, 0.04, 0.04]),
    "180": ([0.009, 0.009, 0.009], [0.00125, 0.00125, 0.0025], [0.05, 0.05, 0.05]),
}
SCENARIO_FILE = "crazyswarm2.yaml"


@pytest.mark.parametrize("log", FIRMWARE_GAINS)
def test_gains_times_the_nominal_inertia_are_the_firmware_gains(diagrams, log):
    scenario = load_scenario(f"{diagrams / SCENARIO_FILE}:sheet_{log}")
    attitude, inertia = scenario.cascade.attitude, np.array(scenario.nominal.inertia)
    for gains, firmware in zip((attitude.k_p, attitude.k_d, attitude.k_i), FIRMWARE_GAINS[log], strict=True):
        np.testing.assert_allclose(np.array(gains) * inertia, firmware, rtol=2e-4)


@pytest.mark.slow
@pytest.mark.parametrize("log", FIRMWARE_GAINS)
def test_the_loop_is_unstable_with_the_slow_rotors_of_the_data_sheet_vehicle(diagrams, log):
    """The loop is stable with a rotor time constant of 72 ms.

    An axis without integral action has a pole at 1, which counts as stable.
    """
    quick = ["vehicle.rotor_time_constant=0.072", "vehicle.rotor_time_constant_down=null"]
    for overrides, stable in (([], False), (quick, True)):
        loop = closed_loop(load_scenario(f"{diagrams / SCENARIO_FILE}:sheet_{log}", overrides))
        assert (max(abs(loop.system.poles())) < 1.0 + 1e-9) == stable
