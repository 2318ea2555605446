"""Scenario layer with the controller of a flight-controller firmware."""

from typing import Any

from drake_quad.design.firmware.crazyflie import crazyflie_layer
from drake_quad.design.firmware.parameters import Firmware, FirmwareParameters
from drake_quad.design.firmware.px4 import px4_layer
from drake_quad.planning.nominal import nominal_parameters
from drake_quad.scenario.models import Scenario

FIRMWARE: dict[Firmware, str] = {
    "crazyflie": "the PID controller of the Crazyflie's firmware, 2025.12",
    "px4": "the multicopter controllers of PX4, 1.15",
}
"""Description of the controller of each firmware."""

_NUM_DIGITS = 8  # number of significant digits to which numbers in the layer are rounded


def firmware_layer(parameters: FirmwareParameters, scenario: Scenario) -> dict[str, Any]:
    """Return a layer with the firmware's controller, converted for the nominal vehicle of a scenario."""
    nominal = nominal_parameters(scenario)
    make = px4_layer if parameters.firmware == "px4" else crazyflie_layer
    return _rounded(make(parameters.values, nominal))


def _rounded(value: Any) -> Any:
    """Round all numbers in a value to eight digits, which is more than the single precision of a firmware."""
    if isinstance(value, dict):
        return {name: _rounded(each) for name, each in value.items()}
    if isinstance(value, list):
        return [_rounded(each) for each in value]
    return float(f"{value:.{_NUM_DIGITS}g}") if isinstance(value, float) else value
