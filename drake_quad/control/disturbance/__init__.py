"""Estimators of disturbing accelerations, which are caused by wind, drag and other effects outside the model."""
