"""Simulation with exported controllers: Drake systems that run the C code on the host or on an emulated board."""
