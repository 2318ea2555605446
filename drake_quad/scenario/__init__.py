"""The scenario language, which describes a closed loop in YAML."""
