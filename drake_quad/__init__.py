"""A Drake laboratory for quadrotor tracking control."""
