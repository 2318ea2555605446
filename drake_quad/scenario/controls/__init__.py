"""Controls of the scenario language, which run on the ground, each kind in a module of its own."""

from drake_quad.scenario.unions import import_members

import_members(__name__, __path__)
