"""Linear-quadratic-Gaussian control: a model from the command to the position, a Kalman filter, and a regulator."""
