"""State estimation on board: an error-state Kalman filter, corrected by readings of sensors."""
