"""Controllers of the evaluation: their fields in a scenario, their tuned numbers, and their knowledge of the plant.

The ranges of the tuned numbers are the same in all laboratories. Each range covers a factor of ten or more. There is no
initial guess, since the search begins with points that are distributed over the ranges.
"""

import math
from collections.abc import Iterable, Mapping
from copy import deepcopy
from typing import Any, NamedTuple

from drake_quad.design.tuning import Knob
from drake_quad.scenario.paths import steps_of

Tree = dict[str, Any]


class ControllerEntry(NamedTuple):
    """Controller of the evaluation.

    Attributes:
        words: name in the report.
        told: phrase that names its knowledge of the plant, in addition to mass, inertia and reference.
        control: fields of the scenario's `control`; for a controller with a network, only the fields of the network.
        knobs: numbers that are tuned; empty for a controller that has its own design method.
        around: name of the base controller to which a network is added; empty for a controller without a network.
        laps: True if the controller learns from lap to lap and is therefore trained in laps.
        slow: True if the controller cannot be compiled, and therefore flies fewer samples.
    """

    words: str
    told: str
    control: Tree = {}  # noqa: RUF012 - the default is never modified
    knobs: tuple[Knob, ...] = ()
    around: str = ""
    laps: bool = False
    slow: bool = False

    def tree(self, numbers: Iterable[float]) -> Tree:
        """Return the controller as part of a scenario.

        Args:
            numbers: values of the knobs.
        """
        tree = {"control": deepcopy(self.control)}
        for knob, number in zip(self.knobs, numbers, strict=True):
            for path in knob.paths:
                *steps, last = steps_of(path)
                part: Any = tree
                for step in steps:
                    part = part[_key(step)]
                part[_key(last)] = float(f"{number:.4g}")
        return {"extends": self.around, **tree} if self.around else tree

    def middle(self) -> Tree:
        """Return the controller with the geometric mean of each range, as the initial scenario of a search."""
        return self.tree(math.sqrt(knob.low * knob.high) for knob in self.knobs)


def _key(step: str) -> str | int:
    return int(step) if step.isdecimal() else step


# Names of the networks in the report, by the suffix of the controller's name.
NETWORKS = {
    "t1fnn": "type 1",
    "t2fnn": "type 2",
    "t2fnn_adaptive": "type 2, adaptive sets",
    "t2fnn_map": "type 2 over the position",
}
# Controllers to which a network of type 2 is added. In addition, every kind of network is added to the PD.
AROUND = ("pid", "disturbance_observer", "l1", "indi", "lqg")
# Controllers to which a network over the position is added.
MAPPED = ("pd", "indi", "lqg")


def entries_of(*, on_board: bool, maps: bool) -> dict[str, ControllerEntry]:
    """Return all controllers by their names in files, each network after its base controller.

    Args:
        on_board: True if an autopilot on board controls the attitude.
        maps: True to include networks over the position.
    """
    found = _controllers(on_board)
    for name in ("pd", *AROUND):
        kinds = [kind for kind in NETWORKS if kind == "t2fnn" or name == "pd"]
        for kind in kinds:
            if kind != "t2fnn_map":
                found[f"{name}_{kind}"] = _network(found[name], name, kind, _ERRORS, _COVARIANCE)
        if maps and name in MAPPED:
            sets = _PLACES_ON_BOARD if on_board else _PLACES
            found[f"{name}_t2fnn_map"] = _network(found[name], name, "t2fnn_map", sets, _FEEDBACK)
    return found


def _both(path: str) -> tuple[str, ...]:
    """Return the paths of the fields of X and Y, or of roll and pitch."""
    return f"control.{path}.0", f"control.{path}.1"


def _controllers(on_board: bool) -> dict[str, ControllerEntry]:
    """Return the controllers without a network, by name."""
    nothing, estimator = "nothing more", "delay; lag of the thrust is tuned"
    position_knobs = (
        Knob(_both("position.k_p"), 0.3, 12.0),
        Knob(_both("position.k_d"), 0.5, 8.0),
        Knob(("control.position.k_p.2",), 1.0, 40.0),
        Knob(("control.position.k_d.2",), 1.0, 15.0),
    )
    attitude_knobs = (
        () if on_board else (Knob(_both("attitude.k_p"), 3.0, 60.0), Knob(_both("attitude.k_d"), 2.0, 20.0))
    )
    knobs = (*attitude_knobs, *position_knobs)
    integral = (Knob(_both("position.k_i"), 0.05, 5.0), Knob(("control.position.k_i.2",), 0.05, 10.0))
    lag = Knob(("control.position.response.lag",), 0.02, 0.4)
    bandwidth = (Knob(_both("position.bandwidth"), 0.5, 60.0), Knob(("control.position.bandwidth.2",), 0.2, 30.0))
    deviation = (Knob(_both("position.deviation"), 0.05, 20.0), Knob(("control.position.deviation.2",), 0.001, 5.0))
    slow = () if on_board else (Knob(("control.attitude.bandwidth",), 0.1, 5.0),)
    estimating: Tree = {"response": {"kind": "tilt", "delay_ticks": 1}}
    if on_board:  # the wind of 12 m/s exceeds the default limit of 5 m/s²
        estimating |= {"disturbance_limit": 20.0}
    plain = _cascade(on_board, {"kind": "pd"})
    incremental = {"kind": "indi", "delay_ticks": 1, "lag": 0.07}

    def estimated(position: Tree) -> Tree:
        return _cascade(on_board, estimating | position, incremental)

    integrating: Tree = {"kind": "pid", "k_i": [1.0, 1.0, 1.0]}
    if on_board:  # the integral must reject the same wind
        integrating |= {"integral_limit": 20.0}
    filtered = {"position_noise": 0.001, "time_constant": [10.0, 10.0, 10.0], "deviation": [1.0, 1.0, 1.0]}
    found = {
        "pd": ControllerEntry("PD", nothing, plain, knobs),
        "pid": ControllerEntry("PID", nothing, _cascade(on_board, integrating), (*knobs, *integral)),
        "geometric": ControllerEntry(
            "PD, geometric attitude", nothing, _cascade(on_board, {"kind": "pd"}, {"kind": "geometric"}), knobs
        ),
        "disturbance_observer": ControllerEntry(
            "disturbance observer",
            f"{estimator}; noise of the cameras",
            estimated({"kind": "disturbance_observer", **filtered}),
            (*knobs, lag, *deviation, *slow),
        ),
        "l1": ControllerEntry(
            "L1", estimator, estimated({"kind": "l1", "bandwidth": [1.0, 1.0, 1.0]}), (*knobs, lag, *bandwidth, *slow)
        ),
        "indi": ControllerEntry(
            "INDI",
            estimator,
            estimated({"kind": "indi", "bandwidth": [1.0, 1.0, 1.0]}),
            (*knobs, lag, *bandwidth, *slow),
        ),
        "lqg": ControllerEntry("LQG", "delay, lags and noise, and how far they may be off; spectrum of the wind"),
        "mpc": ControllerEntry("MPC", "as LQG, and the limits of tilt, thrust and snap", slow=True),
    }
    if on_board:
        del found["geometric"]
    return found


