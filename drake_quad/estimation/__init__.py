"""State estimation on board: a Kalman filter and a complementary filter, corrected by readings of sensors."""
