"""The aircraft: parameters, rigid body and rotors, the effects on them, allocation, autopilot."""
