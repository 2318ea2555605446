"""Age of camera frames, and delay from a command to the measurement of its effect."""

from drake_quad.scenario.models import Scenario


def frame_age(scenario: Scenario) -> float:
    """Return the age of a camera frame when the controller receives it, s."""
    cameras = scenario.laboratory.motion_capture
    return float((1 + cameras.latency_frames) * cameras.period)


def total_delay(scenario: Scenario) -> float:
    """Return the delay from a command to the measurement of its effect, s."""
    link = scenario.laboratory.command_link
    return float(link.delay_ticks * link.period) + frame_age(scenario)
