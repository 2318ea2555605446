"""Random scenarios that combine the options of the scenario language."""

import json

import numpy as np

from drake_quad import load_scenario

# Options for each part of a scenario. Every option of a list is used before any is repeated.
STRUCTURES = {
    "position": [
        "pd",
        "pid",
        "disturbance_observer",
        "l1",
        "indi type_2 gradient",
        *(f"pd {kind} {law}" for kind in ("type_1", "type_2") for law in ("covariance", "gradient", "sign")),
        "pid type_2 covariance",
    ],
    "derivative": ["tracking_error", "measurement"],
    "feed_forward": ["none", "acceleration", "jerk", "snap"],
    "axes": [["x", "y"], ["z"], ["y", "z"], ["x", "y", "z"], ["x"]],
    "inputs": [
        {"error": 3, "error_rate": 3},
        {"error": 2, "error_rate": 3},
        {"x": 2, "v_y": 3},
        {"error": 2, "y": 2, "phase": 3},
        {"error_rate": 2, "z": 2, "v_x": 2, "phase": 2},
    ],
    "signal": ["surface", "feedback"],
    "adapts": ["", "centres widths", "exponents", "", "widths exponents"],
    "reset": ["never", "at_segments"],
    "limited": [False, True],
    "leaks": [False, True],
    "deadzone": [False, True],
    "kinematics": ["exact", "small_angle"],
    "drag": ["", "linear quadratic", "linear", "quadratic"],
    "failure": [False, True, True],
    "sags": [False, True],
    "unbalanced": [False, True],
    "layout": ["plus", "x", "h", "rotors"],
    "lags": [False, True],
    "noise": ["", "position attitude", "position", "attitude"],
    "misaligned": [False, True],
    "filtered": [False, True],
    "loses_frames": [False, True],
    "latency": [[0], [1], [2], [0, 3]],
    "delay": [[0], [1], [1, 3], [2]],
    "loses_packets": [False, True],
    "wind": [
        "",
        "steady",
        "gust sine steady",
        "dryden",
        "fan",
        "steady dryden dryden",
        "fan steady fan",
        "gust dryden fan",
        "steady gust dryden fan fan dryden steady gust",
    ],
    # Periods of vehicle, cameras and link, s.
    "periods": [
        (0.01, 0.01, 0.02),
        (0.005, 0.01, 0.02),
        (0.01, 0.02, 0.02),
        (0.01, 0.04, 0.02),
        (0.02, 0.02, 0.02),
        (0.01, 0.01, 0.01),
        (0.0025, 0.005, 0.02),
        (0.01, 0.02, 0.01),
        (0.008, 0.016, 0.032),
    ],
    "route": ["figure_eight", "hover", "circle", "waypoints", "trajectory", "laps"],
    "window": [False, True],
    "crash": [5.0, 0.3, 5.0, 0.1],
    "effects": [
        "",
        "body_drag rotor_time_constant_down",
        "rotor_aerodynamics payload trim_force",
        "reaction_torque ground_effect motors",
        "slung_load",
        "battery body_drag rotor_aerodynamics",
        "body_drag rotor_aerodynamics ground_effect reaction_torque rotor_time_constant_down motors payload battery",
    ],
    "autopilot": ["none", "attitude", "none", "response"],
    "attitude": ["pd", "geometric", "indi", "geometric with integral"],
    "response": ["commanded", "tilt"],
    "on_board": ["", "gyroscope", "attitude", "gyroscope attitude"],
    "network_leads": [False, True],
    "priority": ["roll_pitch", "thrust"],
    "terms": ["", "attitude rate drag", "weight filter rate"],
}


# Replacements for feed-forward terms that an autopilot does not support.
FEED_FORWARD_REPLACEMENTS = {
    "none": {},
    "attitude": {"snap": "jerk"},
    "response": {"snap": "acceleration", "jerk": "none"},
}


def structures(rng, count):
    """Return `count` random structures. A structure maps each part of a scenario to one of its options."""
    columns = {name: rng.permutation(np.arange(count) % len(options)) for name, options in STRUCTURES.items()}
    return [{name: STRUCTURES[name][column[i]] for name, column in columns.items()} for i in range(count)]


