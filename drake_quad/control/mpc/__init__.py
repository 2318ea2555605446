"""Model predictive control: the linear-quadratic-Gaussian controller with limits that it sees coming."""
