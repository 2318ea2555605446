"""Controllers of flight-controller firmware, from the parameters of a vehicle."""
