"""Options that the problems of agents that change places have in common: sub-tables of ``[problem]``."""

from collections.abc import Sequence
from dataclasses import dataclass

from dcf_zenoh.problems.shared.diamond import Obstacle
from dcf_zenoh.spec import NonNegativeFloat

RENAMED = {  # key of an earlier version -> its name now
    "horizon": "prediction.horizon",
    "accel_max": "prediction.accel_max",
    "velocity_lag": "prediction.velocity_lag",
    "state_weight": "cost.state",
    "input_weight": "cost.input",
    "terminal_weight": "cost.terminal",
    "gather_weight": "cost.gather",
    "gather_at": "cost.gather_at",
    "radii": "barrier.radii",
    "barrier_decay": "barrier.decay",
    "barrier_margin": "barrier.margin",
    "obstacles": "barrier.obstacles",
}


@dataclass(frozen=True)
class PredictionOptions:
    """Prediction of an agent's own motion.

    Attributes:
        horizon: H, in steps.
        accel_max: Bound on each component of the acceleration, in m/s².
        velocity_lag: None: the body holds the acceleration, as a double integrator does. Otherwise the body is given
            the velocity v + a t_s in every step, and tends to it with this time constant, in s; 0: it has it at once.

    Raises:
        ValueError: A number is out of its range.
    """

    horizon: int = 3
    accel_max: float = 2.0
    velocity_lag: float | None = None

    def __post_init__(self) -> None:
        for name, value in (("horizon", self.horizon), ("accel_max", self.accel_max)):
            if not value > 0:
                raise ValueError(f"{name} must be positive, not {value}")
        if self.velocity_lag is not None and not self.velocity_lag >= 0:
            raise ValueError(f"velocity_lag must be a time >= 0, in s, not {self.velocity_lag}")


@dataclass(frozen=True)
class CostOptions:
    """Weights of an agent's cost, and the place where the fleet gathers.

    Attributes:
        state: Q: a number, or the diagonal for [px, py, vx, vy].
        input: R: a number, or the diagonal for [ax, ay].
        terminal: beta, the weight of the terminal cost.
        gather: p_a, the weight of the mean end position.
        gather_at: p_o, in m.

    Raises:
        ValueError: A diagonal has another length, or a negative number.
    """

    state: float | tuple[float, ...] = 5.0
    input: float | tuple[float, ...] = 2.0
    terminal: float = 1.5
    gather: float = 1.0
    gather_at: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        for name, values, size in (("state", self.state, 4), ("input", self.input, 2)):
            diagonal = values if isinstance(values, Sequence) else (values,) * size
            if len(diagonal) != size or not min(diagonal) >= 0:
                raise ValueError(f"{name} must be a number >= 0 or {size} of them, not {values}")


@dataclass(frozen=True)
class BarrierOptions:
    """Barrier between pairs of agents.

    Attributes:
        radii: Half axes r1, r2 of the safety region, in m.
        decay: gamma of the discrete barrier condition, in (0, 1].

    Raises:
        ValueError: A number is out of its range.
    """

    radii: tuple[float, float] = (0.5, 0.25)
    decay: float = 0.1

    def __post_init__(self) -> None:
        if not min(self.radii) > 0:
            raise ValueError(f"radii must be positive, not {min(self.radii)}")
        if not 0 < self.decay <= 1:
            raise ValueError(f"decay must be in (0, 1], not {self.decay}")


@dataclass(frozen=True)
class DiamondOptions(BarrierOptions):
    """Barrier of diamond-shaped safety regions, between agents and with obstacles.

    Attributes:
        margin: Least barrier value h that is kept, instead of 0. The rows hold as exactly as they are solved: a fleet
            that stands still against them settles about (threshold / gamma) / 10 below.
        obstacles: Obstacles, each ``[x, y, r1, r2]``: centre and half axes of a diamond, in m.

    Raises:
        ValueError: A number is out of its range, or an obstacle does not have four.
    """

    margin: NonNegativeFloat = 0.0
    obstacles: tuple[tuple[float, float, float, float], ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        for each in self.obstacles:
            Obstacle.of(each)


DEFAULT_PREDICTION, DEFAULT_COST = PredictionOptions(), CostOptions()
DEFAULT_BARRIER, DEFAULT_DIAMONDS = BarrierOptions(), DiamondOptions()
