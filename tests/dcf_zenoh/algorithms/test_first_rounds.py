"""The first rounds are those of the papers, written again with matrices: limits alone would not reveal a wrong sign."""

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
from scipy.optimize import nnls

from dcf_zenoh.algorithms.admm_mpc import admm_mpc
from dcf_zenoh.algorithms.admm_tracking_gradient import admm_tracking_gradient
from dcf_zenoh.algorithms.algorithm import Algorithm
from dcf_zenoh.algorithms.consensus_admm import consensus_admm
from dcf_zenoh.algorithms.dual_decomposition import dual_decomposition
from dcf_zenoh.algorithms.dual_subgradient import dual_subgradient
from dcf_zenoh.algorithms.edge_admm import edge_admm
from dcf_zenoh.algorithms.exact_diffusion import exact_diffusion
from dcf_zenoh.algorithms.extra import extra
from dcf_zenoh.algorithms.gradient_tracking import gradient_tracking
from dcf_zenoh.algorithms.pseudo_gradient_partial import pseudo_gradient_partial
from dcf_zenoh.algorithms.push_pull import push_pull
from dcf_zenoh.algorithms.push_sum import push_sum
from dcf_zenoh.algorithms.subgradient import subgradient
from dcf_zenoh.algorithms.tracking_admm import tracking_admm
from dcf_zenoh.graph import metropolis
from dcf_zenoh.plant import Array
from dcf_zenoh.problems.average import Average
from dcf_zenoh.testing import fleet_of, in_time, lockstep
from tests.support.answers import AGENTS, Problems, allocation, cournot, graph, quadratic

PATH = graph("path")
W, ONE = metropolis(PATH), np.eye(4)
A, C = np.diag([1.0, 2.0, 3.0, 4.0]), np.array([4.0, -1.0, 2.0, 0.5])  # of P1: grad f = A (x - C)
JOINED = np.array([[float((i, j) in PATH.links) for j in AGENTS] for i in AGENTS])
DEGREES = np.diag(JOINED.sum(axis=1))
EDGES = [(i, j) for i in range(4) for j in range(4) if JOINED[i, j]]
LOST = {(1, 2, 0), (3, 2, 1), (2, 1, 1), (4, 3, 2)}  # sender, receiver, round


def grad(x: Array) -> Array:
    slope: Array = A @ (x - C)
    return slope


def values() -> Problems:
    return {i: Average(value=float(C[i - 1])) for i in AGENTS}


def lossy(sender: int, receiver: int, round: int) -> int | None:
    return None if (sender, receiver, round) in LOST else 0


def by_push_sum(rounds: int) -> Array:
    P = (ONE + JOINED) / (1 + np.diag(DEGREES))  # column j: agent j divides evenly
    power = np.linalg.matrix_power(P, rounds)
    means: Array = (power @ C) / (power @ np.ones(4))
    return means


def by_subgradient(rounds: int) -> Array:
    x = np.zeros(4)
    for k in range(rounds):
        x = W @ x - 0.5 / (k + 1) * grad(W @ x)
    return x


def by_gradient_tracking(rounds: int, mixed: Array = W, pushed: Array = W) -> Array:
    x = np.zeros(4)
    y = grad(x)
    for _ in range(rounds):
        new = mixed @ (x - 0.1 * y)
        y = pushed @ y + grad(new) - grad(x)
        x = new
    return x


def by_push_pull(rounds: int) -> Array:
    return by_gradient_tracking(rounds, W, (ONE + JOINED) / (1 + np.diag(DEGREES)))


def by_extra(rounds: int) -> Array:
    """Shi et al. 2015, eqs. (2.13) and (2.14)."""
    xs = [np.zeros(4)]
    xs.append(W @ xs[0] - 0.2 * grad(xs[0]))
    while len(xs) <= rounds:
        xs.append((ONE + W) @ xs[-1] - (ONE + W) / 2 @ xs[-2] - 0.2 * (grad(xs[-1]) - grad(xs[-2])))
    return xs[rounds]


def by_exact_diffusion(rounds: int) -> Array:
    """Without psi and phi: x++ = W' (2 x+ - x - a (grad f(x+) - grad f(x))) with W' = (I + W) / 2."""
    half = (ONE + W) / 2
    xs = [np.zeros(4)]
    xs.append(half @ (xs[0] - 0.2 * grad(xs[0])))
    while len(xs) <= rounds:
        xs.append(half @ (2 * xs[-1] - xs[-2] - 0.2 * (grad(xs[-1]) - grad(xs[-2]))))
    return xs[rounds]


def by_consensus_admm(rounds: int) -> Array:
    c, x, p = 1.5, np.zeros(4), np.zeros(4)
    for _ in range(rounds):
        p = p + c * (DEGREES - JOINED) @ x
        x = np.linalg.solve(A + 2 * c * DEGREES, A @ C - p + c * (DEGREES + JOINED) @ x)
    return x


def by_edge_admm(rounds: int) -> Array:
    rho, alpha, z = 1.5, 0.8, np.zeros((4, 4))
    for number in range(rounds + 1):
        x = np.linalg.solve(A + rho * DEGREES, A @ C + z.sum(axis=1))
        said = {(i, j): 2 * rho * x[i] - z[i, j] for i, j in EDGES}
        for i, j in EDGES:
            if lossy(j + 1, i + 1, number) is not None:
                z[i, j] = (1 - alpha) * z[i, j] + alpha * said[j, i]
    return x


def by_dual_decomposition(rounds: int) -> Array:
    B = np.array([[1.0, 0, 0], [-1, 1, 0], [0, -1, 1], [0, 0, -1]])  # one price for each edge
    lam = np.zeros(3)
    for _ in range(rounds):
        lam = lam + 0.1 * B.T @ np.linalg.solve(A, A @ C - B @ lam)
    return np.linalg.solve(A, A @ C - B @ lam)


