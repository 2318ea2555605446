import numpy as np
import pytest
import scipy

from drake_quad.linear.structured_singular_value import Block, _basis, mu_bound, peak_mu_bound


def random_matrix(seed, n):
    generator = np.random.default_rng(seed)
    return generator.standard_normal((n, n)) + 1j * generator.standard_normal((n, n))


def scalars(kinds):
    return [Block(1, is_real=kind == "r") for kind in kinds]


# SLICOT's AB13MD (slycot 0.7.1) computed these bounds. It computes the same bound as `mu_bound`, but supports only real
# blocks of size 1.
@pytest.mark.parametrize(
    ("seed", "kinds", "value"),
    [
        (1, "rrrrrr", 3.6705551),
        (1, "cccccc", 4.0241889),
        (1, "rrrccc", 3.8596008),
        (2, "rrrrrr", 4.9212765),
        (2, "cccccc", 5.0275894),
        (2, "rrrccc", 5.0074112),
    ],
)
def test_bounds_are_those_of_slicot(seed, kinds, value):
    assert mu_bound(random_matrix(seed, 6), scalars(kinds), tolerance=1e-5).value == pytest.approx(value, rel=2e-5)


def test_the_derivatives_of_log_det_are_traces_of_products_with_the_elements_of_a_basis():
    basis, M = _basis((Block(2, is_real=True), Block(2, is_real=False), Block(1, is_real=True))), random_matrix(1, 10)
    Y = M @ M.conj().T
    left = np.concatenate([-basis.D, 0.0 * basis.G])
    right = np.concatenate([0.0 * basis.D, 1j * basis.G])
    products = Y @ np.block([[left, right], [-right, -left]])
    first, second = basis.form_terms.derivatives(Y)
    assert first == pytest.approx(np.trace(products, axis1=1, axis2=2).real)
    np.testing.assert_allclose(second, np.einsum("pij,qji->pq", products, products).real, rtol=1e-9, atol=1e-9)


def test_the_bound_of_one_complex_block_is_the_largest_singular_value():
    M = random_matrix(3, 4)
    assert mu_bound(M, [Block(4, is_real=False)]).value == pytest.approx(np.linalg.norm(M, 2), rel=1e-9)


def test_the_bound_of_one_repeated_real_number_is_the_largest_real_eigenvalue():
    M = np.random.default_rng(4).standard_normal((5, 5))
    eigenvalues = np.linalg.eigvals(M)
    largest = np.abs(eigenvalues[np.abs(eigenvalues.imag) < 1e-9].real).max()
    assert np.abs(eigenvalues).max() > 1.2 * largest
    assert mu_bound(M, [Block(5, is_real=True)], tolerance=1e-5).value == pytest.approx(largest, rel=1e-3)


def test_the_bound_of_a_matrix_of_rank_one_is_that_of_a_linear_program():
    # det(I - u vᴴ Δ) = 0 is equivalent to Σ δᵢ aᵢ = 1 with aᵢ = v̄ᵢ uᵢ. The bound is exact (P. Young, 1994).
    generator = np.random.default_rng(5)
    u, v = generator.standard_normal((2, 4)) + 1j * generator.standard_normal((2, 4))
    a = v.conj() * u
    # Minimise t with -t ≤ δᵢ ≤ t.
    sides = np.vstack([np.hstack([sign * np.eye(4), -np.ones((4, 1))]) for sign in (1.0, -1.0)])
    equal = np.array([[*a.real, 0.0], [*a.imag, 0.0]])
    solved = scipy.optimize.linprog([0, 0, 0, 0, 1], sides, np.zeros(8), equal, [1.0, 0.0], [(None, None)] * 5)
    assert mu_bound(np.outer(u, v.conj()), scalars("rrrr"), tolerance=1e-5).value == pytest.approx(
        1.0 / solved.fun, rel=1e-3
    )
    assert mu_bound(np.outer(u, v.conj()), scalars("cccc"), tolerance=1e-5).value == pytest.approx(
        np.abs(a).sum(), rel=1e-3
    )


