"""Magnitude and correlation time of the disturbances of a vehicle along its plan.

Consider a vehicle with the position, attitude and rotor speeds with which the nominal vehicle would follow the plan.
Because of wind, drag, and deviations from the nominal vehicle, its acceleration differs from the planned acceleration.
The difference is the disturbing acceleration, which a controller must compensate to stay on the plan.
"""

from typing import Any, NamedTuple

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from drake_quad.assembly.laboratory import laboratory_recipes, vehicle_parameters
from drake_quad.geometry.axes import BodyAxes
from drake_quad.laboratory.wind.wind import build_wind
from drake_quad.planning.duration import flight_duration
from drake_quad.planning.feasibility import plan_demand
from drake_quad.planning.nominal import nominal_parameters
from drake_quad.randomness.noise import connect_noise, random_streams
from drake_quad.randomness.streams import StreamKind
from drake_quad.reference.plan import Plan
from drake_quad.reference.polynomial_path import evaluate
from drake_quad.scenario.batch import Batch
from drake_quad.signals import RotorSpeed, Wind
from drake_quad.vehicle.dynamics import Motion
from drake_quad.vehicle.motion import accelerations, rotor_state

# Sampling period, s. Wind and drag change within tenths of a second, which this period resolves.
_SAMPLING_PERIOD = 0.02
# Value of x for which (1 + x) exp(-x) is 1/2. This is the autocorrelation of second-order, critically damped noise with
# time constant T at the lag x T.
_HALF_CORRELATION_LAG = 1.67835


class DisturbanceSamples(NamedTuple):
    """Disturbing accelerations along a plan, sampled at equal steps.

    Attributes:
        step: sampling period, s.
        acceleration: (3, times, N) along the axes of W, m/s².
        angular_acceleration: (2, times, N) disturbing angular accelerations of roll and pitch, rad/s².
    """

    step: float
    acceleration: np.ndarray
    angular_acceleration: np.ndarray


class DisturbanceStatistics(NamedTuple):
    """Statistics of a disturbance, which is the sum of its mean over a flight and its fluctuation around this mean.

    Attributes:
        mean: root mean square, over flights, of the mean over a flight.
        deviation: standard deviation of the fluctuation.
        time: time constant of second-order, critically damped noise whose autocorrelation falls to 1/2 at the same lag
            as the autocorrelation of the fluctuation, s.
    """

    mean: float
    deviation: float
    time: float


def disturbances_along(batch: Batch, plan: Plan) -> DisturbanceSamples:
    """Sample the disturbances of a batch of vehicles along a plan.

    Args:
        batch: samples that determine the vehicles, the wind and the random numbers.
        plan: plan along which the disturbances are sampled.
    """
    scenario, fleet = batch.scenario, batch.fleet_scenario
    times = np.arange(0.0, flight_duration(scenario, plan), _SAMPLING_PERIOD)
    position, velocity, acceleration = (np.array(evaluate(plan.extended_path, times, order)) for order in range(3))
    wind = _wind_along(batch, plan, times, position)
    demand = plan_demand(plan, nominal_parameters(scenario), times)
    # Plan data have the shape (times, 1), and vehicle parameters the shape (N,), so that results have the shape (times,
    # N).
    columns: list[Any] = [np.asarray(row)[:, np.newaxis] for row in (*velocity, *demand.body_rates)]
    angles: list[Any] = [np.asarray(angle)[:, np.newaxis] for angle in demand.attitude]
    speeds: list[Any] = [np.asarray(row)[:, np.newaxis] for row in demand.rotor_speed]
    rotors = RotorSpeed(*speeds)
    parameters = vehicle_parameters(fleet.vehicle)
    # The rotor speeds are given, so throttle curve and battery have no effect. The slung load is not treated as a
    # disturbance.
    effects = fleet.vehicle.effect_parameters()._replace(thrust_curve=None, battery=None, slung_load=None)
    spinning = rotor_state(rotors, rotors, parameters, effects)
    height = position[2][:, np.newaxis]
    axes, motion = BodyAxes.of(*angles), Motion(*columns)
    rates = accelerations(axes, motion, None, height, spinning, Wind(*wind), parameters, effects).motion
    nominal = nominal_parameters(scenario)
    still_air = Wind(0.0, 0.0, 0.0)
    nominal_rotors = rotor_state(rotors, rotors, nominal, effects)
    planned = accelerations(axes, motion, None, height, nominal_rotors, still_air, nominal, effects).motion
    shape = 1, len(times), len(batch)
    linear = [row - a[:, np.newaxis] for row, a in zip((rates.v_x, rates.v_y, rates.v_z), acceleration, strict=True)]
    angular = [rates.p - planned.p, rates.q - planned.q]
    linear_samples, angular_samples = (
        np.concatenate([np.broadcast_to(row, shape) for row in rows]) for rows in (linear, angular)
    )
    return DisturbanceSamples(_SAMPLING_PERIOD, linear_samples, angular_samples)


def disturbance_statistics(disturbance: np.ndarray, step: float) -> DisturbanceStatistics:
    """Return the statistics of one type of disturbance over several flights.

    Args:
        disturbance: (..., times, N) samples of the disturbance.
        step: sampling period, s.
    """
    mean = disturbance.mean(axis=-2, keepdims=True)
    fluctuation = disturbance - mean
    variance = float((fluctuation**2).mean())
    lags = range(1, fluctuation.shape[-2])
    half = next(
        (lag for lag in lags if (fluctuation[..., lag:, :] * fluctuation[..., :-lag, :]).mean() < 0.5 * variance), 1
    )
    return DisturbanceStatistics(
        float(np.sqrt((mean**2).mean())), float(np.sqrt(variance)), half * step / _HALF_CORRELATION_LAG
    )


def _wind_along(batch: Batch, plan: Plan, times: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Return the wind (3, times, N) that the scenario's sources cause at positions (3, times) along a plan, m/s."""
    scenario, N = batch.scenario, len(batch)
    recipes = laboratory_recipes(batch, plan, flight_duration(scenario, plan))
    sources = {path.removeprefix("wind."): each.build(N) for path, each in recipes.items() if path.startswith("wind.")}
    builder = DiagramBuilder()
    streams = random_streams(sources, StreamKind.WIND)
    wind = builder.AddNamedSystem("wind", build_wind(sources, streams=streams, num_vehicles=N))
    ports = {stream: wind.GetInputPort(stream.name) for each in streams.values() for stream in each}
    connect_noise(builder, ports, batch.noise_samples)
    depends_on_position = wind.HasInputPort("state")
    if depends_on_position:
        builder.ExportInput(wind.GetInputPort("state"), "state")
    builder.ExportOutput(wind.GetOutputPort("wind"), "wind")
    diagram = builder.Build()
    simulator = Simulator(diagram)
    context, samples = simulator.get_mutable_context(), []
    other_components = np.zeros(9)  # attitude, velocity and body rates, on which the wind does not depend
    for time, point in zip(times, position.T, strict=True):
        if depends_on_position:
            diagram.GetInputPort("state").FixValue(context, np.repeat([*point, *other_components], N))
        # AdvanceTo does not execute the events at its end time, which draw the noise samples of this instant.
        simulator.AdvanceTo(time)
        simulator.AdvancePendingEvents()
        samples.append(diagram.GetOutputPort("wind").Eval(context).reshape(3, N))
    return np.array(samples).transpose(1, 0, 2)
