from pathlib import Path

import pytest

from dcf_zenoh.config import load
from dcf_zenoh.errors import ConfigurationError
from tests.support.fleet_files import problems


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (
            "name=two words",
            "name: expected a string that matches ^[A-Za-z0-9_][A-Za-z0-9_.-]*$"
            " (part of the keys on the wire and of the names of run directories), not 'two words'",
        ),
        ("seed=-1", "seed: expected a whole number >= 0, not -1"),
        ("seed=1.5", "seed: expected a whole number >= 0, not 1.5"),
        (
            "log.rounds=1",
            "log.rounds: expected true or false (record payload, residual and reception times of every round), not 1",
        ),
        ("time.sample_time=0", "time.sample_time: expected a number > 0 (control period t_s, s), not 0"),
        ("time.sample_time=true", "time.sample_time: expected a number > 0 (control period t_s, s), not true"),
        ("time.duration=inf", "time.duration: expected a number > 0 (length of the run, s), not inf"),
        ("algorithm=trades", "algorithm: expected a table, not 'trades'"),
        ("agents.2=3", "agents.2: expected a table, not 3"),
        ("agents={}", "agents: expected a table, not {}"),
        ("plants=3", "plants: expected a table (plants by name), not 3"),
        ("fautls={}", "fautls: a fleet file has no key 'fautls'; did you mean 'faults'? accepted: name, seed, plant, "),
        (
            "exchange.silent_after=5",
            "exchange.silent_after: [exchange] has no key 'silent_after' any more: it is called 'skip_after_rounds'",
        ),
        (
            "zenoh.silence_timeout=5.0",
            "zenoh.silence_timeout: [zenoh] has no key 'silence_timeout' any more: it is called 'receive_timeout'",
        ),
        ("problem={}", "problem.kind: missing; expected a string (name of a built-in or installed kind, "),
        (
            "topology.weights=fair",
            "topology.weights: expected 'auto' or 'metropolis' or 'laplacian' or 'uniform' or 'uneven' (mixing weights",
        ),
    ],
)
def test_value_of_another_type_or_out_of_bounds_is_refused(file: Path, change: str, problem: str) -> None:
    found = problems(file, change)
    assert any(text.startswith(problem) for text in found), found


def test_two_bodies_cannot_start_at_the_same_place() -> None:
    with pytest.raises(ConfigurationError, match=r"agents\.3\.start: the same place as agents\.2\.start"):
        load("position_swap", changes=["agents.2.start=[1.0, 0.0]"])


def test_times_beyond_all_reason_are_refused() -> None:
    with pytest.raises(ConfigurationError, match=r"exchange\.compute_time: expected at most 1e\+08 s, not 1e\+300"):
        load("position_swap", changes=["exchange.compute_time=1e300"])
