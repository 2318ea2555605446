"""A battery that is drawn empty, and whose voltage sags under the current.

    V_0 = V_full + (V_empty - V_full) Q / C                   at rest: linear in the charge drawn, Q
    V = V_0 - R I,    η V I = P = Σ d |ωᵢ|³                   under the current of the rotors
    V = (V_0 + √(V_0² - 4 R P / η)) / 2

A motor's speed at full throttle is proportional to its voltage: the rotors reach V / V_full of the speed that they are
told, which is (V / V_full)² of the thrust. Where the battery cannot give the power, V is V_0 / 2, at which it gives
most.
"""

from typing import Annotated, NamedTuple

from drake_quad.framework.elementary import maximum, sqrt
from drake_quad.geometry.axes import TINY
from drake_quad.signals import Charge, Number, Quantity, RotorSpeed, Row
from drake_quad.vehicle.parameters import QuadrotorParameters

_SECONDS_PER_HOUR = 3600.0
_Voltage = Annotated[Row, Quantity("V")]


class Battery(NamedTuple):
    """A battery.

    Attributes:
        voltage: V_full, full and without current.
        empty_voltage: V_empty, empty and without current.
        capacity: C.
        resistance: R, inside.
        efficiency: η, mechanical power of the rotors over electrical power.
    """

    voltage: _Voltage
    empty_voltage: _Voltage
    capacity: Annotated[Row, Quantity("A h")]
    resistance: Annotated[Row, Quantity("Ω")]
    efficiency: Number


FULL = Charge(0.0)


class Terminals(NamedTuple):
    """Voltage (V) and current (A) of a battery that is under load."""

    voltage: Row
    current: Row


def terminals(charge: Charge, power: Row, battery: Battery) -> Terminals:
    """Voltage and current under a mechanical power of the rotors (W)."""
    drawn = charge.drawn / battery.capacity
    at_rest = maximum(battery.voltage + (battery.empty_voltage - battery.voltage) * drawn, 0.0)
    electrical = power / battery.efficiency
    root = sqrt(maximum(at_rest * at_rest - 4.0 * battery.resistance * electrical, TINY))
    voltage = 0.5 * (at_rest + root)
    return Terminals(voltage, electrical / voltage)


def rotor_power(speed: RotorSpeed, parameters: QuadrotorParameters) -> Row:
    """P, the mechanical power of the rotors of a vehicle, W."""
    p_1, p_2, p_3, p_4 = (
        rotor.drag_factor * (abs(w) * w * w) for rotor, w in zip(parameters.rotors, speed, strict=True)
    )
    return p_1 + p_2 + p_3 + p_4


def drawn_per_second(current: Row) -> Charge:
    """The rate of the charge drawn at a current (A)."""
    return Charge(current / _SECONDS_PER_HOUR)
