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
    """A function from observations to actions, in the place of a policy, as a system from `observation` to `action`.

    It stands in for a network in `simulate(scenario, policy=...)` and, made by a function of the number of vehicles, in
    `run_monte_carlo(scenario, n, policy=...)`. A compiled diagram calls it once a tick. It must remember nothing: what
    it does may depend on the observation alone.

    Args:
        scenario: with a control of kind `policy`, such as an environment's `scenario`.
        function: from (N, rows) observations, of single precision as in environments, to (N, rows) actions.
        num_vehicles: N.

    Raises:
        InputError: the scenario has no place for a policy, or, as it flies, the actions have another shape, are no real
            numbers, or are not finite or larger than 1,000,000 in size.
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
