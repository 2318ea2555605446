"""Diagrams compiled to machine code."""

from drake_quad.compilation.compile_diagram import compile_diagram, compiled_part, or_stand_in
from drake_quad.compilation.compiled_system import CompiledSystem

__all__ = ["CompiledSystem", "compile_diagram", "compiled_part", "or_stand_in"]
