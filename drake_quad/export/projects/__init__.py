"""Complete software projects with exported code: for flight controllers, microcontrollers, and other programs."""
