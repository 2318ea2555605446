"""Time series of sensor readings, computed from a measurement law without a simulator."""

import numpy as np

from drake_quad.framework.records import layout_of


def series(law, parameters, signals, num_readings, num_vehicles=1, seed=None):
    """Return an array (T, rows, N) of T sensor readings of N vehicles.

    Args:
        law: measurement law.
        parameters: parameters of the law.
        signals: function that returns the input signals at a reading, given its number.
        num_readings: number T of readings.
        num_vehicles: number N of vehicles, each with its own noise.
        seed: seed of the noise; None for a sensor without noise.
    """
    rng, readings, memory = np.random.default_rng(seed), [], None
    layout = layout_of(law.reading)
    if law.noise is not None:
        example = law.noise(parameters)
        layout = layout_of(type(example), example)
    for k in range(num_readings):
        noise = None if seed is None else layout.build([*rng.standard_normal((layout.num_rows, num_vehicles))])
        if law.memory is not None and k == 0:
            memory = law.memory.start(parameters, noise, *signals(k))
        elif law.memory is not None:
            memory = law.memory.step(parameters, noise, memory, *signals(k))
        arguments = (parameters, noise) if law.memory is None else (parameters, noise, memory)
        reading = law.formula(*arguments, *signals(k))
        reading = reading.reading if law.can_miss else reading
        readings.append([np.broadcast_to(row, num_vehicles) for row in reading])
    return np.array(readings)
