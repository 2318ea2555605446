"""PD position controller with a Kalman filter for the disturbance, in the scenario language."""

import functools
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from drake_quad.control.disturbance.laws import KalmanLaw, KalmanMemory
from drake_quad.scenario.plausible import PLAUSIBLE_POSITION_NOISE
from drake_quad.scenario.position_controllers.controller import POSITION_CONTROLLERS
from drake_quad.scenario.position_controllers.estimating import EstimatingPosition
from drake_quad.scenario.quantities import FixedPositive, FixedPositives, FixedSpans


@POSITION_CONTROLLERS.register
class ObserverPosition(EstimatingPosition):
    """PD controller with a Kalman filter that estimates the acceleration disturbance from measured positions."""

    kind: Literal["disturbance_observer"]  # type: ignore[assignment]
    position_noise: Annotated[FixedPositive, PLAUSIBLE_POSITION_NOISE] = Field(
        description="standard deviation of the measured position (m)"
    )
    deviation: FixedPositives = Field(description="standard deviation of the disturbance on X, Y, Z (m/s²)")
    time_constant: FixedSpans = Field(
        description="correlation time of the disturbance on X, Y, Z (s); long for a disturbance like a random walk"
    )

    def law(self, axis: int, period: float) -> KalmanLaw:
        """Return the Kalman filter of an axis, with (N,) gains if its statistics differ between vehicles."""
        statistics = self.deviation[axis], self.time_constant[axis], self.position_noise
        if not any(np.ndim(number) for number in statistics):
            return _kalman_filter(*statistics, period)
        laws = [
            _kalman_filter(*map(float, statistics_of_axis), period) for statistics_of_axis in np.broadcast(*statistics)
        ]
        time_constant: Any = np.array([law.time_constant for law in laws])
        return KalmanLaw(time_constant, KalmanMemory(*np.transpose([law.gain for law in laws])))


@functools.lru_cache(maxsize=4096)
def _kalman_filter(deviation: float, time_constant: float, position_noise: float, period: float) -> KalmanLaw:
    return KalmanLaw.of(deviation=deviation, time_constant=time_constant, position_noise=position_noise, period=period)
