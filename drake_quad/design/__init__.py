"""Design of controllers: gains, LQG, maps of stable gains, sensitivities, tuning."""
