"""State estimation on board: an error-state Kalman filter and a complementary filter, corrected by readings of sensors."""
