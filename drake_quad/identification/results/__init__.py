"""Results of an identification: estimates with their covariance, and the file of the vehicle."""
