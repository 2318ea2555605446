"""Limits on the size of a scenario.

Typical scenarios stay far below these limits. The limits reject broken files, and files that are not scenarios, before
they take long to parse: 30,000 keys and values take half a second.
"""

# Largest total size of a scenario's files, bytes. A path through 1,000 waypoints, as `drake-quad plan` writes it, has
# 300,000 bytes.
MAX_BYTES = 500_000
# Largest number of YAML nodes (keys and values) in a scenario's files. A path through 1,000 waypoints has 23,000, and
# the largest shipped scenario has 700.
MAX_NODES = 30_000
# Largest depth of nested mappings and lists. A valid scenario has at most ten levels.
MAX_LEVELS = 40
# Largest number of characters in a key, a number or a text.
MAX_CHARACTERS = 1_000
# Largest number of scenarios that a scenario extends, directly or indirectly.
MAX_BASES = 100
# Largest number of waypoints in a route. The planner finds the shortest times for this number within a minute.
MAX_WAYPOINTS = 1_000
# Largest number of wind sources, and of sensors. A wall of fans has about a hundred fans.
MAX_SOURCES = 100
# Largest number of obstacles in a space. It is limited because the simulation searches for the nearest obstacle at each
# tick.
MAX_OBSTACLES = 200
# Largest number of points from which a mesh or a hull in a scenario is built.
MAX_POINTS = 5_000
# Largest number of corners of a convex hull. It is limited because the compiler unrolls loops over corners.
MAX_CORNERS = 100
# Largest number of rules in a network: four inputs with four sets each. It is limited because the compiler unrolls the
# loop over rules.
MAX_RULES = 256
# Largest number of fuzzy sets for one input. For the phase in a lap of the laboratory's figure eight, this is one set
# every 36 cm.
MAX_SETS = 60

# Largest size of a policy's weights and biases, bytes. Two layers of 256 neurons in single precision have about this
# size.
MAX_NETWORK_BYTES = 300_000

# Largest number of normal variables that the distributions of a scenario share. An identification writes at most one
# for each parameter.
MAX_SHARED = 64

# Largest magnitude of a number in a scenario, in any unit. No formula overflows with such numbers.
MAX_MAGNITUDE = 1e9
# Smallest positive number that a scenario may contain, in any unit. No real vehicle has smaller values: the moment of
# inertia of an insect is 1e-9 kg m².
MIN_MAGNITUDE = 1e-12
# Shortest period, and shortest time between two waypoints, s. Cameras and autopilots are not faster than 10 kHz.
MIN_DURATION = 1e-4
# Longest flight, and latest time in a flight, s (one day).
MAX_DURATION = 86_400.0
# Largest number of ticks in a flight, counted with the shortest period. A day has 8,640,000 ticks of the default 10 ms,
# and its simulation takes a quarter of an hour.
MAX_TICKS = 10_000_000
