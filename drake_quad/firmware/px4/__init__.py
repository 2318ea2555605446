"""PX4 in lockstep, over MAVLink messages for hardware-in-the-loop simulations.

PX4 connects to the simulation over TCP. Its clock is the time in the messages HIL_SENSOR, and it answers each of them
with HIL_ACTUATOR_CONTROLS (docs.px4.io, "Simulator MAVLink API"; mavlink.io, "MAVLINK Common Message Set").
"""
