"""Reference trajectories: minimum snap, routes, times of waypoints, yaw."""
