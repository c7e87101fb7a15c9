"""Contract check for problems, structure by structure, at random points."""

from collections.abc import Callable

import numpy as np

from dcf_zenoh.plant import Array, read_only
from dcf_zenoh.problems.problem import (
    AggregativeGame,
    ConsensusProblem,
    CoupledGame,
    CoupledProblem,
    Game,
    MeanProblem,
    NonlinearGame,
)
from dcf_zenoh.problems.share import Share, Shareable

TOLERANCE = 1e-7  # relative to the compared values


def check_problem(make: Callable[[], object], *, points: int = 20, spread: float = 3.0) -> None:
    """Check the contract of a problem that derives from structures of `dcf_zenoh.problems.problem`.

    Equal arguments give equal results and are not modified. Costs are convex, gradients are their gradients or
    subgradients, and `argmin` and `respond` return minimisers. Projections are projections on convex sets, shared
    constraints are linear, and `share` describes the same problem. The structures decide which of this applies.

    Args:
        make: Makes the problem, the same each time; for a problem that is posed in every step, the result of its `at`.
        points: Number of random points to try.
        spread: Standard deviation of the points.

    Raises:
        AssertionError: The problem breaks the contract; the message states how.
    """
    problem, again = make(), make()
    rng = np.random.default_rng(0)

    def drawn(*shape: int) -> Array:
        return read_only(rng.normal(scale=spread, size=shape))

    structures = {
        MeanProblem: _check_mean,
        ConsensusProblem: _check_consensus,
        CoupledProblem: _check_coupled,
        Game: _check_game,
        AggregativeGame: _check_aggregative,
    }
    checks = [check for structure, check in structures.items() if isinstance(problem, structure)]
    assert checks, f"{type(problem).__name__} derives from none of {', '.join(each.__name__ for each in structures)}"
    for check in checks:
        for _ in range(points):
            check(problem, again, drawn)  # type: ignore[operator]


Draw = Callable[..., Array]


def _same(one: Array, other: Array, what: str) -> None:
    """Check that two arrays are equal within `TOLERANCE`."""
    assert np.shape(one) == np.shape(other), f"{what}: shape {np.shape(one)}, expected {np.shape(other)}"
    scale = 1 + float(abs(np.asarray(other)).max(initial=0.0))
    gap = float(abs(np.asarray(one) - other).max(initial=0.0))
    assert gap <= TOLERANCE * scale, f"{what}: {one}, expected {other}"


def _at_most(one: float, other: float, what: str) -> None:
    assert one <= other + TOLERANCE * (1 + abs(one) + abs(other)), f"{what}: {one} is more than {other}"


def _repeated(one: Array, other: Array, shape: tuple[int, ...], what: str) -> Array:
    """Check that a result is finite, of this shape and repeatable, and return it."""
    assert np.shape(one) == shape, f"{what} has shape {np.shape(one)}, expected {shape}"
    assert np.isfinite(one).all(), f"{what} is not finite: {one}"
    assert np.array_equal(one, other), f"{what} is not repeatable: {one}, then {other}"
    return one


def _check_projection(project: Callable[[Array], Array], x: Array, y: Array) -> None:
    """Check that projected points stay, and that projecting moves no two points apart."""
    near, other = project(x), project(y)
    _same(project(read_only(near)), near, "project(project(x))")
    _at_most(float(np.linalg.norm(near - other)), float(np.linalg.norm(x - y)), "distance of two projections")
    _at_most(float(np.linalg.norm(near - x)), float(np.linalg.norm(other - x)), "distance of x to its projection")


OPTIONAL = ("cost", "gradient", "argmin")  # methods that a consensus problem may leave out


def _check_mean(problem: MeanProblem, again: MeanProblem, _drawn: Draw) -> None:
    _repeated(problem.value, again.value, (problem.value.size,), "value")


def _check_consensus(problem: ConsensusProblem, again: ConsensusProblem, drawn: Draw) -> None:
    n = problem.size
    x, y, slope = drawn(n), drawn(n), drawn(n)
    _repeated(problem.start(None), again.start(None), (n,), "start(None)")
    _same(problem.start(x), x, "start(last)")
    has = {name: getattr(type(problem), name) is not getattr(ConsensusProblem, name) for name in OPTIONAL}
    _check_projection(problem.project, x, y)
    if problem.unconstrained:
        _same(problem.project(x), x, "project(x), unconstrained")
    if has["cost"] and has["gradient"]:
        _check_gradient(problem, again, x, y)
    if has["cost"] and has["argmin"]:
        _check_argmin(problem, again, x, y, slope)
    if isinstance(problem, Shareable):
        share = problem.share()
        assert bool(share.common), "share().common is false, although all agents decide the same"
        if problem.smooth and has["gradient"]:
            _same(share.H @ x + share.g, problem.gradient(x), "share(): H x + g")


def _check_gradient(problem: ConsensusProblem, again: ConsensusProblem, x: Array, y: Array) -> None:
    n = problem.size
    g = _repeated(problem.gradient(x), again.gradient(x), (n,), "gradient(x)")
    _at_most(problem.cost(x) + float(g @ (y - x)), problem.cost(y), "cost(x) + gradient(x)'(y - x), beside cost(y)")
    if problem.smooth:
        step = 1e-5
        ends = [(problem.cost(x + step * e), problem.cost(x - step * e)) for e in np.eye(n)]
        steepness = np.array([(ahead - behind) / (2 * step) for ahead, behind in ends])
        gap = float(abs(steepness - g).max())
        assert gap < 1e-4 * (1 + float(abs(g).max())), f"gradient(x): {g}, but cost rises by {steepness}"