def by_admm_tracking_gradient(rounds: int) -> Array:
    """As in the file, with an edge that takes part once a message was received over it."""
    x, rho, alpha = np.zeros(4), 0.5, 0.9
    theta = np.stack((x, grad(x)))
    mean, q = theta.copy(), dict[tuple[int, int], Array]()
    for number in range(rounds):
        said = {(i, j): 2 * rho * mean[:, i] - q.get((i, j), rho * mean[:, i]) for i, j in EDGES}
        for i, j in EDGES:
            if lossy(j + 1, i + 1, number) is not None:
                q[i, j] = (1 - alpha) * q.get((i, j), rho * mean[:, i]) + alpha * said[j, i]
        for old in (False, True):
            if old:
                x = x + 0.5 * (mean[0] - x - 0.2 * mean[1])
                theta = np.stack((x, grad(x)))
            for i in range(4):
                heard = [value for (to, _), value in q.items() if to == i]
                mean[:, i] = (theta[:, i] + np.sum([np.zeros(2), *heard], axis=0)) / (1 + rho * len(heard))
    return x


WEIGHTS, MOST = np.array([1.0, 2.0, 4.0, 4.0]), np.array([4.0, 100.0, 100.0, 100.0])  # of P3, of which each has 10 / 4


def by_dual_subgradient(rounds: int) -> Array:
    lam = x = np.zeros(4)
    for k in range(rounds):
        x = np.clip(-(W @ lam) / WEIGHTS, 0, MOST)
        lam = W @ lam + (k + 1) ** -0.7 * (x - 2.5)
    return x


def by_tracking_admm(rounds: int) -> Array:
    c, lam = 1.5, np.zeros(4)
    x = np.clip(c * 2.5 / (WEIGHTS + c), 0, MOST)  # least x² weight / 2 + c / 2 (x - b)²
    d = x - 2.5
    for _ in range(rounds):
        D, L = W @ d, W @ lam
        new = np.clip((c * (x - D) - L) / (WEIGHTS + c), 0, MOST)
        d = D + new - x
        lam, x = L + c * d, new
    return x


def by_estimates(rounds: int) -> Array:
    X = np.zeros((4, 4))  # row i: agent i's estimates of all actions
    for _ in range(rounds):
        X = W @ X
        F = np.arange(1.0, 5.0) - 10 + X.sum(axis=1) + np.diag(X)
        X = X + np.diag(np.maximum(np.diag(X) - 0.1 * F, 0.0) - np.diag(X))
    return np.diag(X)


def by_admm_mpc(rounds: int) -> Array:
    """After four rounds in which the shares are flooded: J = sum_i f_i, and each pays a quarter of the coupling."""
    rho, alpha, z, x = 3.0, 0.9, {edge: np.zeros(4) for edge in EDGES}, np.zeros((4, 4))
    if rounds <= 4:
        return np.zeros(4)
    for number in range(rounds - 3):
        for i in range(4):
            P = ONE[i][:, None] * ONE[i] + np.ones((4, 4)) / 4 + rho * DEGREES[i, i] * ONE
            q = (i + 1.0 - 10) * ONE[i] - np.sum([z[edge] for edge in EDGES if edge[0] == i], axis=0)
            L = np.linalg.cholesky(P)
            x[i] = nnls(L.T, -np.linalg.solve(L, q))[0]
        if number < rounds - 4:
            said = {(i, j): 2 * rho * x[i] - z[i, j] for i, j in EDGES}
            z = {(i, j): (1 - alpha) * z[i, j] + alpha * said[j, i] for i, j in EDGES}
    return np.diag(x)


CASES: dict[str, tuple[Algorithm, Callable[[], Problems], Callable[[int], Array]]] = {
    "push_sum": (push_sum, values, by_push_sum),
    "subgradient": (subgradient, quadratic, by_subgradient),
    "gradient_tracking": (gradient_tracking, quadratic, by_gradient_tracking),
    "push_pull": (push_pull, quadratic, by_push_pull),
    "extra": (extra, quadratic, by_extra),
    "exact_diffusion": (exact_diffusion, quadratic, by_exact_diffusion),
    "consensus_admm": (partial(consensus_admm, penalty=1.5), quadratic, by_consensus_admm),
    "edge_admm": (partial(edge_admm, penalty=1.5, relax=0.8), quadratic, by_edge_admm),
    "dual_decomposition": (dual_decomposition, quadratic, by_dual_decomposition),
    "admm_tracking_gradient": (admm_tracking_gradient, quadratic, by_admm_tracking_gradient),
    "dual_subgradient": (dual_subgradient, allocation, by_dual_subgradient),
    "tracking_admm": (partial(tracking_admm, penalty=1.5), allocation, by_tracking_admm),
    "pseudo_gradient_partial": (pseudo_gradient_partial, cournot, by_estimates),
    "admm_mpc": (admm_mpc, cournot, by_admm_mpc),
}


@pytest.mark.parametrize("rounds", [1, 2, 3, 7])
@pytest.mark.parametrize("name", CASES)
def test_the_first_rounds_are_those_of_the_paper(name: str, rounds: int) -> None:
    algorithm, problems, expected = CASES[name]
    links = lossy if name in ("edge_admm", "admm_tracking_gradient") else in_time
    results = lockstep(algorithm, problems(), fleet_of(PATH), rounds, links=links)
    decided = np.array([results[i].decision[0] for i in AGENTS])
    np.testing.assert_allclose(decided, expected(rounds), atol=1e-12)
