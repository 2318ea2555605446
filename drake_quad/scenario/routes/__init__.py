"""Routes of the scenario language, each in a module of its own, with the planning of its path."""

from drake_quad.scenario.unions import import_members

import_members(__name__, __path__)
