"""Position controllers in the scenario language, with one module for each kind."""

from drake_quad.scenario.unions import import_members

import_members(__name__, __path__)
