"""Fixtures of the tests of studies."""

import pytest

from drake_quad import user_code


@pytest.fixture(scope="module")
def package_functions(request):
    """Let `user_code` treat the functions of a test file as package functions, since they replace such functions."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(user_code, "_LIBRARIES", (*user_code._LIBRARIES, str(request.path)))
        yield
