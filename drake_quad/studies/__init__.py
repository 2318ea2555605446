"""Monte Carlo studies: samples of a scenario flown by the thousand, on one machine or many, and what they say."""

from drake_quad.studies.monte_carlo import StudyInterrupted, run_monte_carlo
from drake_quad.studies.study import Study, read_studies, read_study

__all__ = ["Study", "StudyInterrupted", "read_studies", "read_study", "run_monte_carlo"]
