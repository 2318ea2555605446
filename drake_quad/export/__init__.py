"""Export of controllers as C code, and flights of the exported code."""