def scenario_of(structure, rng, folder, *, duration):
    """Return a scenario with the options of a structure, in which physical quantities have random distributions.

    Args:
        structure: structure from `structures`.
        rng: random number generator of NumPy.
        folder: folder for the file of the scenario.
        duration: duration of the flight, s.
    """
    path = folder / "random.yaml"
    path.write_text(json.dumps({"random": _tree(structure, rng, duration)}))
    return load_scenario(f"{path}:random")


def _tree(structure, rng, duration):
    draw = _Draw(rng)
    time_step, frames, ticks = structure["periods"]
    on_the_ground = structure["autopilot"] == "none"
    if structure["autopilot"] == "attitude":
        time_step = min(time_step, 0.25 * ticks)
    vehicle = {
        "mass": draw(0.64, 0.74),
        "inertia": [draw(0.0065, 0.0075), draw(0.0075, 0.0085), draw(0.012, 0.0135)],
        "attitude_kinematics": structure["kinematics"],
        "time_step": time_step,
    }
    vehicle |= {f"{name}_drag": draw(0.05, 0.2) for name in structure["drag"].split()}
    if structure["failure"] and structure["autopilot"] != "response":
        vehicle["rotor_failure"] = {
            "rotor": {"choice": [1, 2, 3, 4]},
            "time": draw(0.0, duration),
            "speed_factor": draw(0.8, 0.95),
        }
    if structure["sags"]:
        vehicle["battery_sag"] = draw(0.01, 0.05)
    if structure["unbalanced"]:
        vehicle["thrust_factor_error"] = [draw.signed(0.02) for _ in range(4)]
        vehicle["centre_of_mass"] = [draw.signed(0.002) for _ in range(2)]
    if structure["lags"]:
        vehicle["rotor_time_constant"] = draw(0.03, 0.06)
    effects = structure["effects"].split()
    if structure["autopilot"] == "response":
        effects = [name for name in effects if name not in ("payload", "battery", "slung_load", "reaction_torque")]
    vehicle |= {name: _effect(name, draw, duration) for name in effects}
    cameras = {"period": frames, "latency_frames": {"choice": structure["latency"]}}
    cameras |= {f"{name}_noise": draw(0.0005, 0.003) for name in structure["noise"].split()}
    if structure["misaligned"]:
        cameras["misalignment"] = [draw.signed(0.02) for _ in range(3)]
    if structure["filtered"]:
        cameras["derivative_bandwidth"] = draw(50.0, 90.0)
        cameras["velocity_error"] = [draw.signed(0.05) for _ in range(3)]
    if structure["loses_frames"]:
        cameras["dropout_rate"] = draw(0.05, 0.3)
    link = {"period": ticks, "delay_ticks": {"choice": structure["delay"]}}
    if structure["loses_packets"]:
        link["loss_rate"] = draw(0.05, 0.3)
    return {
        "route": _route(structure["route"], rng),
        # The low idle speed makes the short routes feasible with every layout.
        "nominal": {"layout": _layout(structure["layout"], lambda size: size), "min_rotor_speed": 25.0}
        | ({"motors": {"kind": "throttle", "curve": [0.1, 1.0, 2.8]}} if "motors" in effects else {}),
        "vehicle": vehicle | {"layout": _layout(structure["layout"], lambda size: draw(size - 0.002, size + 0.002))},
        "laboratory": {
            "motion_capture": cameras,
            "command_link": link,
            "autopilot": _autopilot(structure, draw, 0.25 * ticks),
            "allocation": {"priority": structure["priority"]},
            "wind": [_wind(kind, draw, duration) for kind in structure["wind"].split()],
        },
        "control": {
            "position": _position(structure, draw),
            "network": _network(structure, draw),
            "attitude": _attitude(structure, draw) if on_the_ground else None,
            "thrust_vectoring": {"max_tilt": draw(0.15, 0.6)},
        },
        "metrics": {"start": 0.21, "end": 0.7 * duration} if structure["window"] else {},
        "crash": {"position_error": structure["crash"]},
        "duration": duration,
        "seed": int(rng.integers(2**62)),
    }


