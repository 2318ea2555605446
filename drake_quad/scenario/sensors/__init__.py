"""Sensors on board of the scenario language, each in a module of its own."""

from drake_quad.scenario.unions import import_members

import_members(__name__, __path__)
