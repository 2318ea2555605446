"""From a scenario to a named diagram."""
