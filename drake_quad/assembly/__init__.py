"""Assembly of the Drake diagram that simulates a scenario."""
