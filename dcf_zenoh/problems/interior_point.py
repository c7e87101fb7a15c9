"""Interior-point solver for affine variational inequalities, convex quadratic programs among them, on dense data.

The units of costs, decisions and constraints do not matter: data are equilibrated first. Of a problem without a
solution it finds out which of two reasons there is.

Source: Andersen and Ye, "On a homogeneous algorithm for the monotone complementarity problem", Mathematical
Programming, 1999, for the embedding; Goulart and Chen, "Clarabel: an interior-point solver for conic programs with
quadratic objectives", 2024, for its linear algebra; Ruiz, "A scaling algorithm to equilibrate both rows and columns
norms in matrices", 2001, for the scaling.
"""

from typing import Literal, NamedTuple

import numpy as np
from scipy.linalg import lu_factor, lu_solve

from dcf_zenoh.plant import Array

Status = Literal["solved", "inaccurate", "infeasible", "unbounded", "out of iterations"]
ACCURATE = 1e-9  # largest relative residual of a solution
TOLERABLE = 1e-8  # largest relative residual of a solution that is called inaccurate
CERTAIN = 1e-9  # largest relative residual of a proof that there is no solution
ITERATIONS = 150
SWEPT = 1e-12  # relative to the largest; what is left of a sum that should be zero
SWEEPS = 40  # of the equilibration
REGULAR = 1e-13  # added to the diagonal of the equilibrated linear systems; refinement takes its effect away


class Optimum(NamedTuple):
    """Result of the solver.

    Attributes:
        status: What was found; "infeasible" and "unbounded" are proved by a certificate.
        x: Solution, shape (n,).
        y: Multipliers of the rows of A, shape (rows,).
        residual: Largest residual of the optimality conditions of `x` and `y`, relative to the equilibrated data.
    """

    status: Status
    x: Array
    y: Array
    residual: float


class OptimalityConditions(NamedTuple):
    """Find x, y with M x + q + A'y = 0, A x <= b (the first `equations` rows: =), y >= 0 and y'(b - A x) = 0.

    Attributes:
        M: Shape (n, n); M + M' is positive semidefinite.
        q: Shape (n,).
        A: Shape (rows, n).
        b: Shape (rows,).
        equations: Number of rows that are equations.
    """

    M: Array
    q: Array
    A: Array
    b: Array
    equations: int

    def residual(self, x: Array, y: Array) -> float:
        """Return the largest residual of the conditions, each relative to the largest of its terms.

        Where q or b is zero, all terms may vanish; then 1 is the scale of equilibrated data.
        """
        free = np.arange(len(self.b)) < self.equations
        cost, force, value = self.M @ x, self.A.T @ y, self.A @ x
        over = value - self.b
        primal = float(np.where(free, abs(over), np.maximum(over, 0.0)).max(initial=0.0))
        dual = max(_most(cost + self.q + force), float(np.maximum(-y[~free], 0.0).max(initial=0.0)))
        terms = float(x @ cost), float(self.q @ x), float(self.b @ y)
        large, steep = max(_most(x), _most(self.b) or 1.0), max(_most(cost), _most(force), _most(self.q) or 1.0)
        return max(
            primal / max(_most(value), _most(self.b) or 1.0),
            dual / steep,
            abs(sum(terms)) / max(*map(abs, terms), 1e-3 * large * steep),
        )


def solve(conditions: OptimalityConditions) -> Optimum:
    """Return the solution of `conditions`, or the reason why there is none."""
    empty = np.logical_not(conditions.A.any(axis=1))
    if empty.any():
        return _without(conditions, empty)
    scaled, columns, rows = _equilibrated(conditions)
    status, x, y = _homogeneous(scaled)
    if status in ("infeasible", "unbounded"):
        return Optimum(status, x * columns, y * rows, np.inf)
    residual = scaled.residual(x, y)
    refined = _refined(scaled, x, y)
    if refined is not None and (better := scaled.residual(*refined)) <= residual:
        (x, y), residual = refined, better
    if residual > TOLERABLE:
        return _half(conditions) or Optimum("out of iterations", x * columns, y * rows, residual)
    return Optimum("solved" if residual <= ACCURATE else "inaccurate", x * columns, y * rows, residual)


