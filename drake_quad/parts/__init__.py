"""What a scenario's numbers make: the systems of its control and of its laboratory."""
