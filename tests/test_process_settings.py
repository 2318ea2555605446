"""Tests that process-wide settings are changed temporarily and then restored."""

import gc
import logging
import os

import pytest

from drake_quad.process_settings import (
    on_processor,
    without_drake_remarks,
    without_error_output,
    without_garbage_collection,
)


def test_messages_of_drake_are_hidden_until_the_last_context_is_left():
    logger = logging.getLogger("drake")
    previous_level = logger.level
    logger.setLevel(logging.INFO)
    try:
        with without_drake_remarks():
            with without_drake_remarks():
                assert logger.level == logging.WARNING
            assert logger.level == logging.WARNING
        assert logger.level == logging.INFO
    finally:
        logger.setLevel(previous_level)


@pytest.mark.parametrize("enabled", [True, False])
def test_the_garbage_collector_is_paused_and_restored(enabled):
    was_enabled = gc.isenabled()
    (gc.enable if enabled else gc.disable)()
    try:
        with without_garbage_collection():
            assert not gc.isenabled()
        assert gc.isenabled() == enabled
    finally:
        (gc.enable if was_enabled else gc.disable)()


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="requires Linux")
def test_a_thread_may_run_on_all_its_processors_again_afterwards():
    allowed = os.sched_getaffinity(0)
    with on_processor(min(allowed)):
        assert os.sched_getaffinity(0) == {min(allowed)}
    assert os.sched_getaffinity(0) == allowed


def test_error_output_is_discarded_only_inside_the_context(capfd):
    os.write(2, b"before ")
    with without_error_output():
        os.write(2, b"inside ")
    os.write(2, b"after")
    assert capfd.readouterr().err == "before after"
