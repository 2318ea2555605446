"""System for a policy that is a Python function, such as a model of a machine learning library."""

from collections.abc import Callable
from typing import Any

import numpy as np
from pydrake.systems.framework import Context, LeafSystem

from drake_quad.errors import InputError, check_integer, short_repr
from drake_quad.gym.real_numbers import MAX_ACTION, real_numbers, single_precision
from drake_quad.scenario.models import Scenario


class FunctionPolicy(LeafSystem):
    """System from `observation` to `action` that evaluates a Python function instead of a network.

    The system replaces the network in `simulate(scenario, policy=...)`. The argument `policy` of
    `run_monte_carlo(scenario, n, policy=...)` must be a function that creates the system for a given number of
    vehicles. A compiled diagram calls the policy's function once per tick. This function must be stateless: its result
    may depend only on the observation.

    Args:
        scenario: scenario with a control of kind `policy`, such as the `scenario` of an environment.
        function: function that returns (N, components) actions, given (N, components) observations in single precision.
        num_vehicles: number N of vehicles.

    Raises:
        InputError: if the control of the scenario is not a policy; during a flight, if the actions have the wrong
            shape, are not real numbers, or are finite with an absolute value above 1,000,000. An action that is NaN or
            infinite ends the flight of its vehicle instead; see `Flight.cause`.
    """

    def __init__(self, scenario: Scenario, function: Callable[[np.ndarray], Any], num_vehicles: int = 1) -> None:
        super().__init__()
        rows = scenario.control.policy_rows()
        if not rows:
            raise InputError(f"the control of {scenario.name} must be of kind policy to use a policy")
        self._function, self._n = function, check_integer(num_vehicles, "num_vehicles", minimum=1)
        self._rows = rows["action"]
        self.DeclareVectorInputPort("observation", rows["observation"] * self._n)
        self.DeclareVectorOutputPort("action", self._rows * self._n, self._act)

    def _act(self, context: Context, output: Any) -> None:
        observation = self.get_input_port().Eval(context).reshape(-1, self._n).T
        returned = self._function(single_precision(observation))
        actions = real_numbers(returned)
        is_too_large = actions is not None and (np.abs(actions[np.isfinite(actions)]) > MAX_ACTION).any()
        if actions is None or actions.shape != (self._n, self._rows) or is_too_large:
            raise InputError(
                f"the policy must return an array ({self._n}, {self._rows}) of numbers with absolute values of at most"
                f" {MAX_ACTION:,.0f}, but returned {short_repr(returned)} at {context.get_time():.2f} s"
            )
        output.SetFromVector(actions.T.ravel())