def _cascade(on_board: bool, position: Tree, attitude: Mapping[str, Any] = {"kind": "pd"}) -> Tree:
    """Return the fields of a cascade whose gains are not yet tuned.

    With an autopilot on board, the limits of tilt and thrust are those of vehicles/neural_fly.yaml, which a wind of
    12 m/s requires.
    """
    # The yaw's gains are those of `design_gains.py` for laboratory.yaml.
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


# Inputs of the networks: the errors of the paper, or the position. The sets over the figure eight are those of
# docs/how_to/learn_in_laps.md. With an autopilot on board, the lemniscate of neural_fly.yaml lies in the X-Z plane.
_ERRORS: Tree = {"error": {"scale": 1.0}, "error_rate": {"scale": 1.0}}
_NO_ERRORS: Tree = {"error": None, "error_rate": None}
_FIVE_SETS: Tree = {"centres": [-1.0, -0.5, 0.0, 0.5, 1.0], "widths": [0.5] * 5}
_PLACES: Tree = _NO_ERRORS | {
    "x": {"scale": 0.7, **_FIVE_SETS},
    "y": {"scale": 0.3, "centres": [-1.0, -0.75, -0.5, -0.25, 0.0, 0.25, 0.5, 0.75, 1.0], "widths": [0.25] * 9},
    "z": {"scale": 1.0, "centres": [1.0, 2.0], "widths": [1.0, 1.0]},
}
_PLACES_ON_BOARD: Tree = _NO_ERRORS | {
    "x": {"scale": 0.8, **_FIVE_SETS},
    "z": {"scale": 1.0, "centres": [0.75, 1.125, 1.5, 1.875, 2.25], "widths": [0.375] * 5},
}
# Learning laws: that of the paper, which uses the surface s_p, and a gradient law that uses the feedback.
_COVARIANCE: Tree = {"kind": "covariance", "signal": "surface"}
_FEEDBACK: Tree = {"kind": "gradient", "signal": "feedback"}
_LEARNING_KNOBS = {
    "covariance": {"slope": (0.2, 20.0), "gain": (0.01, 10.0), "initial_covariance": (0.1, 100.0)},
    "gradient": {"rate": (0.01, 10.0), "leakage": (0.001, 1.0)},
}
_SCALES = {"error": (0.5, 100.0), "error_rate": (0.2, 30.0)}
_ADAPTIVE = ("centres", "widths", "exponents")


def _network(base: ControllerEntry, name: str, kind: str, inputs: Tree, law: Tree) -> ControllerEntry:
    """Return a controller with a network.

    Args:
        base: controller without a network.
        name: name of this controller.
        kind: kind of the network, a key of `NETWORKS`.
        inputs: inputs of the network.
        law: learning law.
    """
    adaptive = kind == "t2fnn_adaptive"
    network: Tree = {"kind": "type_1" if kind == "t1fnn" else "type_2", "axes": ["x", "y"]}
    if kind != "t1fnn":
        network |= {"a1": 1.2, "a2": 0.8, "q": 0.5}
    network |= {"inputs": inputs, "learning": law, "adaptive": dict.fromkeys(_ADAPTIVE, 1.0) if adaptive else None}
    path = "control.network"
    knobs = [Knob((f"{path}.learning.{field}",), *ends) for field, ends in _LEARNING_KNOBS[law["kind"]].items()]
    if inputs is not _ERRORS:
        network["lead"] = 0.1
        knobs.append(Knob((f"{path}.lead",), 0.02, 1.0))
    else:
        knobs += [Knob((f"{path}.inputs.{field}.scale",), *ends) for field, ends in _SCALES.items()]
    if adaptive:
        knobs += [Knob((f"{path}.adaptive.{part}",), 1e-3, 10.0) for part in _ADAPTIVE]
    return ControllerEntry(
        f"{base.words} + {NETWORKS[kind]}",
        "as around which it stands",
        {"network": network},
        tuple(knobs),
        around=name,
        laps=inputs is not _ERRORS,
    )
