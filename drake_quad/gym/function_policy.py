"""A policy in plain Python, such as a model of a library for learning, as a system."""

from collections.abc import Callable
from typing import Any

import numpy as np
from pydrake.systems.framework import Context, LeafSystem

from drake_quad.assembly.policy import policy_rows
from drake_quad.errors import InputError, shown, whole_number
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
        InputError: the scenario has no place for a policy, or, as it flies, the actions have another shape or are not
            finite.
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
        found = self._function(observation.astype(np.float32))
        try:
            actions = np.asarray(found, dtype=float)
        except (TypeError, ValueError):
            actions = np.empty(0)
        if actions.shape != (self._n, self._rows) or not np.isfinite(actions).all():
            raise InputError(
                f"the policy must return ({self._n}, {self._rows}) finite numbers, but returned {shown(found)}"
            )
        output.SetFromVector(actions.T.ravel())
