"""Controllers: position, thrust vectoring, attitude, and the cascade of the three."""
