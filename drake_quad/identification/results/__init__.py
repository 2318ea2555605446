"""What was identified: estimates with their covariance, and the vehicle that they make."""
