"""Models of the aircraft: rigid body, rotors, additional effects, control allocation and autopilot."""
