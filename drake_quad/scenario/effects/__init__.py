"""Effects on the vehicle in addition to the paper's equations, each in a module of its own."""

from drake_quad.scenario.unions import import_members

import_members(__name__, __path__)
