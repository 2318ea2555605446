"""Battery whose voltage decreases with the discharged charge and with the load.

    V_0 = V_full + (V_empty - V_full) Q / C                   without current: linear in the discharged charge Q
    V = V_0 - R I,    η V I = P = Σ d |ωᵢ|³                   with the current I of the rotors
    V = (V_0 + √(V_0² - 4 R P / η)) / 2

The speed of a motor at full throttle is proportional to its voltage. The rotors therefore reach only V / V_full times
the commanded speed, and (V / V_full)² times the commanded thrust. If the battery cannot deliver the power, V is
V_0 / 2, the voltage of maximum power.
"""

from typing import Annotated, NamedTuple

from drake_quad.framework.elementary import maximum, sqrt
from drake_quad.geometry.axes import TINY
from drake_quad.signals import BatteryLoad, Charge, Number, Quantity, RotorSpeed, Row
from drake_quad.vehicle.parameters import QuadrotorParameters

_SECONDS_PER_HOUR = 3600.0
_Voltage = Annotated[Row, Quantity("V")]


class Battery(NamedTuple):
    """Parameters of a battery.

    Attributes:
        voltage: voltage V_full of the full battery without current.
        empty_voltage: voltage V_empty of the empty battery without current.
        capacity: capacity C.
        resistance: internal resistance R.
        efficiency: ratio η of the mechanical power of the rotors to the electrical power.
    """

    voltage: _Voltage
    empty_voltage: _Voltage
    capacity: Annotated[Row, Quantity("A h")]
    resistance: Annotated[Row, Quantity("Ω")]
    efficiency: Number


FULL_BATTERY_CHARGE = Charge(0.0)
"""Charge that has been drawn from a full battery: none."""


def battery_load(charge: Charge, power: Row, battery: Battery) -> BatteryLoad:
    """Return the voltage and the current of a battery that supplies the mechanical power (W) of the rotors."""
    drawn = charge.drawn / battery.capacity
    at_rest = maximum(battery.voltage + (battery.empty_voltage - battery.voltage) * drawn, 0.0)
    electrical = power / battery.efficiency
    root = sqrt(maximum(at_rest * at_rest - 4.0 * battery.resistance * electrical, TINY))
    voltage = 0.5 * (at_rest + root)
    return BatteryLoad(voltage, electrical / voltage)


def rotor_power(speed: RotorSpeed, parameters: QuadrotorParameters) -> Row:
    """Return the mechanical power P of all rotors, W."""
    p_1, p_2, p_3, p_4 = (
        rotor.drag_factor * (abs(w) * w * w) for rotor, w in zip(parameters.rotors, speed, strict=True)
    )
    return p_1 + p_2 + p_3 + p_4


def rotor_battery_load(
    charge: Charge, speed: RotorSpeed, parameters: QuadrotorParameters, battery: Battery
) -> BatteryLoad:
    """Return the voltage and the current of a battery that supplies rotors at given speeds."""
    return battery_load(charge, rotor_power(speed, parameters), battery)


def charge_rate(current: Row) -> Charge:
    """Return the rate at which a current (A) discharges the battery, in A h per second."""
    return Charge(current / _SECONDS_PER_HOUR)
