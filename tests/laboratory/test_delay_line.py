"""Delays by whole ticks, and the output before the first sample arrives."""

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


def filled(now, longest):
    return now, (now,) * longest


def a_tick_later(now, under_way, delay):
    return delay_line_step(now, under_way, delay.ticks)


@fleet_system(float, AutoDiffXd)
class Delayed(FleetSystem):
    """System that delays its input by a number of ticks. Before that, the output is the input at the beginning."""

    def declare(self, *, longest=0, numbers=Delay()):
        now, delay = self.input("now", layout=layout_of(Pair)), self.parameter("delay", lambda delay: delay)
        line = declare_delay_line(self, "later", lambda _: Pair(7.0, 8.0), longest)
        self.initialize(filled, now, longest, writes=line)
        self.update(1.0, a_tick_later, now, line.under_way, delay, writes=line)
        self.state_output(line.out)


def shown(system, inputs):
    """Return the output after each tick, for inputs (ticks, size) of one per tick; the input at the beginning is -1."""
    simulator = Simulator_[system.scalar](system)
    context, found = simulator.get_mutable_context(), []
    system.get_input_port().FixValue(context, 0.0 * inputs[0] - 1.0)
    simulator.Initialize()
    for tick, values in enumerate(inputs):
        # A pending update is executed when the simulator advances, with the input at that time.
        if tick:
            simulator.AdvanceTo(float(tick))
        found.append(system.get_output_port().Eval(context))
        system.get_input_port().FixValue(context, values)
    simulator.AdvancePendingEvents()
    found.append(system.get_output_port().Eval(context))
    return np.array(found[1:])


@pytest.mark.parametrize(("delay", "longest"), [(0, 0), *((d, n) for d in range(4) for n in (3, 5))])
def test_before_the_first_sample_arrives_the_output_is_the_initial_one(delay, longest):
    inputs = np.arange(1.0, 17.0).reshape(8, 2)
    found = shown(Delayed(longest=longest, numbers=Delay(delay)), inputs)
    np.testing.assert_array_equal(found[:delay], -1.0)
    np.testing.assert_array_equal(found[delay:], inputs[: 8 - delay])


def test_each_vehicle_of_a_fleet_has_its_own_delay():
    delays = np.array([2.0, 0.0, 4.0, 1.0])
    inputs = np.random.default_rng(0).normal(size=(9, 2, 4))
    system = Delayed(num_vehicles=4, longest=4, numbers=Delay(delays))
    found = shown(system, inputs.reshape(9, 8)).reshape(9, 2, 4)
    for i, delay in enumerate(delays.astype(int)):
        np.testing.assert_array_equal(found[:delay, :, i], -1.0)
        np.testing.assert_array_equal(found[delay:, :, i], inputs[: 9 - delay, :, i])


@pytest.mark.parametrize("delays", [2, np.array([2.0, 0.0, 4.0, 1.0])])
def test_derivatives_are_delayed_like_their_values(delays):
    inputs = np.random.default_rng(1).normal(size=(9, 8))
    gradients = np.arange(72.0).reshape(72, 1)
    system = Delayed(num_vehicles=4, longest=4, numbers=Delay(delays))
    differentiable = InitializeAutoDiff(inputs.ravel(), gradient=gradients).reshape(9, 8)
    found = shown(system.ToAutoDiffXd(), differentiable).ravel()
    np.testing.assert_array_equal(ExtractValue(found).reshape(9, 8), shown(system, inputs))
    slopes = shown(system, gradients.reshape(9, 8))
    np.testing.assert_array_equal(ExtractGradient(found).reshape(9, 8), np.where(slopes == -1.0, 0.0, slopes))


def test_a_line_without_samples_outputs_its_initial_rows():
    system = Delayed(longest=2, numbers=Delay(2.0))
    context = system.CreateDefaultContext()
    assert system.get_state(context, "later") == Pair(7.0, 8.0)
    assert system.get_state(context, "later_under_way") == (Pair(7.0, 8.0), Pair(7.0, 8.0))


def test_latest_sample_is_that_of_the_last_tick():
    """Without delay this is the output, otherwise it is under way."""
    assert latest_sample("out", ()) == "out"
    assert latest_sample("out", ("sampled last", "sampled before")) == "sampled last"
