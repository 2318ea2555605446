"""A policy in plain Python, such as a model of a library for learning, as a system."""

from collections.abc import Callable
from typing import Any

import numpy as np
from pydrake.systems.framework import Context, LeafSystem

from drake_quad.assembly.policy import policy_rows
from drake_quad.errors import InputError, shown, whole_number
from drake_quad.gym.real_numbers import MAX_ACTION, real_numbers, single_precision
from drake_quad.scenario import Scenario


class FunctionPolicy(LeafSystem):
    """System from `observation` to `action` that evaluates a Python function in place of a network.

    The system replaces the network in `simulate(scenario, policy=...)`. In `run_monte_carlo(scenario, n, policy=...)` a
    function of the number of vehicles must create it. A compiled diagram calls the function once per tick. The function
    must be stateless: its result may only depend on the observation.

    Args:
        scenario: scenario with a control of kind `policy`, such as the `scenario` of an environment.
        function: function from (N, rows) observations, in single precision as in environments, to (N, rows) actions.
        num_vehicles: N.

    Raises:
        InputError: if the control of the scenario is not a policy. During a flight: the actions have the wrong shape,
            are not real numbers, are not finite, or exceed 1,000,000 in size.
    """

    def __init__(self, scenario: Scenario, function: Callable[[np.ndarray], Any], num_vehicles: int = 1) -> None:
        super().__init__()
        rows = policy_rows(scenario)
        if not rows:
            raise InputError(f"{scenario.name} has no place for a policy, whose control is of kind policy")
        self._function, self._n = function, whole_number(num_vehicles, "num_vehicles", least=1)
        self._rows = rows["action"]
        self.DeclareVectorInputPort("observation", rows["observation"] * self._n)
        self.DeclareVectorOutputPort("action", self._rows * self._n, self._act)

    def _act(self, context: Context, output: Any) -> None:
        observation = self.get_input_port().Eval(context).reshape(-1, self._n).T
        found = self._function(single_precision(observation))
        actions = real_numbers(found)
        if actions is None or actions.shape != (self._n, self._rows) or not (np.abs(actions) <= MAX_ACTION).all():
            raise InputError(
                f"the policy must return ({self._n}, {self._rows}) finite numbers of at most {MAX_ACTION:,.0f} in size,"
                f" but returned {shown(found)}"
            )
        output.SetFromVector(actions.T.ravel())