def _effect(name, draw, duration):
    match name:
        case "body_drag":
            centre = [draw.signed(0.002) for _ in range(3)]
            linear, quadratic = [draw(0.02, 0.1) for _ in range(3)], [draw(0.005, 0.02) for _ in range(3)]
            return {"linear": linear, "quadratic": quadratic, "centre_of_pressure": centre}
        case "rotor_aerodynamics":
            air = {"lift": draw(0.005, 0.02), "climb": draw.signed(0.1)}
            return air | {"drag": draw(1e-5, 1e-4), "inflow": draw(1e-5, 1e-4)}
        case "trim_force":
            return {"x": draw.signed(0.02), "y": draw.signed(0.02), "z": draw.signed(0.02)}
        case "ground_effect":
            return {"rotor_radius": draw(0.1, 0.3), "ground_height": draw(0.0, 0.4)}
        case "reaction_torque":
            return True
        case "rotor_time_constant_down":
            return draw(0.03, 0.07)
        case "motors":
            return {"kind": "throttle", "curve": [draw(0.09, 0.11), draw(0.98, 1.02), draw(2.75, 2.85)]}
        case "payload":
            position = [draw.signed(0.002), draw.signed(0.002), draw(-0.06, -0.03)]
            body = {"mass": draw(0.005, 0.03), "position": position, "inertia": [draw(1e-6, 1e-5) for _ in range(3)]}
            return body | {"time": draw(0.0, duration), "event": "dropped"}
        case "battery":
            voltage = {"voltage": draw(12.4, 12.6), "empty_voltage": draw(10.0, 11.0)}
            rest = {"capacity": draw(0.5, 1.0), "resistance": draw(0.01, 0.02), "efficiency": draw(0.6, 0.8)}
            return voltage | rest
        case "slung_load":
            return {"mass": draw(0.005, 0.02), "length": draw(0.3, 0.8)}


class _Draw:
    """Generator of uniform distributions with random bounds."""

    def __init__(self, rng):
        self._rng = rng

    def __call__(self, low, high):
        """Return a uniform distribution over a random subinterval of the interval from `low` to `high`."""
        ends = sorted(self._rng.uniform(low, high, 2).tolist())
        return {"uniform": {"min": ends[0], "max": ends[1]}}

    def signed(self, size):
        return self(-size, size)


def _layout(kind, length_of):
    """Return a layout of rotors.

    Args:
        kind: `kind` of the layout in the scenario language.
        length_of: function from a nominal length (m) to the number or distribution that the layout contains.
    """
    if kind != "rotors":
        return {"kind": kind, "length": length_of(0.3), "width": length_of(0.26), "rotor_1_turns": "anticlockwise"}
    positions = ((0.14, -0.12), (-0.12, -0.13), (-0.13, 0.11), (0.11, 0.14))
    turns = ("clockwise", "anticlockwise") * 2
    rotors = [
        {"position": [length_of(x), length_of(y), length_of(0.02)], "turns": turn}
        for (x, y), turn in zip(positions, turns, strict=True)
    ]
    return {"kind": kind, "rotors": rotors}


def _autopilot(structure, draw, period):
    match structure["autopilot"]:
        case "attitude":
            gains = {"k_attitude": [draw(4.0, 6.0) for _ in range(3)], "k_rate": [draw(10.0, 14.0) for _ in range(3)]}
            bias = {"gyroscope_bias": [draw.signed(0.01) for _ in range(3)]}
            noise = {f"{sensor}_noise": draw(0.001, 0.005) for sensor in structure["on_board"].split()}
            terms = dict(_term(name, draw) for name in structure["terms"].split())
            return {"kind": "attitude", "period": period, **gains, **bias, **noise, **terms}
        case "response":
            numbers = {"natural_frequency": (4.0, 8.0), "damping": (0.4, 1.2)}
            parameters = {name: [draw(*limits) for _ in range(3)] for name, limits in numbers.items()}
            return {"kind": "response", **parameters}
    return {"kind": "none"}


