"""Controllers judged by one protocol: tuned with one budget under one limit, and flown on the same samples."""

from drake_quad.evaluation.tuning import Budget, Knob, LoopLimit, Tuned, tune

__all__ = ["Budget", "Knob", "LoopLimit", "Tuned", "tune"]
