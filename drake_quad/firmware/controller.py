"""Interface of a flight controller, and the error of a flight controller that fails."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np


class FirmwareError(RuntimeError):
    """Error of a firmware that ended, does not answer, or answers nonsense. The message is one sentence."""


class FlightController(Protocol):
    """Flight controller of one vehicle, which advances in steps of a fixed period.

    A step consists of two calls, so that the whole fleet has its inputs before the simulation waits for an answer.
    """

    @property
    def initial_commands(self) -> Sequence[float]:
        """Commands of rotors 1 to 4 before the first step."""

    def send(self, inputs: np.ndarray) -> None:
        """Start a step, given the inputs of the flight controller, a row of numbers.

        Raises:
            FirmwareError: if the firmware has ended.
        """

    def receive(self) -> Sequence[float]:
        """Wait for the end of the step, and return the (4,) commands of rotors 1 to 4.

        Raises:
            FirmwareError: if the firmware has ended, or does not answer.
        """

    def close(self) -> None:
        """Stop the firmware and free its resources."""
