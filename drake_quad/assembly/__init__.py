"""From a scenario to a diagram."""
