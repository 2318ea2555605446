"""Formats of flight logs. Each format is a module of this folder that registers itself."""

from drake_quad.scenario.unions import import_members

import_members(__name__, __path__)
