"""Planning of the route of a scenario, with checks that its vehicle can fly the plan."""
