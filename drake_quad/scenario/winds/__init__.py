"""Wind sources in the scenario language, with one module for each source. The winds of all sources are added."""

from drake_quad.scenario.unions import import_members

import_members(__name__, __path__)