def _half(given: OptimalityConditions) -> Optimum | None:
    """Return the proof that the constraints or the costs alone exclude a solution, each in units of its own.

    None if there is no such proof.
    """
    n, m = len(given.q), len(given.b)
    nearest = given._replace(M=np.eye(n), q=np.zeros(n))
    falling = given._replace(b=np.zeros(m))
    for part in (nearest, falling) if given.b.any() and given.q.any() else ():
        scaled, columns, rows = _equilibrated(part)
        status, x, y = _homogeneous(scaled)
        if status:
            return Optimum(status, x * columns, y * rows, np.inf)
    return None


def _without(given: OptimalityConditions, empty: Array) -> Optimum:
    """Return the answer to conditions some of whose rows have no variables."""
    free = np.arange(len(given.b)) < given.equations
    kept, allowed = np.logical_not(empty), SWEPT * _most(given.b)
    none = np.logical_not(kept)
    wrong = none & ((given.b < -allowed) | (free & (given.b > allowed)))
    y = np.zeros(len(given.b))
    if wrong.any():
        y[wrong] = -np.sign(given.b[wrong])
        return Optimum("infeasible", np.zeros(len(given.q)), y, np.inf)
    found = solve(OptimalityConditions(given.M, given.q, given.A[kept], given.b[kept], int((kept & free).sum())))
    y[kept] = found.y
    return found._replace(y=y)


def _equilibrated(given: OptimalityConditions) -> tuple[OptimalityConditions, Array, Array]:
    """Return the conditions in units of their own, and the units of x and of y."""
    M, q, A, b, free = given
    columns, rows, cost = np.ones(len(q)), np.ones(len(b)), 1.0
    for _ in range(SWEEPS):
        if A.size:
            norms = np.maximum(abs(M).max(axis=0, initial=0.0), abs(A).max(axis=0, initial=0.0))
        else:
            norms = abs(M).max(axis=0, initial=0.0)
        d, e = _root(norms), _root(abs(A).max(axis=1, initial=0.0))
        M, q, A, b = d[:, None] * M * d, d * q, e[:, None] * A * d, e * b
        columns, rows = columns * d, rows * e
        high = abs(M).max(axis=0, initial=0.0)
        c = 1.0 / (float(high[high > 0].mean()) if high.any() else max(_most(q), 1e-300))
        M, q, cost = c * M, c * q, c * cost
    length, price = _most(b) or 1.0, _most(q) or 1.0
    if M.any():  # one unit for both, or M would change
        length = price = max(_most(b), _most(q)) or 1.0
    return OptimalityConditions(M, q / price, A, b / length, free), columns * length, rows * price / cost


def _homogeneous(at: OptimalityConditions) -> tuple[Literal["", "infeasible", "unbounded"], Array, Array]:
    """Return the solution of equilibrated conditions, or the proof that there is none."""
    M, q, A, b, free = at
    n, m = len(q), len(b)
    sym, bounded = (M + M.T) / 2, np.arange(m) >= free
    count = m - free + 1
    x, y, s, tau, kappa = np.zeros(n), np.where(bounded, 1.0, 0.0), np.where(bounded, 1.0, 0.0), 1.0, 1.0
    best, idle = (np.inf, x, y), 0
    for _ in range(ITERATIONS):
        xi = x / tau
        if (found := at.residual(xi, y / tau)) < best[0] * 0.9:
            best, idle = (found, xi, y / tau), 0
        else:
            idle += 1
        if best[0] < 1e-14 or (idle > 12 and best[0] < ACCURATE) or idle > 40:
            break
        if best[0] > ACCURATE and (proof := _proof(at, x, y, s)):
            return proof, x, y
        weight = np.where(bounded, s / np.where(bounded, y, 1.0), 0.0)
        linear = _Linear(M, A, weight)
        slope = q + 2.0 * (sym @ xi)
        by_tau = linear.solve(-q, b)
        under = -kappa / tau + slope @ by_tau[:n] + b @ by_tau[n:] - xi @ sym @ xi
        gaps = -(M @ x + A.T @ y + q * tau), -(A @ x + s - b * tau), -(q @ x + b @ y + xi @ (sym @ x) + kappa)
        if not np.isfinite(by_tau).all() or not under:
            break
        mu = (s[bounded] @ y[bounded] + tau * kappa) / count
        step = aim = dtau = dkappa = 0.0
        ds, dy = np.zeros(m), np.zeros(m)
        for corrector in (False, True):
            keep = 1.0 - aim
            product = np.where(bounded, -s * y + aim * mu - (ds * dy if corrector else 0.0), 0.0)
            last = -tau * kappa + aim * mu - (dtau * dkappa if corrector else 0.0)
            shift = product / np.where(bounded, y, 1.0)
            first = linear.solve(keep * gaps[0], keep * gaps[1] - shift)
            dtau = float((keep * gaps[2] - last / tau - slope @ first[:n] - b @ first[n:]) / under)
            move = first + dtau * by_tau
            dx, dy = move[:n], move[n:]
            ds = np.where(bounded, shift - weight * dy, 0.0)
            dkappa = float(last - kappa * dtau) / tau
            step = _longest((s[bounded], ds[bounded]), (y[bounded], dy[bounded]),
                            (np.array([tau]), np.array([dtau])), (np.array([kappa]), np.array([dkappa])))  # fmt: skip
            aim = (1.0 - step) ** 3
        step *= 0.99
        if not np.isfinite(dx).all() or not np.isfinite(dtau):
            break
        x, y, s = x + step * dx, y + step * dy, s + step * ds
        tau, kappa = tau + step * dtau, kappa + step * dkappa
        norm = max(_most(x), _most(y), tau, kappa)
        if norm < 1e-6 or norm > 1e6:  # homogeneous: the length means nothing
            x, y, s, tau, kappa = x / norm, y / norm, s / norm, tau / norm, kappa / norm
    return "", best[1], best[2]


