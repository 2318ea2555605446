import logging

from drake_quad.process_settings import without_drake_remarks


def test_drake_s_remarks_are_hidden_until_the_last_user_has_left():
    logger = logging.getLogger("drake")
    before = logger.level
    logger.setLevel(logging.INFO)
    try:
        with without_drake_remarks():
            with without_drake_remarks():
                assert logger.level == logging.WARNING
            assert logger.level == logging.WARNING
        assert logger.level == logging.INFO
    finally:
        logger.setLevel(before)
