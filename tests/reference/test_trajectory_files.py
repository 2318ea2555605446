"""Tests of the files of a saved plan."""

import numpy as np
import pytest

from drake_quad.files import read_table
from drake_quad.reference.minimum_snap import minimum_snap
from drake_quad.reference.plan import Plan
from drake_quad.reference.polynomial_path import evaluate, hermite_path
from drake_quad.reference.trajectory_files import save_plan

EXAMPLE_PATH = minimum_snap([[0, 0, 0], [1, 2, 1], [3, 1, 2]], [0.5, 1.5, 3.01])
EXAMPLE_PLAN = Plan(EXAMPLE_PATH, hermite_path(np.array([0.5, 3.01]), np.array([[[0.3], [0.0]], [[0.8], [0.2]]])))


def save_example(plan, folder, **options):
    return save_plan(plan, folder, name="there", **options)[0]


@pytest.mark.parametrize(("options", "period"), [({}, 0.02), ({"period": 0.1}, 0.1)])
def test_a_plan_is_sampled_periodically_and_at_its_end(tmp_path, options, period):
    times = read_table(save_example(EXAMPLE_PLAN, tmp_path, **options))["time (s)"]
    np.testing.assert_allclose(times[:-1], 0.5 + period * np.arange(len(times) - 1), rtol=1e-9)
    assert times[-1] == 3.01
    assert 0.0 < times[-1] - times[-2] <= period


def test_the_saved_table_contains_position_derivatives_and_yaw_to_nine_digits(tmp_path):
    file = save_example(EXAMPLE_PLAN, tmp_path)
    table = read_table(file)
    times = table["time (s)"]
    columns = [*(row for order in range(5) for row in evaluate(EXAMPLE_PLAN.path, times, order))]
    columns += [evaluate(EXAMPLE_PLAN.yaw, times, order)[0] for order in range(2)]
    for (heading, values), expected in zip([*table.items()][1:], columns, strict=True):
        np.testing.assert_allclose(values, expected, rtol=5e-9, atol=1e-12, err_msg=heading)
    first, last = (heading for heading in (*table,)[1::16])
    assert (first, last) == ("x (m)", "yaw_rate (rad/s)")
    digits = [cell.split("e")[0].strip("-0.").replace(".", "") for cell in file.read_text().split()[-1].split(",")]
    assert max(map(len, digits)) == 9


def test_both_files_of_a_saved_plan_end_with_a_line_break(tmp_path):
    table, route, pieces = save_plan(EXAMPLE_PLAN, tmp_path, name="there")
    assert (table.name, route.name, pieces.name) == ("trajectory.csv", "trajectory.yaml", "pieces.csv")
    for file in (table, route, pieces):
        text = file.read_text()
        assert text.endswith("\n")
        assert "" not in text.splitlines()
    assert len(route.read_text().splitlines()) == 5 + 3 + 2


@pytest.mark.slow
def test_a_plan_of_an_hour_is_sampled_less_often(tmp_path):
    times = read_table(save_example(Plan.hover([0.0, 0.0, 1.0], duration=3600.0), tmp_path))["time (s)"]
    assert len(times) == 20_001
    np.testing.assert_allclose(np.diff(times), 0.18, rtol=1e-5)
