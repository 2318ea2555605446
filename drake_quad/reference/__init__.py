"""Planning of reference trajectories: routes, minimum-snap paths, waypoint times, and yaw."""
