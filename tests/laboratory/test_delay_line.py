"""Whole ticks of delay, and what is on the line before anything was sampled."""

import numpy as np
import pytest
from pydrake.autodiffutils import ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.systems.analysis import Simulator_

from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.laboratory.delay_line import DelayLine


@fleet_system(float, AutoDiffXd)
class Delayed(FleetSystem):
    """Shows its input a number of ticks later, and at the beginning the input of that time."""

    def declare(self, *, num_vehicles=1, delay=0, longest=None):
        self._now = self.input("now", 2)
        self._line = DelayLine(self, "later", [7.0, 8.0], delay, longest)
        self.DeclareInitializationDiscreteUpdateEvent(self._fill)
        self.DeclarePeriodicDiscreteUpdateEvent(1.0, 0.0, self._tick)
        self.state_output(2, self._line.out)

    def _fill(self, context, discrete_state):
        self.copy(discrete_state.get_mutable_vector(self._line.out), self.EvalVectorInput(context, self._now))
        self._line.fill(discrete_state)

    def _tick(self, context, discrete_state):
        self.copy(self._line.advance(context, discrete_state), self.EvalVectorInput(context, self._now))
        self._line.release(context, discrete_state)


def shown(system, inputs):
    """What is out after each tick of inputs (ticks, size), one a tick; at the beginning the input is -1."""
    simulator = Simulator_[system.scalar](system)
    context, found = simulator.get_mutable_context(), []
    system.get_input_port().FixValue(context, 0.0 * inputs[0] - 1.0)
    simulator.Initialize()
    for tick, values in enumerate(inputs):
        # What is pending at a tick is done on the way to the next, with the input that is there then.
        if tick:
            simulator.AdvanceTo(float(tick))
        found.append(system.get_output_port().Eval(context))
        system.get_input_port().FixValue(context, values)
    simulator.AdvancePendingEvents()
    found.append(system.get_output_port().Eval(context))
    return np.array(found[1:])


@pytest.mark.parametrize("longest", [3, 5])
@pytest.mark.parametrize("delay", [0, 1, 2, 3])
def test_until_the_first_sample_is_out_the_line_shows_what_it_was_filled_with(delay, longest):
    inputs = np.arange(1.0, 17.0).reshape(8, 2)
    found = shown(Delayed(delay=delay, longest=longest), inputs)
    np.testing.assert_array_equal(found[:delay], -1.0)
    np.testing.assert_array_equal(found[delay:], inputs[: 8 - delay])


def test_each_vehicle_of_a_fleet_waits_its_own_time():
    delays = np.array([2.0, 0.0, 4.0, 1.0])
    inputs = np.random.default_rng(0).normal(size=(9, 2, 4))
    found = shown(Delayed(num_vehicles=4, delay=delays), inputs.reshape(9, 8)).reshape(9, 2, 4)
    for i, delay in enumerate(delays.astype(int)):
        np.testing.assert_array_equal(found[:delay, :, i], -1.0)
        np.testing.assert_array_equal(found[delay:, :, i], inputs[: 9 - delay, :, i])


@pytest.mark.parametrize("delays", [2, np.array([2.0, 0.0, 4.0, 1.0])])
def test_derivatives_wait_as_their_numbers_do(delays):
    inputs = np.random.default_rng(1).normal(size=(9, 8))
    gradients = np.arange(72.0).reshape(72, 1)
    system = Delayed(num_vehicles=4, delay=delays).ToAutoDiffXd()
    found = shown(system, InitializeAutoDiff(inputs.ravel(), gradient=gradients).reshape(9, 8)).ravel()
    numbers = shown(Delayed(num_vehicles=4, delay=delays), inputs)
    np.testing.assert_array_equal(ExtractValue(found).reshape(9, 8), numbers)
    slopes = shown(Delayed(num_vehicles=4, delay=delays), gradients.reshape(9, 8))
    np.testing.assert_array_equal(ExtractGradient(found).reshape(9, 8), np.where(slopes == -1.0, 0.0, slopes))


def test_an_unfilled_line_shows_its_initial_rows():
    context = Delayed(delay=2).CreateDefaultContext()
    for group in range(3):
        np.testing.assert_array_equal(context.get_discrete_state(group).CopyToVector(), [7.0, 8.0])
