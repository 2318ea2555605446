"""Controllers: position and attitude control, disturbance estimators, fuzzy networks, LQG, MPC and trained policies."""
