"""Templates of projects around exported code."""
