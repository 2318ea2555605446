"""Estimators of the acceleration that a disturbance causes: of wind, drag, and whatever the model does not know."""
