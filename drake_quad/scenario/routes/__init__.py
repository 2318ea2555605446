"""Routes of the scenario language with their planning, each kind in a module of its own."""

from drake_quad.scenario.unions import import_members

import_members(__name__, __path__)
