"""Tests of the digest that identifies a listing and is the key of its cached machine code."""

import subprocess
import sys

import numpy as np
import pytest

from drake_quad.errors import InputError
from drake_quad.framework import elementary
from drake_quad.framework.symbols import Listing, Matrix, SymbolKind

LAYER_MATRIX = Matrix(np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([0.5, -0.5]))  # weights and biases


def branched(*, factor=2.0, mask=1.0, argument=0):
    def traced(listing):
        rows = listing.row(0, 0), listing.row(0, 1)
        elementary.lazy_where(rows[0] > mask, lambda x: (factor * x, x + 1.0), (rows[argument],), (0.0, 0.0))

    return traced


def layered(*, matrix=LAYER_MATRIX, activation=elementary.tanh):
    def traced(listing):
        elementary.dense(matrix, [listing.row(0, 0), listing.row(0, 1)], activation)

    return traced


# Functions that record operations in a listing; all these listings differ.
LISTINGS = {
    "a sum": lambda listing: listing.row(0, 0) + listing.row(0, 1),
    "a sum in another order": lambda listing: listing.row(0, 1) + listing.row(0, 0),
    "a difference": lambda listing: listing.row(0, 0) - listing.row(0, 1),
    "a sum of another group": lambda listing: listing.row(1, 0) + listing.row(1, 1),
    "a sum with itself": lambda listing: listing.row(0, 0) + listing.row(0, 0),
    "rows": lambda listing: [listing.row(0, 0), listing.row(0, 1)],
    "a shared value": lambda listing: listing.shared(0),
    "zero": lambda listing: listing.constant(0.0),
    "minus zero": lambda listing: listing.constant(-0.0),
    "a 64-bit word": lambda listing: listing.constant(np.uint64(0)),
    "a boolean": lambda listing: listing.constant(False),
    "a row of words": lambda listing: listing.row(0, 0, SymbolKind.WORD),
    "a branch": branched(),
    "a branch with another formula": branched(factor=3.0),
    "a branch for other vehicles": branched(mask=2.0),
    "a branch with another argument": branched(argument=1),
    "a layer": layered(),
    "a layer with another weight": layered(matrix=Matrix(np.array([[1.0, 2.0], [3.0, 5.0]]), np.array([0.5, -0.5]))),
    "a layer with another bias": layered(matrix=Matrix(np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([0.5, 0.5]))),
    "a layer with another activation": layered(activation=abs),
    "nothing": lambda listing: None,
}


def digest(name):
    listing = Listing()
    LISTINGS[name](listing)
    return listing.digest()


def test_different_listings_have_different_digests():
    digests = {name: digest(name) for name in LISTINGS}
    assert len(set(digests.values())) == len(LISTINGS), digests


@pytest.mark.slow
def test_the_digest_of_a_listing_is_the_same_in_every_process():
    program = (
        "import sys; sys.path.insert(0, 'tests/framework'); import test_symbols as t; print(*map(t.digest, t.LISTINGS))"
    )
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert result.stdout.split() == [digest(name) for name in LISTINGS]
    assert [digest(name) for name in LISTINGS] == [digest(name) for name in LISTINGS]


@pytest.mark.parametrize("digits", [400, 5000])
def test_an_integer_that_is_no_floating_point_number_is_refused(digits):
    listing = Listing()
    with pytest.raises(InputError, match="an integer that is too large for a floating-point number"):
        listing.row(0, 0) + 10**digits
