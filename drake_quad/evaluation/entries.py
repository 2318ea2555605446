"""Controllers of the evaluation: scenario fields, tuned parameters, and knowledge of the plant.

The ranges of the tuned parameters are the same in all laboratories, and each covers a factor of ten or more. There is
no initial guess, since the search begins with points that are distributed over the ranges.
"""

import math
from collections.abc import Iterable, Mapping
from copy import deepcopy
from typing import Any, NamedTuple

from drake_quad.design.tuning import TuningParameter
from drake_quad.scenario.paths import split_path

Tree = dict[str, Any]


class ControllerEntry(NamedTuple):
    """Controller of the evaluation.

    Attributes:
        label: name in the report.
        plant_knowledge: phrase for the report that lists the plant properties that the controller uses, in addition to
            mass, inertia and reference.
        control: fields of the scenario's `control`; for a controller with a network, only the fields of the network.
        parameters: parameters that are tuned; empty for a controller with a design method that needs no tuning.
        base: name of the base controller to which a network is added; empty for a controller without a network.
        trained_in_laps: True if the controller learns from lap to lap and is therefore trained over several laps.
        uncompiled: True if the controller cannot be compiled, and therefore flies fewer samples.
    """

    label: str
    plant_knowledge: str
    control: Tree = {}  # noqa: RUF012 - the default is never modified
    parameters: tuple[TuningParameter, ...] = ()
    base: str = ""
    trained_in_laps: bool = False
    uncompiled: bool = False

    def tree(self, numbers: Iterable[float]) -> Tree:
        """Return the scenario fields of the controller, as nested mappings."""
        tree = {"control": deepcopy(self.control)}
        for parameter, number in zip(self.parameters, numbers, strict=True):
            for path in parameter.paths:
                *steps, last = split_path(path)
                part: Any = tree
                for step in steps:
                    part = part[_key(step)]
                part[_key(last)] = float(f"{number:.4g}")
        return {"extends": self.base, **tree} if self.base else tree

    def geometric_mean(self) -> Tree:
        """Return the controller with each tuned parameter at the geometric mean of its range, to begin a search."""
        return self.tree(math.sqrt(parameter.low * parameter.high) for parameter in self.parameters)


def _key(step: str) -> str | int:
    return int(step) if step.isdecimal() else step


# Names of the networks in the report, by the suffix of the controller's file name.
NETWORKS = {
    "t1fnn": "type 1",
    "t2fnn": "type 2",
    "t2fnn_adaptive": "type 2, adaptive sets",
    "t2fnn_map": "type 2 over the position",
}
# Controllers to which a type-2 network is added, except the PD controller, to which all kinds of networks are added.
NETWORK_BASES = ("pid", "disturbance_observer", "l1", "indi", "lqg")
# Controllers to which a network with the position as input is added.
POSITION_NETWORK_BASES = ("pd", "indi", "lqg")


def controller_entries(*, on_board: bool, position_networks: bool) -> dict[str, ControllerEntry]:
    """Return all controllers by their names in files. Each controller with a network follows its base controller.

    Args:
        on_board: True if an autopilot on board the vehicle controls the attitude.
        position_networks: True to include networks whose input is the position.
    """
    entries = _controllers(on_board)
    for name in ("pd", *NETWORK_BASES):
        kinds = [kind for kind in NETWORKS if kind == "t2fnn" or name == "pd"]
        for kind in kinds:
            if kind != "t2fnn_map":
                entries[f"{name}_{kind}"] = _network(entries[name], name, kind, _ERROR_INPUTS, _COVARIANCE_LAW)
        if position_networks and name in POSITION_NETWORK_BASES:
            sets = _POSITION_INPUTS_ON_BOARD if on_board else _POSITION_INPUTS
            entries[f"{name}_t2fnn_map"] = _network(entries[name], name, "t2fnn_map", sets, _GRADIENT_LAW)
    return entries


def _horizontal_paths(path: str) -> tuple[str, ...]:
    """Return the paths of a field for X and Y, or for roll and pitch."""
    return f"control.{path}.0", f"control.{path}.1"