def _proof(at: OptimalityConditions, x: Array, y: Array, s: Array) -> Literal["", "infeasible", "unbounded"]:
    """Return what x or y prove: A'y = 0 and b'y < 0, or M x = 0, A x <= 0 and q'x < 0, both nearly."""
    falls, drops = -float(at.b @ y), -float(at.q @ x)
    if falls > 0 and _most(at.A.T @ y) <= CERTAIN * falls and falls > CERTAIN * _most(y):
        return "infeasible"
    if drops > 0 and max(_most(at.M @ x), _most(at.A @ x + s)) <= CERTAIN * drops and drops > CERTAIN * _most(x):
        return "unbounded"
    return ""


class _Linear:
    """Factors of [[M, A'], [A, -W]].

    Args:
        M: Shape (n, n).
        A: Shape (rows, n).
        weight: Diagonal of W, shape (rows,).
    """

    def __init__(self, M: Array, A: Array, weight: Array) -> None:
        n, m = len(M), len(A)
        self._whole = np.zeros((n + m, n + m))
        self._whole[:n, :n], self._whole[:n, n:], self._whole[n:, :n] = M, A.T, A
        self._whole[range(n, n + m), range(n, n + m)] = -weight
        regular = self._whole.copy()
        regular[range(n + m), range(n + m)] += np.where(np.arange(n + m) < n, REGULAR, -REGULAR)
        self._factors = lu_factor(regular, check_finite=False)

    def solve(self, top: Array, low: Array) -> Array:
        """Return the solution, shape (n + rows,), refined until it stops getting better."""
        right = np.concatenate((top, low))
        found = lu_solve(self._factors, right, check_finite=False)
        error = right - self._whole @ found
        for _ in range(5):
            better = found + lu_solve(self._factors, error, check_finite=False)
            left = right - self._whole @ better
            if not _most(left) < 0.5 * _most(error):
                break
            found, error = better, left
        return np.asarray(found)


def _refined(at: OptimalityConditions, x: Array, y: Array) -> tuple[Array, Array] | None:
    """Return the solution of the equations that hold at x and y: the constraints in force, and the gradient.

    None if there are too many to be independent.
    """
    over = at.b - at.A @ x
    active = (np.arange(len(at.b)) < at.equations) | (y > over)
    n, A = len(x), at.A[active]
    whole = np.block([[at.M, A.T], [A, np.zeros((len(A), len(A)))]])
    start = np.concatenate((x, y[active]))
    try:
        change, *_ = np.linalg.lstsq(whole, np.concatenate((-at.q, at.b[active])) - whole @ start, rcond=1e-12)
    except np.linalg.LinAlgError:
        return None
    prices = np.zeros(len(y))
    prices[active] = (start + change)[n:]
    return (start + change)[:n], prices


def _longest(*pairs: tuple[Array, Array]) -> float:
    """Return the longest step, up to 1, that keeps all values positive."""
    return min(1.0, *(float((-v[d < 0] / d[d < 0]).min(initial=np.inf)) for v, d in pairs))


def _root(norms: Array) -> Array:
    result: Array = 1.0 / np.sqrt(np.where(norms > 0, norms, 1.0))
    return result


def _most(values: Array) -> float:
    return float(abs(values).max(initial=0.0))
