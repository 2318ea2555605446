"""Flights of real vehicles: setpoints to PX4 or ArduPilot over MAVLink, with limits on the motion."""
