"""Tests that the source lines that each test runs are recorded, including those of compiled formulas."""

import subprocess
import sys
from pathlib import Path

import pytest

RECORDING_PROGRAM = """
import sys
sys.path.insert(0, "tests/mutants")
import testing
recorded, failed = testing.record_tests("tests/vehicle/test_faults.py")
assert recorded and not failed, failed
for name, test in recorded.items():
    if "drake_quad/vehicle/faults.py" in test.lines:
        print(name.split("::")[1])
"""


@pytest.mark.long
@pytest.mark.skipif(
    sys.version_info < (3, 12), reason="older versions of Python cannot record the lines that a test runs"
)
def test_each_test_records_the_formulas_that_it_runs_although_their_machine_code_is_cached():
    folder = Path(__file__).parents[2]
    result = subprocess.run(
        [sys.executable, "-c", RECORDING_PROGRAM], cwd=folder, capture_output=True, text=True, check=True
    )
    assert {
        *(f"test_battery_sag_reduces_all_rotor_speeds_linearly_in_time[{step}]" for step in ("0.01", "0.0")),
        *(f"test_a_rotor_fails_at_the_given_time[{step}]" for step in ("0.01", "0.0")),
        "test_vehicles_of_a_fleet_have_individual_faults",
    } <= set(result.stdout.split())
