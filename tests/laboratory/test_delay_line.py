"""Tests of delays by whole ticks, and of the output before the first sample arrives."""

from typing import NamedTuple

import numpy as np
import pytest
from pydrake.autodiffutils import ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.systems.analysis import Simulator_

from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.framework.records import layout_of
from drake_quad.laboratory.delay_line import declare_delay_line, delay_line_step, latest_sample
from drake_quad.signals import Row


class Pair(NamedTuple):
    first: Row
    second: Row


class Delay(NamedTuple):
    ticks: Row = 0.0


def fill_line(now, longest):
    return now, (now,) * longest


def step_line(now, in_transit, delay):
    return delay_line_step(now, in_transit, delay.ticks)


@fleet_system(float, AutoDiffXd)
class DelaySystem(FleetSystem):
    """System that delays its input by a number of ticks. Until a sample arrives, it outputs the initial input."""

    def declare(self, *, longest=0, parameters=Delay()):
        now, delay = self.input("now", layout=layout_of(Pair)), self.parameter("delay", lambda delay: delay)
        line = declare_delay_line(self, "later", lambda _: Pair(7.0, 8.0), longest)
        self.initialize(fill_line, now, longest, writes=line)
        self.update(1.0, step_line, now, line.in_transit, delay, writes=line)
        self.state_output(line.out)


def outputs_of(system, inputs):
    """Return the output after each tick, for (ticks, size) inputs. The input at the beginning is -1."""
    simulator = Simulator_[system.scalar](system)
    context, outputs = simulator.get_mutable_context(), []
    system.get_input_port().FixValue(context, 0.0 * inputs[0] - 1.0)
    simulator.Initialize()
    for tick, values in enumerate(inputs):
        # The simulator executes a pending update when it advances, with the input at that time.
        if tick:
            simulator.AdvanceTo(float(tick))
        outputs.append(system.get_output_port().Eval(context))
        system.get_input_port().FixValue(context, values)
    simulator.AdvancePendingEvents()
    outputs.append(system.get_output_port().Eval(context))
    return np.array(outputs[1:])


@pytest.mark.parametrize(("delay", "longest"), [(0, 0), *((d, n) for d in range(4) for n in (3, 5))])
def test_the_output_is_the_first_input_until_a_delayed_sample_arrives(delay, longest):
    inputs = np.arange(1.0, 17.0).reshape(8, 2)
    outputs = outputs_of(DelaySystem(longest=longest, parameters=Delay(delay)), inputs)
    np.testing.assert_array_equal(outputs[:delay], -1.0)
    np.testing.assert_array_equal(outputs[delay:], inputs[: 8 - delay])


def test_each_vehicle_of_a_fleet_has_its_own_delay():
    delays = np.array([2.0, 0.0, 4.0, 1.0])
    inputs = np.random.default_rng(0).normal(size=(9, 2, 4))
    system = DelaySystem(num_vehicles=4, longest=4, parameters=Delay(delays))
    outputs = outputs_of(system, inputs.reshape(9, 8)).reshape(9, 2, 4)
    for i, delay in enumerate(delays.astype(int)):
        np.testing.assert_array_equal(outputs[:delay, :, i], -1.0)
        np.testing.assert_array_equal(outputs[delay:, :, i], inputs[: 9 - delay, :, i])


@pytest.mark.parametrize("delays", [2, np.array([2.0, 0.0, 4.0, 1.0])])
def test_derivatives_of_a_sample_are_delayed_with_its_value(delays):
    inputs = np.random.default_rng(1).normal(size=(9, 8))
    gradients = np.arange(72.0).reshape(72, 1)
    system = DelaySystem(num_vehicles=4, longest=4, parameters=Delay(delays))
    differentiable = InitializeAutoDiff(inputs.ravel(), gradient=gradients).reshape(9, 8)
    outputs = outputs_of(system.ToAutoDiffXd(), differentiable).ravel()
    np.testing.assert_array_equal(ExtractValue(outputs).reshape(9, 8), outputs_of(system, inputs))
    slopes = outputs_of(system, gradients.reshape(9, 8))
    np.testing.assert_array_equal(ExtractGradient(outputs).reshape(9, 8), np.where(slopes == -1.0, 0.0, slopes))


def test_all_states_of_a_delay_line_have_the_initial_value_in_a_default_context():
    system = DelaySystem(longest=2, parameters=Delay(2.0))
    context = system.CreateDefaultContext()
    assert system.get_state(context, "later") == Pair(7.0, 8.0)
    assert system.get_state(context, "later_in_transit") == (Pair(7.0, 8.0), Pair(7.0, 8.0))


def test_the_latest_sample_is_from_the_last_tick():
    """Without delay, the latest sample is the output. Otherwise it is the first sample in transit."""
    assert latest_sample("output", ()) == "output"
    assert latest_sample("output", ("latest sample", "earlier sample")) == "latest sample"
