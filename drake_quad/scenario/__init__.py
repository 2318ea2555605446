"""The scenario language: a closed loop described in YAML."""
