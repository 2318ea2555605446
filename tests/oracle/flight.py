"""A whole flight, and its metrics."""

import math

import numpy as np

from oracle.autopilot import ON_BOARD, vehicle_of
from oracle.control import Controller
from oracle.laboratory import Cameras, Link
from oracle.obstacles import Obstacles
from oracle.vehicle import allocate
from oracle.wind import Wind


def reference_at(trajectory, times):
    """What a trajectory of position (rows 0 to 2) and yaw (row 9) asks for at some times, by Drake's derivatives."""
    values = [trajectory.MakeDerivative(order).vector_values(times) for order in range(5)]
    path = ("position", "velocity", "acceleration", "jerk", "snap")
    turn = ("yaw", "yaw_rate", "yaw_acceleration")
    return [
        {name: values[order][0:3, i] for order, name in enumerate(path)}
        | {name: values[order][9, i] for order, name in enumerate(turn)}
        for i in range(len(times))
    ]


def fly(scenario, plan):
    """Fly a scenario of numbers, whose vehicle steps, from hover at the reference's first point.

    At an instant the vehicle takes its step first, under what was held until then. Then all that samples does so at
    once: the control reads the frame before, an autopilot hears what the link let out before, and the vehicle's next
    step takes what link and autopilot let out now.

    Args:
        scenario: scenario without distributions.
        plan: plan of its route.

    Returns:
        The (ticks, rows) signals at the ticks of the control, by name, until the end or a crash, and the metrics.
    """
    laboratory, h = scenario.laboratory, scenario.vehicle.time_step
    period, seed, sample = laboratory.command_link.period, scenario.seed, scenario.sample or 0
    duration = float(plan.path.times[-1])
    wanted = duration if scenario.duration is None else scenario.duration
    ticks = math.ceil(wanted / period - 1e-9)
    reference = reference_at(plan.reference(), period * np.arange(ticks + 1))
    steps_a_tick, steps_a_frame = round(period / h), round(laboratory.motion_capture.period / h)

    vehicle, autopilot = vehicle_of(scenario, ticks * period), laboratory.autopilot.kind
    board = ON_BOARD[autopilot](scenario, seed, sample)
    state, speeds = np.zeros(12), vehicle.hover_speeds()
    state[0:3], state[5] = reference[0]["position"], reference[0]["yaw"]
    weight = scenario.nominal.mass * scenario.nominal.gravity
    hover = [weight, 0.0, 0.0, 0.0] if autopilot == "none" else [weight, 0.0, 0.0, state[5], 0.0, 0.0, 0.0]
    link = Link(laboratory.command_link, np.array(hover), seed, sample)
    command, shortfall = allocate(board.wrench(link.out), scenario.nominal, laboratory.allocation.priority)
    cameras = Cameras(laboratory.motion_capture, seed, sample, state)
    wind = Wind(laboratory.wind, h, seed, sample)
    air = wind.sample(0, state[0:3])

    controller = Controller(scenario, plan.leg_times, duration, state[0:3])
    referee = Referee(scenario)
    rows = []
    for k in range(ticks * steps_a_tick + 1):
        heard = vehicle.target = link.out
        if k > 0:
            state, speeds = vehicle.step(state, speeds, command, air, k * h, h)
        if k % steps_a_tick == 0:
            tick = k // steps_a_tick
            asked, measured = reference[tick], cameras.out
            commanded = controller.act(tick, measured, asked)
            true = {"state": vehicle.shown(state), "rotor_speed": speeds, "measurement": measured, "wind": air}
            if autopilot != "none":
                commanded["wrench"] = board.wrench(heard)
            on_board = {"rotor_speed_command": command, "shortfall": shortfall}
            rows.append({"reference": reference_rows(asked), **commanded, **true, **on_board})
            u = commanded["acceleration_command"]
            if not referee.watch(tick * period, state, asked["position"], u, shortfall):
                break
            link.send(tick, commanded["wrench" if autopilot == "none" else "attitude_target"])
        if board.steps and k % board.steps == 0:
            board.act(k // board.steps, state, heard)
        if k % steps_a_tick == 0 or board.steps:
            command, shortfall = allocate(board.wrench(link.out), scenario.nominal, laboratory.allocation.priority)
        if k > 0:
            air = wind.sample(k, state[0:3])
        # The frame at the beginning is taken once more, and only the drift in it is another.
        if k % steps_a_frame == 0 and (k > 0 or cameras.drifts):
            cameras.take(k // steps_a_frame, vehicle.shown(state))
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}, referee.metrics(period)


def reference_rows(asked):
    """The signal of what is asked for."""
    names = ("position", "velocity", "acceleration", "yaw", "yaw_rate")
    return np.concatenate([np.atleast_1d(asked[name]) for name in names])


class Referee:
    """Calls the crash, and keeps what the metrics are made of."""

    def __init__(self, scenario):
        self.limits, self.window = scenario.crash, scenario.metrics
        self.obstacles = Obstacles(scenario)
        self.errors, self.commands, self.saturated, self.crash_time = [], [], [], math.inf

    def watch(self, time, state, wanted, command, shortfall):
        """Whether the vehicle still flies; the tick of a crash counts no more."""
        error = wanted - state[0:3]
        tilted = np.abs(state[3:5]).max() > self.limits.tilt
        if (
            self.obstacles.touch(state[0:3])
            or tilted
            or np.linalg.norm(error) > self.limits.position_error
            or state[2] < self.limits.height
        ):
            self.crash_time = time
            return False
        if self.window.start <= time <= (math.inf if self.window.end is None else self.window.end):
            self.errors.append(error)
            self.commands.append(command)
            self.saturated.append(np.any(shortfall != 0.0))
        return True

    def metrics(self, period):
        """By name."""
        errors, commands = np.array(self.errors), np.array(self.commands)
        duration = period * (len(errors) - 1)
        found = {
            "rmse": math.sqrt(np.mean(np.sum(errors**2, axis=1))),
            "peak_error": np.linalg.norm(errors, axis=1).max(),
            "saturation_share": np.mean(self.saturated),
            "crash_time": self.crash_time,
        }
        for i, axis in enumerate("xyz"):
            found |= {
                f"rmse_{axis}": math.sqrt(np.mean(errors[:, i] ** 2)),
                f"effort_{axis}": np.mean(commands[:, i] ** 2),
                f"variation_{axis}": np.abs(np.diff(commands[:, i])).sum() / duration,
            }
        return found
