"""What is noted of tests: else every mutant would survive."""

import subprocess
import sys
from pathlib import Path

import pytest

NOTE = """
import sys
sys.path.insert(0, "tests/mutants")
import testing
noted, failed = testing.note("tests/vehicle/test_faults.py")
assert noted and not failed, failed
for name, test in noted.items():
    if "drake_quad/vehicle/faults.py" in test.lines:
        print(name.split("::")[1])
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.version_info < (3, 12), reason="older ones do not tell what lines a test runs")
def test_each_test_that_runs_a_formula_is_noted_though_its_machine_code_is_made_once():
    folder = Path(__file__).parents[2]
    result = subprocess.run([sys.executable, "-c", NOTE], cwd=folder, capture_output=True, text=True, check=True)
    assert {
        *(f"test_battery_sag_reduces_all_rotor_speeds_linearly_in_time[{step}]" for step in ("0.01", "0.0")),
        *(f"test_a_rotor_fails_at_its_time[{step}]" for step in ("0.01", "0.0")),
        "test_vehicles_of_a_fleet_have_individual_faults",
    } <= set(result.stdout.split())
