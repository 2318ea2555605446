"""Complete software projects that contain exported code: for flight controllers, microcontrollers, and other programs."""
