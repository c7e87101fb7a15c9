"""Prediction of an agent's own motion in the plane, and its cost."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dcf_zenoh.plant import Array, Setpoint, State
from dcf_zenoh.problems.shared.riccati import solve_riccati
from dcf_zenoh.problems.shared.swap_options import CostOptions, PredictionOptions


class Prediction(NamedTuple):
    """Linear prediction of z = [px, py, vx, vy] over a horizon H, and a quadratic cost, as functions of the input u.

    u holds planar accelerations in order of time, shape (2 H,), and z[l] = A^l z[0] + G_l u. The cost of motion and
    effort is f(u) = u' M u + 2 g' u with g = linear @ (z[0] - target at rest), up to a constant.

    Attributes:
        powers: A^l, l = 0 .. H, each of shape (4, 4).
        lifts: G_l, l = 0 .. H, each of shape (4, 2 H).
        quadratic: M, shape (2 H, 2 H).
        linear: Shape (2 H, 4).
    """

    powers: list[Array]
    lifts: list[Array]
    quadratic: Array
    linear: Array

    @classmethod
    def of(cls, sample_time: float, options: PredictionOptions, cost: CostOptions) -> "Prediction":
        """Lift the model over the horizon.

        Args:
            sample_time: t_s, in s.
            options: Horizon and model.
            cost: Weights; the terminal cost is beta z'Pz with P from the discrete Riccati equation.

        Raises:
            ValueError: The Riccati equation has no stabilising solution.

        Source: Memon et al., eq. (1) and Section IV; the lag is the exact solution of v' = (v_ref - v) / lag.
        """
        horizon = options.horizon
        powers, lifts = _lift(sample_time, horizon, options.velocity_lag)
        Q, R = _square(cost.state, 4), _square(cost.input, 2)
        A, B = powers[1], lifts[1][:, :2]
        P = cost.terminal * solve_riccati(A, B, Q, R)
        stages = [(G, Q, power) for G, power in zip(lifts[:-1], powers[:-1], strict=True)]
        stages.append((lifts[-1], P, powers[-1]))
        quadratic: Array = np.asarray(np.kron(np.eye(horizon), R) + sum(G.T @ W @ G for G, W, _ in stages), np.float64)
        linear: Array = np.asarray(sum(G.T @ W @ power for G, W, power in stages))
        for array in (*powers, *lifts, quadratic, linear):
            array.setflags(write=False)
        return cls(powers, lifts, quadratic, linear)


def state_ahead(state: State, flown: Setpoint | None, delay: float, lag: float | None) -> Array:
    """Return position and velocity after `delay` (s) under the setpoint that is being flown, shape (2 d,).

    Without a setpoint the velocity is constant. `lag` is the `velocity_lag` of `PredictionOptions`: None for a body
    that holds the acceleration; otherwise its velocity tends to that of the setpoint, or to rest if the setpoint has no
    acceleration.
    """
    position, velocity = state.position, state.velocity
    if lag is None or flown is None:
        held = None if flown is None else flown.acceleration
        acceleration = np.zeros_like(velocity) if held is None else np.resize(held, velocity.shape)
        return np.concatenate(
            (position + velocity * delay + acceleration * (delay**2 / 2), velocity + acceleration * delay)
        )
    wanted = np.zeros_like(velocity)
    if flown.acceleration is not None:
        wanted[: len(flown.velocity)] = flown.velocity
    left = np.exp(-delay / lag) if lag else 0.0  # part of the velocity error that is left
    apart = velocity - wanted
    return np.concatenate((position + wanted * delay + apart * lag * (1 - left), wanted + apart * left))


def _square(values: float | Sequence[float], size: int) -> Array:
    """Return a diagonal matrix from a number or its diagonal."""
    return np.diag(np.broadcast_to(np.asarray(values, dtype=np.float64), (size,)))


def _lift(sample_time: float, horizon: int, lag: float | None) -> tuple[list[Array], list[Array]]:
    """Return powers A^l and lifted input matrices G_l, l = 0 .. horizon."""
    eye, zero = np.eye(2), np.zeros((2, 2))
    A = np.block([[eye, sample_time * eye], [zero, eye]])
    B = np.vstack([gain * eye for gain in _gains(sample_time, lag)])
    powers, lifts = [np.eye(4)], [np.zeros((4, 2 * horizon))]
    for step in range(horizon):
        powers.append(A @ powers[-1])
        lift = A @ lifts[-1]
        lift[:, 2 * step : 2 * step + 2] += B
        lifts.append(lift)
    return powers, lifts


def _gains(sample_time: float, lag: float | None) -> tuple[float, float]:
    """Return the gains from a unit acceleration to position and velocity at the end of a step."""
    if lag is None:
        return sample_time**2 / 2, sample_time
    reached = 1 - np.exp(-sample_time / lag) if lag else 1.0  # part of the change of velocity that is reached
    return sample_time * (sample_time - lag * reached), sample_time * reached