def _controllers(on_board: bool) -> dict[str, ControllerEntry]:
    """Return the controllers without a network, by name."""
    mass_only, estimator = "–", "delay (the lag of the thrust is tuned)"
    position_parameters = (
        TuningParameter(_horizontal_paths("position.k_p"), 0.3, 12.0),
        TuningParameter(_horizontal_paths("position.k_d"), 0.5, 8.0),
        TuningParameter(("control.position.k_p.2",), 1.0, 40.0),
        TuningParameter(("control.position.k_d.2",), 1.0, 15.0),
    )
    attitude_parameters = (
        ()
        if on_board
        else (
            TuningParameter(_horizontal_paths("attitude.k_p"), 3.0, 60.0),
            TuningParameter(_horizontal_paths("attitude.k_d"), 2.0, 20.0),
        )
    )
    parameters = (*attitude_parameters, *position_parameters)
    integral = (
        TuningParameter(_horizontal_paths("position.k_i"), 0.05, 5.0),
        TuningParameter(("control.position.k_i.2",), 0.05, 10.0),
    )
    lag = TuningParameter(("control.position.response.lag",), 0.02, 0.4)
    bandwidth = (
        TuningParameter(_horizontal_paths("position.bandwidth"), 0.5, 60.0),
        TuningParameter(("control.position.bandwidth.2",), 0.2, 30.0),
    )
    deviation = (
        TuningParameter(_horizontal_paths("position.deviation"), 0.05, 20.0),
        TuningParameter(("control.position.deviation.2",), 0.001, 5.0),
    )
    attitude_bandwidth = () if on_board else (TuningParameter(("control.attitude.bandwidth",), 0.1, 5.0),)
    estimating: Tree = {"response": {"kind": "tilt", "delay_ticks": 1}}
    if on_board:  # a wind of 12 m/s causes a larger acceleration than the default limit of 5 m/s²
        estimating |= {"disturbance_limit": 20.0}
    plain = _cascade(on_board, {"kind": "pd"})
    incremental = {"kind": "indi", "delay_ticks": 1, "lag": 0.07}

    def estimated(position: Tree) -> Tree:
        return _cascade(on_board, estimating | position, incremental)

    integrating: Tree = {"kind": "pid", "k_i": [1.0, 1.0, 1.0]}
    if on_board:  # the integral must be able to reject the same wind
        integrating |= {"integral_limit": 20.0}
    filtered = {"position_noise": 0.001, "time_constant": [10.0, 10.0, 10.0], "deviation": [1.0, 1.0, 1.0]}
    entries = {
        "pd": ControllerEntry("PD", mass_only, plain, parameters),
        "pid": ControllerEntry("PID", mass_only, _cascade(on_board, integrating), (*parameters, *integral)),
        "geometric": ControllerEntry(
            "PD, geometric attitude", mass_only, _cascade(on_board, {"kind": "pd"}, {"kind": "geometric"}), parameters
        ),
        "disturbance_observer": ControllerEntry(
            "disturbance observer",
            f"{estimator}, noise of the cameras",
            estimated({"kind": "disturbance_observer", **filtered}),
            (*parameters, lag, *deviation, *attitude_bandwidth),
        ),
        "l1": ControllerEntry(
            "L1",
            estimator,
            estimated({"kind": "l1", "bandwidth": [1.0, 1.0, 1.0]}),
            (*parameters, lag, *bandwidth, *attitude_bandwidth),
        ),
        "indi": ControllerEntry(
            "INDI",
            estimator,
            estimated({"kind": "indi", "bandwidth": [1.0, 1.0, 1.0]}),
            (*parameters, lag, *bandwidth, *attitude_bandwidth),
        ),
        "lqg": ControllerEntry("LQG", "delay, lags and noise, with their tolerances; spectrum of the wind"),
        "mpc": ControllerEntry("MPC", "that of LQG; limits of tilt, thrust and snap", uncompiled=True),
    }
    if on_board:
        del entries["geometric"]
    return entries


def _cascade(on_board: bool, position: Tree, attitude: Mapping[str, Any] = {"kind": "pd"}) -> Tree:
    """Return the fields of a cascade whose gains are not yet tuned.

    If an autopilot on board controls the attitude, a wind of 12 m/s requires larger limits on tilt and thrust. They are
    those of vehicles/neural_fly.yaml.
    """
    # The yaw gains are the result of `drake-quad design` for laboratory.yaml.
    gains = {"k_p": [1.0, 1.0, 5.356], "k_d": [1.0, 1.0, 3.456]}
    common = {
        "k_p": [1.0, 1.0, 1.0],
        "k_d": [1.0, 1.0, 1.0],
        "derivative": "tracking_error",
        "feed_forward": "acceleration" if on_board else "snap",
    }
    limits = {"thrust_vectoring": {"max_tilt": 1.2, "min_thrust": 0.1, "max_thrust": 2.2}} if on_board else {}
    return {
        "kind": "cascade",
        **limits,
        "attitude": None if on_board else {**attitude, **gains},
        "position": {"kind": position["kind"], **common, **position},
    }


