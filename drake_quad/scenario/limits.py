"""Limits on the size of a scenario.

Typical scenarios stay far below these limits. The limits reject broken files, and files that are not scenarios, before
they take long to parse: ruamel.yaml takes one second for 30,000 keys and values, and another second for half a megabyte
of text.
"""

# Largest number of bytes of text in all files of a scenario. A path through 1,000 waypoints, as `drake-quad plan`
# writes it, has 300,000 bytes.
MAX_BYTES = 500_000
# Largest number of names and values in all YAML of a scenario. A path through 1,000 waypoints has 23,000, and the
# largest shipped scenario has 700.
MAX_NODES = 30_000
# Largest number of levels of nested mappings and lists. A valid scenario has at most ten.
MAX_LEVELS = 40
# Largest number of characters of a name, a number or a text.
MAX_CHARACTERS = 1_000
# Largest number of scenarios that a scenario extends, directly or through others.
MAX_BASES = 100
# Largest number of waypoints of a route. The planner finds the shortest times through this many waypoints within a
# minute.
MAX_WAYPOINTS = 1_000
# Largest number of sources of wind, and of sensors. A wall of fans has about this many fans.
MAX_SOURCES = 100
# Largest number of obstacles of a space. The simulation searches for the nearest obstacle at every tick.
MAX_OBSTACLES = 200
# Largest number of points of a mesh, and of a hull in a scenario.
MAX_POINTS = 5_000
# Largest number of corners of a convex hull. Loops over corners are unrolled in machine code.
MAX_CORNERS = 100
# Largest number of rules of a network: four inputs with four sets each. The loop over rules is unrolled in machine
# code.
MAX_RULES = 256
# Largest number of fuzzy sets of an input: one set every 36 cm in a lap of the laboratory's figure eight.
MAX_SETS = 60

# Largest number of bytes of the weights and biases of a policy. Two layers of 256 neurons in single precision need
# about this many.
MAX_NETWORK_BYTES = 300_000

# Largest number of normal variables that distributions share. An identification writes at most one for each parameter.
MAX_SHARED = 64

# Largest magnitude of a number in any unit. No product of such numbers overflows in a formula.
MAX_MAGNITUDE = 1e9
# Smallest positive number in any unit. A smaller number does not affect a vehicle: the moment of inertia of a winged
# insect is 1e-9 kg m².
MIN_MAGNITUDE = 1e-12
# Shortest period, and shortest time between two waypoints, s. Cameras and autopilots are not faster than 10 kHz.
MIN_DURATION = 1e-4
# Longest flight, and latest time in a flight, s: one day.
MAX_DURATION = 86_400.0
# Largest number of ticks of the shortest period in a flight. A day has 8,640,000 ticks of the default 10 ms, and its
# simulation takes a quarter of an hour.
MAX_TICKS = 10_000_000
