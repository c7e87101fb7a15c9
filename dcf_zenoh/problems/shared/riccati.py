"""The discrete algebraic Riccati equation."""

import numpy as np

from dcf_zenoh.plant import Array, read_only

DOUBLINGS_MAX = 60
TOLERANCE = 1e-15  # relative


def solve_riccati(A: Array, B: Array, Q: Array, R: Array) -> Array:
    """Return the stabilising solution P of P = A'PA - A'PB (R + B'PB)^-1 B'PA + Q, by structure-preserving doubling.

    After k steps H is the cost of 2^k stages, so a few steps reach machine precision. The solver of scipy is not used,
    because importing it takes a third of a second at the start of every daemon.

    Args:
        A: Shape (n, n).
        B: Shape (n, m); (A, B) can be stabilised.
        Q: Positive semidefinite, shape (n, n); (A, Q) is detectable.
        R: Positive definite, shape (m, m).

    Raises:
        ValueError: The iteration does not converge: there is no stabilising solution.

    Source: Chu, Fan, Lin, Wang, "Structure-preserving algorithms for periodic discrete-time algebraic Riccati
    equations", International Journal of Control, 2004, the case of period 1.
    """
    G, H, size = B @ np.linalg.solve(R, B.T), Q, len(A)
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(DOUBLINGS_MAX):
            W, Z = np.hsplit(np.linalg.solve(np.eye(size) + G @ H, np.hstack((A, G))), 2)
            before, after = H, H + A.T @ H @ W
            H = read_only((after + after.T) / 2)
            if abs(H - before).max() <= TOLERANCE * abs(H).max():
                return H
            if not np.isfinite(H).all():
                break
            G, A = G + A @ Z @ A.T, A @ W
    raise ValueError("the Riccati equation has no stabilising solution for these weights and this motion")
