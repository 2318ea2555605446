"""Planning of reference trajectories: minimum-snap paths, routes, times of waypoints, and yaw."""
