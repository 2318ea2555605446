"""Controllers judged by one protocol: tuned with one budget under one limit, and flown on the same samples."""

from drake_quad.evaluation.tuning import Budget, Knob, LoopLimit, Tuned, tune, with_numbers

__all__ = ["Budget", "Knob", "LoopLimit", "Tuned", "tune", "with_numbers"]
