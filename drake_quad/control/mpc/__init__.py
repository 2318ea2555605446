"""Model predictive control: a linear-quadratic-Gaussian controller that satisfies limits over a horizon."""
