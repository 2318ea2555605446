"""The scenario language: a closed loop in YAML."""
