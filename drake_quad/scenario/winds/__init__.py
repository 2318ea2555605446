"""Sources of wind of the scenario language, with one module each. Their winds add up."""

from drake_quad.scenario.unions import import_members

import_members(__name__, __path__)
