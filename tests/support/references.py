"""The reference instances in tests/data, as problems of this project."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dcf_zenoh.graph import Graph
from dcf_zenoh.plant import Array
from dcf_zenoh.problems.position_swap import PositionSwap, SwapGame
from dcf_zenoh.problems.shared.swap_options import CostOptions

DATA = Path(__file__).parents[1] / "data"
INSTANCES = ("n4_complete_start", "n4_line_agg", "n4_star_boxactive", "n6_line_nonpotential")


@dataclass(frozen=True)
class Reference:
    """One control step of the position-swap game, with its solution."""

    name: str
    data: dict[str, Any]

    @classmethod
    def read(cls, name: str) -> "Reference":
        return cls(name, json.loads((DATA / f"{name}.json").read_text()))

    @property
    def agents(self) -> tuple[int, ...]:
        return tuple(range(self.data["N"]))

    @property
    def links(self) -> list[list[int]]:
        adjacency = self.data["adjacency"]
        return [[i, j] for i in self.agents for j in self.agents if adjacency[i][j]]

    @property
    def graph(self) -> Graph:
        return Graph.of(self.agents, self.links)

    def problem(self, agent: int) -> PositionSwap:
        return PositionSwap(
            agent,
            self.agents,
            self.data["ts"],
            target=tuple(self.data["targets"][agent][:2]),
            cost=CostOptions(gather=self.data["p_a"][agent], gather_at=tuple(self.data["p_o"])),
        )

    @property
    def games(self) -> dict[int, SwapGame]:
        states = {i: np.array(self.data["states"][i]) for i in self.agents}
        return {i: self.problem(i).at(states) for i in self.agents}

    def expected(self, name: str, agent: int) -> Array:
        return np.array(self.data[name][agent])

    def fleet_file(self, *, rounds: int, threshold: float, order: str = "adapt_then_combine") -> str:
        """A fleet that plays this one step, as TOML."""
        states, targets = self.data["states"], self.data["targets"]
        agents = "\n".join(
            f"[agents.{i}]\nstart = {states[i][:2]}\ntarget = {targets[i][:2]}\n"
            f"problem.cost.gather = {self.data['p_a'][i]}\nplants.point.velocity = {states[i][2:]}"
            for i in self.agents
        )
        return f"""
name = "{self.name}"
plant = "point"
[time]
clock = "virtual"
sample_time = {self.data["ts"]}
duration = {self.data["ts"]}
[exchange]
max_rounds = {rounds}
threshold = {threshold}
[topology]
kind = "edges"
directed = true
links = {self.links}
[problem]
kind = "position_swap"
cost.gather_at = {self.data["p_o"]}
[algorithm]
kind = "trades"
order = "{order}"
[plants.point]
kind = "point_mass"
[log]
rounds = true
{agents}
"""