def _term(name, draw):
    """Return the name and the value of an optional field of an autopilot."""
    match name:
        case "weight":
            return "yaw_weight", draw(0.3, 0.6)
        case "filter":
            return "gyroscope_bandwidth", draw(200.0, 300.0)
        case "drag":
            return "neglected_drag", {"tilt_per_speed": draw(0.01, 0.05), "time": draw(0.3, 1.0)}
    size = 0.5 if name == "attitude" else 10.0
    terms = {
        gain: [draw(low, high) for _ in range(3)] for gain, low, high in [("k_i", 0.1, size), ("k_d", 0.001, 0.01)]
    }
    limits = {"integral_limit": [draw(0.1, size) for _ in range(3)], "limit": [draw(2.0, 4.0 * size + 2.0)] * 3}
    filters = {"derivative_bandwidth": [draw(100.0, 200.0)] * 3, "integral_fade": draw(3.0, 7.0)}
    return f"{name}_terms", {**terms, **limits, **filters, "integration": "backward_euler"}


def _attitude(structure, draw):
    gains = {
        "k_p": [draw(8.0, 12.0), draw(8.0, 12.0), draw(4.0, 6.0)],
        "k_d": [draw(5.0, 7.0), draw(5.0, 7.0), draw(2.5, 4.0)],
    }
    match structure["attitude"]:
        case "geometric":
            return {"kind": "geometric", **gains}
        case "geometric with integral":
            options = {"euler_sequence": "zxy", "integration": "backward_euler", "transport_term": False}
            return {"kind": "geometric", **gains, **options, "k_i": [draw(2.0, 4.0) for _ in range(3)]}
        case "indi":
            delay = len(structure["axes"]) - 1
            return {"kind": "indi", **gains, "lag": draw(0.05, 0.1), "bandwidth": draw(2.0, 4.0), "delay_ticks": delay}
    return gains


def _position(structure, draw):
    kind, *_ = structure["position"].split()
    position = {
        "kind": kind,
        "k_p": [draw(1.0, 2.0), draw(1.0, 2.0), draw(4.0, 6.0)],
        "k_d": [draw(1.2, 1.8), draw(1.2, 1.8), draw(2.5, 3.5)],
        "derivative": structure["derivative"],
        "feed_forward": FEED_FORWARD_REPLACEMENTS[structure["autopilot"]].get(
            structure["feed_forward"], structure["feed_forward"]
        ),
    }
    if kind == "pid":
        position |= {"k_i": [draw(0.1, 1.0) for _ in range(3)], "integral_limit": draw(0.01, 0.1)}
        position["integration"] = "backward_euler" if structure["derivative"] == "measurement" else "forward_euler"
    if kind in ("disturbance_observer", "l1", "indi"):
        lags = {"lag": draw(0.04, 0.1)}
        if structure["response"] == "commanded":
            lags = {name: [draw(0.04, 0.2) for _ in range(3)] for name in ("lag", "feed_forward_lag")}
        delay = len(structure["axes"]) - 1
        position["response"] = {"kind": structure["response"], "delay_ticks": delay, **lags}
        position["disturbance_limit"] = draw(0.1, 2.0)
    if kind == "disturbance_observer":
        position |= {"position_noise": 0.002, "deviation": [0.2, 0.3, 0.4], "time_constant": [0.4, 0.5, 0.6]}
    elif kind in ("l1", "indi"):
        position["bandwidth"] = [draw(1.0, 4.0) for _ in range(3)]
    return position


def _network(structure, draw):
    _, *described = structure["position"].split()
    if not described:
        return None
    kind, law = described
    network = {
        "kind": kind,
        "axes": structure["axes"],
        "inputs": {name: _sets(count, draw, circular=name == "phase") for name, count in structure["inputs"].items()},
        "learning": _learning(law, structure, draw),
    }
    adapts = [part for part in structure["adapts"].split() if kind == "type_2" or part != "exponents"]
    if structure["network_leads"]:
        network["lead"] = draw(0.05, 0.2)
    if adapts:
        network["adaptive"] = {part: draw(0.1, 2.0) for part in adapts}
    if kind == "type_2":
        network |= {"a1": draw(1.1, 1.4), "a2": draw(0.6, 0.9), "q": draw(0.2, 0.8)}
    return network


