"""Controllers: position, estimators, fuzzy networks, attitude, LQG, MPC, trained policies."""
