"""The command `drake-quad`: the only place that prints."""
