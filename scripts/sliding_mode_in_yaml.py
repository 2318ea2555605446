"""Add a position controller to the scenario language: a sliding mode with a boundary layer."""

from typing import ClassVar, Literal, NamedTuple

from pydantic import Field

from drake_quad.control.position import PdGains, pd_law
from drake_quad.framework.elementary import maximum, minimum
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.framework.recipe import Recipe
from drake_quad.geometry.per_axis import PerAxis
from drake_quad.scenario.position_controllers.controller import POSITION_CONTROLLERS, PositionController
from drake_quad.scenario.quantities import Positives
from drake_quad.scenario.setting import ControlSetting
from drake_quad.signals import Acceleration, Reference, State


class SlidingParameters(NamedTuple):
    """Slope λ (1/s) of the sliding surface, gain K (m/s²), and width φ (m/s) of the boundary layer, along X, Y, Z."""

    slope: PerAxis
    gain: PerAxis
    width: PerAxis


def sliding_law(measurement: State, reference: Reference, parameters: SlidingParameters) -> Acceleration:
    """Return a_r + λ ė + K sat(s / φ) with s = ė + λ e (J.-J. Slotine and W. Li, Applied Nonlinear Control, 7.2)."""
    ones = PdGains(PerAxis(1.0, 1.0, 1.0), PerAxis(1.0, 1.0, 1.0))  # any gains, since only the errors are used
    errors = pd_law(measurement, reference, ones, "tracking_error", feeds_forward=True)
    return Acceleration._make(
        a + slope * rate + gain * maximum(minimum((rate + slope * error) / width, 1.0), -1.0)
        for a, error, rate, slope, gain, width in zip(errors.feed_forward, errors.error, errors.error_rate, *parameters)
    )


@fleet_system(float, AutoDiffXd)
class SlidingMode(FleetSystem):
    """Position controller by sliding mode with a boundary layer."""

    def declare(self, *, parameters: SlidingParameters) -> None:
        """Declare the system."""
        parameter = self.parameter("parameters", lambda parameters: parameters)
        self.output("acceleration_command", sliding_law, self.input("measurement"), self.input("reference"), parameter)


@POSITION_CONTROLLERS.register
class SlidingPosition(PositionController):
    """Sliding mode with a boundary layer, which acts like a PD with a limited response to errors."""

    kind: Literal["sliding_mode"]
    slope: Positives = Field(description="λ of the sliding surface on X, Y, Z (1/s)")
    gain: Positives = Field(description="K, largest acceleration beyond λ ė on X, Y, Z (m/s²)")
    width: Positives = Field(description="φ of the boundary layer on X, Y, Z (m/s)")
    feed_forward: ClassVar = "snap"
    takes_correction: ClassVar = False

    def recipes(self, setting: ControlSetting) -> dict[str, Recipe]:
        """Return the recipe for a `SlidingMode`."""
        parameters = [PerAxis(*each) for each in (self.slope, self.gain, self.width)]
        return {"position": Recipe(SlidingMode, {}, SlidingParameters(*parameters))}
