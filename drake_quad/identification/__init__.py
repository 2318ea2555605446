"""From flight logs to a vehicle with its uncertainty, and back: the same flight flown and predicted."""
