"""A flight from its equations alone: what the library computes, written a second time in plain NumPy.

Nothing here is imported from `drake_quad`. The equations are those of the paper, numbered as there, and of the pages
and docstrings that say what was added to it. One vehicle flies, one number at a time, in the order in which things
happen; where there is a choice of method it is another one than the library's: matrices where that has products
written out, levers where that has eq (5), a search where that has a closed form, integrals where that has gamma
functions.

    randomness   the random numbers of a sample
    vehicle      rigid body, rotors, allocation
    wind         gusts, turbulence, fans
    laboratory   cameras and link
    control      position, network, thrust vectoring, attitude
    flight       all of them, tick by tick, and the metrics

A scenario gives its numbers, and the trajectory of the reference is given; no formula is.
"""
