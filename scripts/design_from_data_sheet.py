"""Describe a drone by its data sheet, design gains for it, print their margins, and fly it."""

import math
from pathlib import Path

from drake_quad import design_cascade, load_undesigned, save_scenario, simulate, with_gains

# Mass of the drone with its battery (kg), and distance of its motors from the centre (m). The rotors form an X.
MASS, ARM = 1.05, 0.177
# Thrust (N), mechanical power (W) and speed (rad/s) of a rotor at full throttle, from the data sheet of the motor.
THRUST, POWER, SPEED = 7.6, 110.0, 8600.0 * 2.0 * math.pi / 60.0
# Mass (kg) and diameter (m) of a propeller; mass of a motor and of its rotating bell (kg), and radius of the bell (m).
PROPELLER, DIAMETER, MOTOR, BELL, RADIUS = 0.009, 0.24, 0.055, 0.025, 0.014
# Size of a box that represents the frame and the battery (m).
LENGTH, WIDTH, HEIGHT = 0.16, 0.10, 0.07

rotor_mass = 4.0 * (PROPELLER + MOTOR)
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
    "rotor_inertia": PROPELLER * DIAMETER**2 / 12.0 + BELL * RADIUS**2,
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