def test_a_repeated_real_block_applies_to_the_first_rows_of_the_matrix():
    M = np.diag([1.0, -2.0, 0.5])
    M[0, 1] = 3.0
    assert mu_bound(M, [Block(2, is_real=True), Block(1, is_real=False)], tolerance=1e-4).value == pytest.approx(
        2.0, rel=5e-3
    )


def test_no_uncertainty_smaller_than_the_bound_makes_the_matrix_singular():
    generator, M = np.random.default_rng(6), random_matrix(6, 4)
    blocks = [Block(2, is_real=True), Block(1, is_real=True), Block(1, is_real=False)]
    bound = mu_bound(M, blocks).value
    smallest = np.inf
    for a, b, angle in zip(
        *generator.uniform(-1.0, 1.0, (2, 5000)), generator.uniform(-np.pi, np.pi, 5000), strict=True
    ):
        sizes = np.linalg.eigvals(M @ np.diag([a, a, b, np.exp(1j * np.pi * angle)]))
        smallest = min(smallest, 1.0 / np.abs(sizes[np.abs(sizes.imag) < 0.02 * np.abs(sizes)]).max(initial=1e-9))
    assert 1.0 / bound <= smallest * 1.001
    assert smallest < 1.3 / bound


def test_a_poor_first_guess_gives_the_same_bound():
    M = random_matrix(7, 5)
    other_matrix_bound = mu_bound(random_matrix(8, 5), scalars("rrrcc"))
    values = [mu_bound(M, scalars("rrrcc"), tolerance=1e-5, starts=each).value for each in ([], [other_matrix_bound])]
    assert values[0] == pytest.approx(values[1], rel=1e-4)


def test_a_bound_that_is_good_enough_ends_the_search():
    M = random_matrix(9, 4)
    assert mu_bound(M, scalars("rrrr"), stop=100.0).value == pytest.approx(np.linalg.norm(M, 2))


def test_blocks_that_do_not_match_are_refused():
    with pytest.raises(ValueError, match="blocks of 3 rows do not match"):
        mu_bound(np.eye(2), [Block(3, is_real=True)])


@pytest.fixture(scope="module")
def system():
    generator = np.random.default_rng(10)
    A = generator.standard_normal((6, 6))
    A *= 0.97 / np.abs(np.linalg.eigvals(A)).max()
    return A, generator.standard_normal((6, 3)), generator.standard_normal((3, 6)), generator.standard_normal((3, 3))


@pytest.mark.long
def test_the_bound_on_the_unit_circle_holds_between_the_points_of_any_grid(system):
    A, B, C, D = system
    blocks = scalars("rrc")
    peak = peak_mu_bound(A, B, C, D, blocks, tolerance=0.01)
    grid = np.linspace(0.0, np.pi, 25)
    bounds = [
        mu_bound(C @ np.linalg.solve(np.exp(1j * w) * np.eye(6) - A, B) + D, blocks).value
        for w in [*grid, peak.frequency]
    ]
    assert max(bounds) <= peak.value <= 1.02 * max(bounds)


def test_peak_mu_bound_is_infinite_if_the_bound_exceeds_the_argument_limit(system):
    A, B, C, D = system
    value = peak_mu_bound(A, B, C, D, scalars("rrc")).value
    assert peak_mu_bound(A, B, C, D, scalars("rrc"), limit=0.9 * value).value == np.inf
    assert peak_mu_bound(A, B, C, D, scalars("rrc"), limit=1.05 * value).value == pytest.approx(value)


def test_a_narrow_resonance_is_not_missed():
    radius, angle = 0.9999, 1.2345
    A = radius * np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    peak = peak_mu_bound(A, np.eye(2), np.eye(2), np.zeros((2, 2)), [Block(2, is_real=False)])
    assert peak.value == pytest.approx(1.0 / (1.0 - radius), rel=0.01)
    assert peak.frequency == pytest.approx(angle, abs=1e-4)


def test_a_system_without_uncertainty_has_a_negligible_bound():
    assert peak_mu_bound(np.eye(1) * 0.5, np.zeros((1, 0)), np.zeros((0, 1)), np.zeros((0, 0)), []).value < 1e-5