def _check_argmin(problem: ConsensusProblem, again: ConsensusProblem, x: Array, y: Array, slope: Array) -> None:
    n = problem.size
    for weight in (0.0, 0.5, 3.0):
        if weight or problem.strongly_convex:
            z = _repeated(problem.argmin(slope, weight), again.argmin(slope, weight), (n,), "argmin(slope, weight)")
            _same(problem.project(z), z, "project(argmin(slope, weight))")

            def total(x: Array, weight: float = weight) -> float:
                return problem.cost(x) + float(slope @ x) + weight / 2 * float(x @ x)

            for other in (problem.project(x), problem.project(y), problem.project(z + (y - x) / 100)):
                _at_most(total(z), total(other), f"least cost with weight {weight:g}, beside another point's")


def _check_coupled(problem: CoupledProblem, again: CoupledProblem, drawn: Draw) -> None:
    rows = problem.rows
    n = problem.A.shape[1]
    assert problem.A.shape == (rows, n), f"A has shape {problem.A.shape}, expected ({rows}, n)"
    x = drawn(n)
    _same(
        _repeated(problem.coupling(x), again.coupling(x), (rows,), "coupling(x)"),
        problem.A @ x - problem.b,
        "coupling(x)",
    )
    price, target = drawn(rows), drawn(rows)
    others = [problem.respond(drawn(rows), 1.0, drawn(rows)) for _ in range(3)]  # points of the set
    for weight in (0.0, 0.5, 3.0):
        if weight or problem.strongly_convex:
            z = problem.respond(price, weight, target)
            _repeated(z, again.respond(price, weight, target), (n,), "respond(price, weight, target)")

            def total(x: Array, weight: float = weight) -> float:
                used = problem.A @ x
                return problem.cost(x) + float(price @ used) + weight / 2 * float((used - target) @ (used - target))

            for other in others if type(problem).cost is not CoupledProblem.cost else ():
                _at_most(total(z), total(other), f"least cost with weight {weight:g}, beside another point's")
                _at_most(total(z), total(z + (other - z) / 100), f"least cost with weight {weight:g}, beside one near")
    if isinstance(problem, Shareable):
        share = problem.share()
        _same(share.A, problem.A, "share().A")
        _same(share.b, problem.b, "share().b")
        assert bool(share.equality) == problem.equality, "share().equality is not that of the problem"


def _check_game(problem: Game, again: Game, drawn: Draw) -> None:
    count, n = len(problem.players), problem.size
    profile, x, y = drawn(count, n), drawn(n), drawn(n)
    _repeated(problem.pseudo_gradient(profile), again.pseudo_gradient(profile), (n,), "pseudo_gradient(profile)")
    _check_projection(problem.project, x, y)


def _check_aggregative(problem: AggregativeGame, again: AggregativeGame, drawn: Draw) -> None:
    start = problem.start(None)
    n = start.size
    u, v = drawn(n), drawn(n)
    _repeated(start, again.start(None), (n,), "start(None)")
    phi = problem.contribution(u)
    size = phi.size
    _repeated(phi, again.contribution(u), (size,), "contribution(u)")
    sigma = drawn(size)
    slope = _repeated(problem.gradient(u, sigma), again.gradient(u, sigma), (n,), "gradient(u, sigma)")
    _at_most(0.0, float((slope - problem.gradient(v, sigma)) @ (u - v)), "0, beside how the gradient rises along u - v")
    _check_projection(problem.project, u, v)
    if isinstance(problem, CoupledGame):
        assert problem.A.shape == (problem.rows, n), f"A has shape {problem.A.shape}, expected ({problem.rows}, {n})"
        _same(problem.coupling(u) - problem.coupling(v), problem.A @ (u - v), "coupling(u) - coupling(v)")
    if isinstance(problem, NonlinearGame) and isinstance(again, NonlinearGame):
        _check_nonlinear(problem, again, u, drawn)
    if isinstance(problem, Shareable):
        share: Share = problem.share()
        if isinstance(problem, NonlinearGame):
            _same(share.T @ u + share.t, problem.T @ u + problem.t, "share(): T u + t")
        _same(share.H @ u + share.g + share.K @ sigma, slope, "share(): H u + g + K sigma")
        _same(share.Phi @ u + share.phi, phi, "share(): Phi u + phi")
        if isinstance(problem, CoupledGame):
            _same(share.A @ u - share.b, problem.coupling(u), "share(): A u - b")


def _check_nonlinear(problem: NonlinearGame, again: NonlinearGame, u: Array, drawn: Draw) -> None:
    size, count = problem.t.size, len(problem.agents)
    assert problem.T.shape == (size, u.size), f"T has shape {problem.T.shape}, expected ({size}, {u.size})"
    outputs = drawn(count, size)
    c, derivative = problem.constraints(outputs)
    _repeated(c, again.constraints(outputs)[0], (c.size,), "constraints(outputs)")
    _repeated(derivative, again.constraints(outputs)[1], (c.size, count, size), "constraints(outputs)")
    step, direction = 1e-6, drawn(count, size)
    ends = [problem.constraints(read_only(outputs + sign * step * direction))[0] for sign in (1, -1)]
    steepness, slope = (ends[0] - ends[1]) / (2 * step), (derivative * direction).sum(axis=(1, 2))
    gap = float(abs(steepness - slope).max(initial=0.0))
    assert gap < 1e-4 * (1 + float(abs(slope).max(initial=0.0))), f"constraints: {slope}, but they rise by {steepness}"
    prices = abs(drawn(c.size))
    curvature = problem.curvature(outputs, prices)
    _repeated(curvature, again.curvature(outputs, prices), (outputs.size, outputs.size), "curvature(outputs, prices)")
    _same(curvature, curvature.T, "curvature(outputs, prices)")
    _at_most(0.0, float(np.linalg.eigvalsh(curvature).min()), "0, beside the least curvature")
