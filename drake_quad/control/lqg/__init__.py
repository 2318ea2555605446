"""Linear-quadratic-Gaussian control: a model of the way from command to position, a Kalman filter, a regulator."""
