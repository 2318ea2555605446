"""Assembly of the diagram of a scenario."""
