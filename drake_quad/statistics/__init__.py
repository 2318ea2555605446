"""Confidence intervals of means, ratios, quantiles and probabilities."""
