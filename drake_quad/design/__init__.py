"""Controller design: cascade gains, LQG, stability maps, sensitivities, and tuning."""