def _sets(count, draw, *, circular):
    if circular:
        centres = [-0.1, 0.3, 0.6] if count == 3 else [0.1, 0.6]
        return {"centres": centres, "widths": [draw(0.5, 0.7) for _ in centres]}
    centres = [-1.0, 0.1, 1.2] if count == 3 else [-0.8, 0.9]
    return {"scale": draw(0.8, 2.0), "centres": centres, "widths": [draw(1.0, 1.4) for _ in centres]}


def _learning(kind, structure, draw):
    learning = {"kind": kind, "initial_weight": draw.signed(0.1)}
    if kind != "sign":
        learning["signal"] = structure["signal"]
    match kind:
        case "covariance":
            learning |= {"gain": draw(0.5, 1.0), "initial_covariance": draw(1.0, 6.0), "slope": draw(1.0, 2.0)}
            learning |= {"reset": structure["reset"], "forgetting": draw(0.98, 1.0)}
        case "gradient":
            learning |= {"rate": draw(0.5, 2.0), "slope": draw(1.0, 2.0)}
        case "sign":
            learning |= {"rate": draw(0.5, 2.0), "initial_slope": draw(0.0, 0.5)}
    if structure["limited"]:
        learning["weight_limit"] = draw(0.05, 0.3)
    if structure["leaks"]:
        learning["leakage"] = draw(0.01, 0.5)
    if structure["deadzone"]:
        learning["deadzone"] = draw(0.005, 0.05)
    return learning


def _wind(kind, draw, duration):
    match kind:
        case "steady":
            motion = {"velocity": [draw.signed(2.0) for _ in range(3)]}
            return {"kind": kind} | motion
        case "gust":
            shape = {"start": draw(0.0, 0.6 * duration), "rise_time": draw(0.1, 0.5), "hold_time": draw(0.0, 0.3)}
            return {"kind": kind, "speed": draw(0.5, 3.0), "heading": draw.signed(3.0), **shape}
        case "sine":
            return {"kind": kind, "velocity": [draw.signed(1.5) for _ in range(3)], "frequency": draw(0.5, 9.0)}
        case "dryden":
            numbers = {"intensity": draw(0.2, 1.0), "height": draw(3.1, 10.0), "airspeed": draw(1.0, 5.0)}
            return {"kind": kind, "level": "light", "heading": draw.signed(3.0), **numbers}
    numbers = {"flow": draw(1.5, 3.0), "diameter": draw(0.5, 0.8), "turbulence": draw(0.1, 0.3)}
    position = {"position": [draw(-3.0, -2.0), draw.signed(1.0), draw(0.5, 1.5)]}
    return {"kind": kind, "direction": [1.0, draw.signed(0.3), draw.signed(0.2)], **position, **numbers}


def _route(kind, rng):
    yaw = float(rng.uniform(-3.0, 3.0))
    match kind:
        case "figure_eight":
            return {"kind": kind, "heading": "along_path"}
        case "laps":
            points = [[0.0, 0.0, 1.0], [0.02, 0.01, 1.01], [0.01, 0.02, 0.99], [0.0, 0.0, 1.0]]
            fields = {"waypoints": points, "times": [0.0, 0.4, 0.75, 1.1], "laps": 3}
            return {"kind": "waypoints", "top_speed": None, "top_acceleration": None, **fields}
        case "hover":
            return {"kind": kind, "position": [0.3, -0.2, 1.0], "yaw": yaw, "duration": 2.0}
        case "circle":
            return {"kind": kind, "radius": 0.8, "laps": 1, "yaw": yaw}
        case "waypoints":
            times = {"waypoints": [[0.0, 0.0, 1.0], [0.2, 0.1, 1.1], [0.1, 0.3, 0.9]], "times": [0.0, 0.7, 1.6]}
            return {"kind": kind, "heading": "along_path", "top_acceleration": None, **times}
    knots = [{"time": time, "position": [0.1 * time, 0.05, 1.0 + 0.1 * time]} for time in (0.0, 0.5, 2.0)]
    return {"kind": kind, "knots": knots, "yaw_knots": [{"time": 0.0, "yaw": yaw}, {"time": 2.0, "yaw": yaw + 0.4}]}
