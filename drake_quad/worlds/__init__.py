"""Several vehicles in one world, which influence each other."""
