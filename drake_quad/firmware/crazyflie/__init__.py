"""The Crazyflie's firmware in the loop: its PID controller and power distribution, by the bindings `cffirmware`.

The firmware keeps its state in global variables. Each vehicle therefore has its own process, which runs `server.py`.
"""
