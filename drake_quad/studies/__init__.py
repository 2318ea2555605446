"""Monte Carlo studies, on one machine or many, and their statistics."""
