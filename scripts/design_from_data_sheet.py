"""Describe a drone by its data sheet, design gains for it, print their margins, and fly it."""

import math
from pathlib import Path

from drake_quad import design_cascade, load_undesigned, save_scenario, simulate, with_gains

MASS = 1.05  # kg, drone with its battery
ARM = 0.177  # m, distance of the motors from the centre; the rotors form an X
# Values of one rotor at full throttle, from the data sheet of the motor.
THRUST = 7.6  # N
POWER = 110.0  # W, mechanical
SPEED = 8600.0 * 2.0 * math.pi / 60.0  # rad/s, at 8600 rpm
PROPELLER_MASS = 0.009  # kg
PROPELLER_DIAMETER = 0.24  # m
MOTOR_MASS = 0.055  # kg, including its bell
BELL_MASS = 0.025  # kg, the rotating part of a motor
BELL_RADIUS = 0.014  # m
LENGTH, WIDTH, HEIGHT = 0.16, 0.10, 0.07  # m, box that represents the frame and the battery

rotor_mass = 4.0 * (PROPELLER_MASS + MOTOR_MASS)
box = (MASS - rotor_mass) / 12.0
nominal = {
    "mass": MASS,
    "arm_length": ARM,
    "layout": {"kind": "x"},
    "inertia": [
        0.5 * rotor_mass * ARM**2 + box * (WIDTH**2 + HEIGHT**2),
        0.5 * rotor_mass * ARM**2 + box * (LENGTH**2 + HEIGHT**2),
        rotor_mass * ARM**2 + box * (LENGTH**2 + WIDTH**2),
    ],
    "thrust_factor": THRUST / SPEED**2,
    "drag_factor": POWER / SPEED**3,
    "rotor_inertia": PROPELLER_MASS * PROPELLER_DIAMETER**2 / 12.0 + BELL_MASS * BELL_RADIUS**2,
    "min_rotor_speed": 0.1 * SPEED,
    "max_rotor_speed": SPEED,
}
laboratory = load_undesigned("laboratory:nominal", {"nominal": nominal, "vehicle.rotor_time_constant": 0.04})

design = design_cascade(laboratory)
for axis, loop in design.loops.items():
    margins = loop.margins
    print(f"{axis}: {margins.phase:.0f}°, {margins.gain:.1f} dB, {1000.0 * margins.delay:.0f} ms")

designed = with_gains(laboratory, design.gains())
flight = simulate(designed)
hover = math.sqrt(0.25 * MASS * designed.nominal.gravity / designed.nominal.thrust_factor)
print(
    f"hovers at {100.0 * hover / SPEED:.0f} % of full speed, flies with an RMSE of {100.0 * flight.metrics.rmse:.1f} cm"
)
Path("out").mkdir(exist_ok=True)
save_scenario(designed, Path("out/own_drone.yaml"))
