"""Simulation of a complete flight, and its metrics."""

import math

import numpy as np

from oracle.autopilot import AUTOPILOTS, vehicle_of
from oracle.control import Controller
from oracle.laboratory import Cameras, Link
from oracle.obstacles import Obstacles
from oracle.vehicle import allocate
from oracle.wind import Wind


def reference_at(trajectory, times):
    """Return the reference at given times from a trajectory of position (rows 0 to 2) and yaw (row 9)."""
    values = [trajectory.MakeDerivative(order).vector_values(times) for order in range(5)]
    path = ("position", "velocity", "acceleration", "jerk", "snap")
    turn = ("yaw", "yaw_rate", "yaw_acceleration")
    return [
        {name: values[order][0:3, i] for order, name in enumerate(path)}
        | {name: values[order][9, i] for order, name in enumerate(turn)}
        for i in range(len(times))
    ]


def fly(scenario, plan):
    """Fly a scenario with a time step from hover at the first point of the reference.

    At each instant, the vehicle first takes its step with the commands that were held until then. Then all sampled
    systems act at once: the control reads the previous frame, the autopilot reads the previous output of the link, and
    the next step of the vehicle uses the new outputs of link and autopilot.

    Args:
        scenario: scenario without distributions.
        plan: plan of its route.

    Returns:
        Signals by name, (ticks, components) arrays at the control ticks until the end or a crash, and the metrics.
    """
    laboratory, h = scenario.laboratory, scenario.vehicle.time_step
    period, seed, sample = laboratory.command_link.period, scenario.seed, scenario.sample or 0
    duration = float(plan.path.times[-1])
    simulated = duration if scenario.duration is None else scenario.duration
    ticks = math.ceil(simulated / period - 1e-9)
    reference = reference_at(plan.reference(), period * np.arange(ticks + 1))
    steps_per_tick, steps_per_frame = round(period / h), round(laboratory.motion_capture.period / h)

    vehicle, kind = vehicle_of(scenario, ticks * period), laboratory.autopilot.kind
    autopilot = AUTOPILOTS[kind](scenario, seed, sample)
    state, speeds = np.zeros(12), vehicle.hover_speeds()
    state[0:3], state[5] = reference[0]["position"], reference[0]["yaw"]
    weight = scenario.nominal.mass * scenario.nominal.gravity
    hover = [weight, 0.0, 0.0, 0.0] if kind == "none" else [weight, 0.0, 0.0, state[5], 0.0, 0.0, 0.0]
    link = Link(laboratory.command_link, np.array(hover), seed, sample)
    command, shortfall = allocate(autopilot.wrench(link.out), scenario.nominal, laboratory.allocation.priority)
    cameras = Cameras(laboratory.motion_capture, seed, sample, state)
    wind = Wind(laboratory.wind, h, seed, sample)
    air = wind.sample(0, state[0:3])

    controller = Controller(scenario, plan.leg_times, duration, state[0:3])
    monitor = Monitor(scenario)
    rows = []
    for k in range(ticks * steps_per_tick + 1):
        received = vehicle.target = link.out
        if k > 0:
            state, speeds = vehicle.step(state, speeds, command, air, k * h, h)
        if k % steps_per_tick == 0:
            tick = k // steps_per_tick
            target, measured = reference[tick], cameras.out
            commanded = controller.act(tick, measured, target)
            true = {"state": vehicle.output_state(state), "rotor_speed": speeds, "measurement": measured, "wind": air}
            if kind != "none":
                commanded["wrench"] = autopilot.wrench(received)
            allocated = {"rotor_speed_command": command, "shortfall": shortfall}
            rows.append({"reference": reference_signal(target), **commanded, **true, **allocated})
            u = commanded["acceleration_command"]
            if not monitor.observe(tick * period, state, target["position"], u, shortfall):
                break
            link.send(tick, commanded["wrench" if kind == "none" else "attitude_target"])
        if autopilot.steps and k % autopilot.steps == 0:
            autopilot.act(k // autopilot.steps, state, received)
        if k % steps_per_tick == 0 or autopilot.steps:
            command, shortfall = allocate(autopilot.wrench(link.out), scenario.nominal, laboratory.allocation.priority)
        if k > 0:
            air = wind.sample(k, state[0:3])
        # At time zero the cameras already have an output. They measure only if they have a velocity drift, since the
        # drift gets its first value at time zero.
        if k % steps_per_frame == 0 and (k > 0 or cameras.drifts):
            cameras.measure(k // steps_per_frame, vehicle.output_state(state))
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}, monitor.metrics(period)


def reference_signal(target):
    """Return the components of the reference signal in order."""
    names = ("position", "velocity", "acceleration", "yaw", "yaw_rate")
    return np.concatenate([np.atleast_1d(target[name]) for name in names])


class Monitor:
    """Monitor that detects a crash and records the data from which the metrics are computed."""

    def __init__(self, scenario):
        self.limits, self.window = scenario.crash, scenario.metrics
        self.obstacles = Obstacles(scenario)
        self.errors, self.commands, self.saturated, self.crash_time = [], [], [], math.inf

    def observe(self, time, state, reference, command, shortfall):
        """Return whether the vehicle still flies; record the tick unless the vehicle crashes at it."""
        error = reference - state[0:3]
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
        """Return the metrics by name."""
        errors, commands = np.array(self.errors), np.array(self.commands)
        duration = period * (len(errors) - 1)
        metrics = {
            "rmse": math.sqrt(np.mean(np.sum(errors**2, axis=1))),
            "peak_error": np.linalg.norm(errors, axis=1).max(),
            "saturated_fraction": np.mean(self.saturated),
            "crash_time": self.crash_time,
        }
        for i, axis in enumerate("xyz"):
            metrics |= {
                f"rmse_{axis}": math.sqrt(np.mean(errors[:, i] ** 2)),
                f"effort_{axis}": np.mean(commands[:, i] ** 2),
                f"variation_{axis}": np.abs(np.diff(commands[:, i])).sum() / duration,
            }
        return metrics
