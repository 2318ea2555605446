"""Exported controllers in the loop: compilation of their C code, emulated boards, and a Drake system."""
