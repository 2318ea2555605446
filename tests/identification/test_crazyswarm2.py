"""The scenarios of the four Crazyflies: their controller, and the vehicles that it can fly."""

import numpy as np
import pytest

from drake_quad import load_scenario
from drake_quad.linear.closed_loop import closed_loop

# KR, Kw and KI of roll, pitch and yaw: of the info*.yaml, but for KR of log145, of whose log they are. N m and s.
FLOWN = {
    "08": ([0.010, 0.010, 0.012], [0.0013, 0.0013, 0.002], [0.012, 0.018, 0.015]),
    "100": ([0.009, 0.009, 0.008], [0.001, 0.001, 0.002], [0.024, 0.024, 0.024]),
    "145": ([0.009, 0.009, 0.008], [0.001125, 0.001125, 0.00225], [0.04, 0.04, 0.04]),
    "180": ([0.009, 0.009, 0.009], [0.00125, 0.00125, 0.0025], [0.05, 0.05, 0.05]),
}
SCENARIOS = "crazyswarm2.yaml"


@pytest.mark.parametrize("log", FLOWN)
def test_gains_times_the_inertia_that_is_believed_are_those_of_the_firmware(diagrams, log):
    scenario = load_scenario(f"{diagrams / SCENARIOS}:sheet_{log}")
    attitude, inertia = scenario.cascade.attitude, np.array(scenario.nominal.inertia)
    for gains, firmware in zip((attitude.k_p, attitude.k_d, attitude.k_i), FLOWN[log], strict=True):
        np.testing.assert_allclose(np.array(gains) * inertia, firmware, rtol=2e-4)


@pytest.mark.slow
@pytest.mark.parametrize("log", FLOWN)
def test_rotors_as_slow_as_on_the_data_sheet_make_an_unstable_loop_of_it(diagrams, log):
    """By the exact linear model of a tick in hover; with 72 ms it is stable. Without an integral a pole is at one."""
    quick = ["vehicle.rotor_time_constant=0.072", "vehicle.rotor_time_constant_down=null"]
    for overrides, stable in (([], False), (quick, True)):
        loop = closed_loop(load_scenario(f"{diagrams / SCENARIOS}:sheet_{log}", overrides))
        assert (max(abs(loop.system.poles())) < 1.0 + 1e-9) == stable
