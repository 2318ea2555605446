"""ArduPilot in lockstep, over its JSON interface for external simulators.

The interface is defined in libraries/SITL/examples/JSON/readme.md of ArduPilot. ArduPilot sends the outputs of its
servos in a datagram, and waits for a datagram with the motion of the vehicle and the positions of the sticks. Its clock
is the time in these datagrams.
"""
