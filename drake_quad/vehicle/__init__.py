"""Aircraft: rigid body, rotors, effects on them, allocation, autopilot."""
