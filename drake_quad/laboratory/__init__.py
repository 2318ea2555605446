"""What surrounds the vehicle: motion capture, command link, monitor, recorder."""