# Inputs of the networks: the tracking errors (as in the paper) or the position. The fuzzy sets of the position inputs
# for the figure eight are from docs/how_to/learn_in_laps.md. In neural_fly.yaml, which has an autopilot on board, the
# lemniscate is in the X-Z plane.
_ERROR_INPUTS: Tree = {"error": {"scale": 1.0}, "error_rate": {"scale": 1.0}}
_NO_ERROR_INPUTS: Tree = {"error": None, "error_rate": None}
# Fuzzy sets of an input that is scaled to the range from -1 to 1.
_FIVE_SETS: Tree = {"centres": [-1.0, -0.5, 0.0, 0.5, 1.0], "widths": [0.5] * 5}
_POSITION_INPUTS: Tree = _NO_ERROR_INPUTS | {
    "x": {"scale": 0.7, **_FIVE_SETS},
    "y": {"scale": 0.3, "centres": [-1.0, -0.75, -0.5, -0.25, 0.0, 0.25, 0.5, 0.75, 1.0], "widths": [0.25] * 9},
    "z": {"scale": 1.0, "centres": [1.0, 2.0], "widths": [1.0, 1.0]},
}
_POSITION_INPUTS_ON_BOARD: Tree = _NO_ERROR_INPUTS | {
    "x": {"scale": 0.8, **_FIVE_SETS},
    "z": {"scale": 1.0, "centres": [0.75, 1.125, 1.5, 1.875, 2.25], "widths": [0.375] * 5},
}
# Learning laws: the paper's law, which learns from the sliding surface, and a gradient law, which learns from the
# output of the feedback controller.
_COVARIANCE_LAW: Tree = {"kind": "covariance", "signal": "surface"}
_GRADIENT_LAW: Tree = {"kind": "gradient", "signal": "feedback"}
# Ranges of the tuned parameters of each learning law, and of the scales of the error inputs.
_LEARNING_RANGES = {
    "covariance": {"slope": (0.2, 20.0), "gain": (0.01, 10.0), "initial_covariance": (0.1, 100.0)},
    "gradient": {"rate": (0.01, 10.0), "leakage": (0.001, 1.0)},
}
# Ranges in which the tuning varies the scales of the inputs: in 1/m for the error, and in s/m for its rate.
_SCALE_RANGES = {"error": (0.5, 100.0), "error_rate": (0.2, 30.0)}
_ADAPTIVE_PARAMETERS = ("centres", "widths", "exponents")


def _network(base: ControllerEntry, name: str, kind: str, inputs: Tree, law: Tree) -> ControllerEntry:
    """Return a controller with a network.

    Args:
        base: controller to which the network is added.
        name: name of the base controller in files.
        kind: kind of the network, a key of `NETWORKS`.
        inputs: scenario fields of the network's inputs.
        law: scenario fields of the learning law.
    """
    adaptive = kind == "t2fnn_adaptive"
    network: Tree = {"kind": "type_1" if kind == "t1fnn" else "type_2", "axes": ["x", "y"]}
    if kind != "t1fnn":
        network |= {"a1": 1.2, "a2": 0.8, "q": 0.5}
    network |= {
        "inputs": inputs,
        "learning": law,
        "adaptive": dict.fromkeys(_ADAPTIVE_PARAMETERS, 1.0) if adaptive else None,
    }
    path = "control.network"
    parameters = [
        TuningParameter((f"{path}.learning.{field}",), *ends) for field, ends in _LEARNING_RANGES[law["kind"]].items()
    ]
    if inputs is not _ERROR_INPUTS:
        network["lead"] = 0.1
        parameters.append(TuningParameter((f"{path}.lead",), 0.02, 1.0))
    else:
        parameters += [
            TuningParameter((f"{path}.inputs.{field}.scale",), *ends) for field, ends in _SCALE_RANGES.items()
        ]
    if adaptive:
        parameters += [TuningParameter((f"{path}.adaptive.{part}",), 1e-3, 10.0) for part in _ADAPTIVE_PARAMETERS]
    return ControllerEntry(
        f"{base.label} + {NETWORKS[kind]}",
        "that of the controller to which it is added",
        {"network": network},
        tuple(parameters),
        base=name,
        trained_in_laps=inputs is not _ERROR_INPUTS,
    )
