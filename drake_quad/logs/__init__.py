"""Reading of flight logs: formats, mappings to signals, and checks for faults."""
