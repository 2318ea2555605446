"""Ready projects around exported code: for flight controllers, microcontrollers, and other programs."""
