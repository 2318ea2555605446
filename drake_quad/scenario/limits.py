"""Limits on the size of a scenario.

Nothing that a person or a script of this project writes comes near these limits. They are for what is broken, or no
scenario at all, and act before the most of it is read: ruamel.yaml takes a second for 30,000 names and values, and
another for half a megabyte of text.
"""

# Bytes of text in all files of a scenario. `drake-quad plan` writes a path through 1,000 waypoints with 300,000.
MOST_BYTES = 500_000
# Names and values in all YAML of a scenario. That path has 23,000, and the largest shipped scenario has 700.
MOST_NODES = 30_000
# Levels of nested mappings and lists. The language has ten.
MOST_LEVELS = 40
# Characters of a name, a number or a text.
MOST_CHARACTERS = 1_000
# Scenarios that a scenario extends, directly or through others.
MOST_BASES = 100
# Waypoints of a route. The shortest times through this many waypoints are found within a minute.
MOST_WAYPOINTS = 1_000
# Sources of wind, and sensors. Walls of fans have about as many.
MOST_SOURCES = 100
# Obstacles of a space. The nearest one is searched at every tick.
MOST_OBSTACLES = 200
# Points of a mesh, and corners of its convex hull, which are unrolled in machine code.
MOST_POINTS, MOST_CORNERS = 5_000, 100
# Rules of a network with four inputs of four sets. Every rule is unrolled in machine code, on every axis.
MOST_RULES = 256
# Sets of an input: one every 36 cm in a lap of the laboratory's figure eight.
MOST_SETS = 60

# Bytes of the numbers of a policy: two layers of 256 neurons in single precision.
MOST_NETWORK_BYTES = 300_000

# Normal variables that distributions share. An identification has at most one for each of its numbers.
MOST_SHARED = 64

# Bounds of numbers in any unit. No product of such numbers overflows in a formula, and smaller numbers do not affect
# a vehicle: the inertia of a winged insect is 1e-9 kg m².
LARGEST, SMALLEST = 1e9, 1e-12
# Shortest period, or time between two waypoints, s. No camera and no autopilot is faster than 10 kHz.
SHORTEST = 1e-4
# Longest flight, and latest time in it, s: a day.
LONGEST = 86_400.0
# Shortest periods in a flight. A day has as many with the default of 10 ms, and takes a quarter of an hour to simulate.
MOST_TICKS = 10_000_000
