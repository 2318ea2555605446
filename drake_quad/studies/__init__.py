"""Monte Carlo studies: thousands of samples of a scenario, on one machine or many, and their statistics."""
