"""The aircraft: parameters, rigid body and rotors, allocation."""
