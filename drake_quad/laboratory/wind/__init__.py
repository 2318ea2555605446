"""Wind: sources, each of which is a system, and their sum.

A source samples the wind at every time step h of the vehicle and holds it over the step. From t to t + h, the wind is
that at the time t and at the position of the vehicle at t. A gust or a sine is a known function of time, so it is
sampled at the middle of the step, t + h / 2.
"""
