"""PID loops with integrals, filters and limits."""
