"""From the route of a scenario to a plan that its vehicle can fly."""
