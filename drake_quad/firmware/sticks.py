"""Pulse widths of the channels of a remote control."""

import bisect

import numpy as np


class PulseTable:
    """Pulse width as a function of a command, which interpolates linearly between points.

    Args:
        commands: commands at the points, in increasing or decreasing order.
        pulses: pulse widths at the points, µs.
    """

    def __init__(self, commands: np.ndarray, pulses: np.ndarray) -> None:
        order = np.argsort(commands, kind="stable")
        self._commands: list[float] = commands[order].tolist()
        self._pulses: list[float] = pulses[order].tolist()

    def pulse(self, command: float) -> int:
        """Return the nearest whole pulse width (µs) for a command; commands beyond the points are limited."""
        commands, pulses = self._commands, self._pulses
        index = bisect.bisect_right(commands, command)
        if index == 0:
            return round(pulses[0])
        if index == len(commands):
            return round(pulses[-1])
        low, high = commands[index - 1], commands[index]
        return round(pulses[index - 1] + (pulses[index] - pulses[index - 1]) * (command - low) / (high - low))
