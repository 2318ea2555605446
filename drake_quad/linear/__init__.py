"""Linear models of a loop in hover, with their modes, margins and responses."""
