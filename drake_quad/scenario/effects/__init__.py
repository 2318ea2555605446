"""Physical effects on the vehicle that the paper's equations do not contain, with one module for each effect."""

from drake_quad.scenario.unions import import_members

import_members(__name__, __path__)
