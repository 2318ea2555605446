"""Wind sources, each of which is a system, and their sum.

A source samples the wind once per time step h of the vehicle and holds the sample over the step. From t to t + h, the
vehicle is exposed to the wind at time t, at its position at time t. A gust or a sine is a known function of time and
is sampled at the middle of the step, t + h / 2.
"""
