"""Linear models of the closed loop in hover, and their modes, margins and step responses."""
