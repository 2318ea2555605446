"""Limits on the size of a scenario.

Nothing that a person or a script of this project writes comes near these limits. They are for what is broken, or no
scenario at all, and act before the most of it is read: ruamel.yaml takes a second for 30,000 names and values, and
another for half a megabyte of text.
"""

# Of text in all files of a scenario: `plan.py` writes a path through 1,000 waypoints with 300,000.
MOST_BYTES = 500_000
# In all YAML of a scenario; that path has 23,000, and the largest of the shipped scenarios 700.
MOST_NODES = 30_000
# Of mappings and lists inside each other; the language has ten.
MOST_LEVELS = 40
# Of a name, a number or a text.
MOST_CHARACTERS = 1_000
# That a scenario is laid over, counted with what these are laid over.
MOST_BASES = 100
# The shortest times through so many are found within a minute; what has more is a trajectory already.
MOST_WAYPOINTS = 1_000
# Sources of wind; walls of fans have about as many.
MOST_SOURCES = 100
# Solids of a space: the nearest is looked for at every tick.
MOST_OBSTACLES = 200
# Of a mesh, and of its convex hull; the latter are written out in machine code.
MOST_POINTS, MOST_CORNERS = 5_000, 100
# Of a network, four inputs of four sets: every rule is written out in machine code, on every axis.
MOST_RULES = 256
# Of an input: of a lap of the laboratory's figure eight one every 36 cm.
MOST_SETS = 60

# Of the numbers of a policy: two layers of 256 neurons in single precision; they are written in base 64.
MOST_NETWORK_BYTES = 300_000

# Normal variables that distributions share: an identification has one for each of its numbers, at most.
MOST_SHARED = 64

# For numbers of any unit: so many powers of ten are left to a float beyond their products that no formula overflows,
# and less than the smallest is nothing to a vehicle. The inertia of an insect with wings is 1e-9 kg m².
LARGEST, SMALLEST = 1e9, 1e-12
# A period or the time between two waypoints, s: no camera and no autopilot is faster than 10 kHz.
SHORTEST = 1e-4
# A flight, and any time in it, s: a day.
LONGEST = 86_400.0
# Of all periods in a flight: as many as a day has at the default 10 ms, which take a quarter of an hour to fly.
MOST_TICKS = 10_000_000
