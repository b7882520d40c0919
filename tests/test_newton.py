"""Newton's guard: stops when increments stop falling, goes on after a single bad one."""

from fmbd_fenicsx.schemes.newton import Newton


def run(sizes, **settings):
    """Feed a list of increments; returns (converged, how many were taken)."""
    feed = iter(sizes)
    newton = Newton(**settings)
    converged, history = newton.solve(lambda: next(feed))
    return converged, len(history)


def test_fast_convergence_stops_as_soon_as_the_error_left_is_below_the_tolerance():
    assert run([1e3, 1e2, 1.0, 1e-3]) == (True, 3)


def test_the_first_increment_counts_when_it_is_tiny():
    assert run([1e-4]) == (True, 1)


def test_one_bad_increment_is_forgiven():
    assert run([8e9, 1e4, 3e2, 4e2, 2e1, 1e-1, 1e-3]) == (True, 6)


def test_growth_over_two_increments_is_divergence():
    assert run([1e3, 1e2, 2e2, 4e2, 8e2]) == (False, 4)


def test_not_finite_ends_at_once_and_too_many_iterations_too():
    assert run([1e3, float("nan")]) == (False, 2)
    assert run([10.0 * 0.8**k for k in range(99)], max_iterations=5) == (False, 5)


def test_a_new_tangent_is_asked_for_when_the_rate_is_poor():
    asked = []
    run([1e6, 5e5, 1e2, 1e-3], refresh=lambda: not asked.append(1))
    assert asked == [1]
