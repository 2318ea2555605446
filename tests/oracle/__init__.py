"""Independent implementation of a flight in plain NumPy, with which the flights of the library are compared.

It imports nothing from `drake_quad`. Its equations, and their numbers, are from the paper and from the documentation.
It simulates a single vehicle, and processes all events in order of time. Its methods differ from the library's where
possible: matrices instead of written-out products, lever arms instead of eq (5), a search instead of a closed form, and
integrals instead of gamma functions.

    randomness   random numbers of a sample
    vehicle      rigid body, rotors, allocation
    effects      additional forces, and bodies that consist of several parts
    autopilot    controllers on board
    wind         gusts, turbulence, fans
    laboratory   cameras and radio link
    obstacles    collisions
    control      position, network, thrust vectoring, attitude
    flight       simulation of all parts, and the metrics

Only the parameters of a scenario and the trajectory of the reference come from the library.
"""
