"""File formats of flights for other programs."""

from drake_quad.scenario.unions import import_members

import_members(__name__, __path__)
