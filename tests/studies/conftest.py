"""Fixtures of the tests of studies."""

import pytest

from drake_quad import user_code


@pytest.fixture(scope="module")
def package_functions(request):
    """Let the functions in the file of a test count as functions of the package, which they replace."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(user_code, "_LIBRARIES", (*user_code._LIBRARIES, str(request.path)))
        yield
