"""What one learns from a diagram: operating points, linear models, margins, gains, sensitivities."""
