"""What happens when a daemon dies or fails, with real daemons over Zenoh."""

import os
import re
import signal
from pathlib import Path

import numpy as np
import pytest

import dcf_zenoh
from dcf_zenoh import Run
from dcf_zenoh.errors import AlgorithmError, DcfError, NumericalError, PlantError
from tests.support.daemons import PROCESSES, Launch
from tests.support.small_fleet import small_fleet
from tests.support.waiting import until

pytestmark = [
    pytest.mark.real_time,
    pytest.mark.whole_fleet,
    pytest.mark.skipif(not (PROCESSES / "self").exists(), reason="processes are found in /proc"),
]

FRAGILE = small_fleet(
    "fragile",
    plant="body",
    time={"duration": 2.0},
    problem={"kind": "./fragile.py:Hover"},
    algorithm={"kind": "./fragile.py:fragile"},
    plants={"body": {"kind": "./fragile.py:Body"}},
    agents={"1": {"start": [0.0, 0.0]}, "2": {"start": [1.0, 0.0]}},
)

PLUGINS = """\
import math
import numpy as np
from dcf_zenoh.plant import Setpoint, State
from plants.point_mass import PointMass


class Hover:
    def at(self, states):
        return self

    def setpoint(self, decision, stage):
        return Setpoint(acceleration=decision)


def fragile(problem, me, *, fails: str = ""):
    step = me.recall("step", 0)
    breaks = fails if me.id == 2 and step == 3 else ""
    decision = np.zeros(2)
    for round in range(1, 5):
        if breaks == "raise" and round == 3:
            print("about to divide")
            1 / 0
        if breaks == "mix" and round == 3:
            me.mix(inbox, "y")
        inbox = yield {"x": decision}, math.nan if breaks == "residual" and round == 3 else 1.0
    return me.result(decision * (math.nan if breaks == "decision" else 1.0), step=step + 1)


class Body(PointMass):
    def __init__(self, agent, start, *, fails: str = ""):
        super().__init__(start)
        self.fails = fails if agent == 2 else ""
        self.steps = 0

    def start(self, now):
        if self.fails == "start":
            raise RuntimeError("the battery\\n is empty")

    def sense(self, now):
        if self.steps == 3 and self.fails == "sense":
            raise OSError("no answer from the radio")
        broken = math.nan if self.steps == 3 and self.fails == "state" else 1.0
        state = super().sense(now)
        return State(state.position * broken, state.velocity)

    def act(self, setpoint, now):
        self.steps += 1
        if self.steps == 4 and self.fails == "act":
            {}["motor"]
        super().act(setpoint, now)
"""
LINE = {word: PLUGINS[: PLUGINS.index(word)].count("\n") + 1 for word in ("1 / 0", "me.mix", "raise OSError")}


@pytest.fixture
def fragile(tmp_path: Path) -> Path:
    (tmp_path / "fragile.py").write_text(PLUGINS)
    (tmp_path / "fragile.toml").write_text(FRAGILE)
    return tmp_path / "fragile.toml"


def shared_memory() -> set[str]:
    folder = Path("/dev/shm")
    return {path.name for path in folder.iterdir()} if folder.is_dir() else set()


def test_when_a_daemon_is_killed_the_others_stop_within_a_second(trio: Path, tmp_path: Path) -> None:
    with Launch(trio, tmp_path / "run", "safety.neighbour_silent.after=5.0") as launch:
        pids = launch.flying()
        os.kill(pids[2], signal.SIGKILL)
        assert until(lambda: not launch.daemons(), "the others have stopped") < 1.0
        assert launch.end() == 1
        run = Run.read(launch.folder)
        cause, *effects = run.about["problems"]
        assert re.fullmatch(r"agent 2 was killed by SIGKILL \d+\.\d s after the launch, after step \d+", cause)
        assert launch.errors.splitlines()[-1] == f"agentd: {cause}"
        assert len(effects) == 2
        for agent in (1, 3):
            end = run.agents[agent].end
            assert end is not None
            assert end["end"] == "landed"
            assert re.match(  # perhaps the third one has stopped already too
                rf"agent {agent}: step \d+: .*neighbour 2 is lost \(its liveliness token is gone\)", end["remark"]
            )
        assert run.agents[2].end is None
        assert min(len(log.step) for log in run.agents.values()) >= 3
        assert run.about["exit_codes"] == {"1": 3, "2": -9, "3": 3}


def test_when_a_daemon_is_killed_the_others_hold_if_the_fleet_file_says_so(trio: Path, tmp_path: Path) -> None:
    changes = ["safety.neighbour_silent.then='hold'", "time.duration=4.0"]
    with Launch(trio, tmp_path / "run", *changes) as launch:
        pids = launch.flying(5)
        killed_after = max(len(log.step) for i in pids if (log := launch.log(i)))
        os.kill(pids[2], signal.SIGKILL)
        assert launch.end() == 1
        run = Run.read(launch.folder)
        assert re.search(r"agentd: agent 2 was killed by SIGKILL", launch.errors)
        for agent in (1, 3):
            log = run.agents[agent]
            held = [step for step, word in zip(log.step, log.stopped_by, strict=True) if word == "abstained"]
            assert held == list(range(held[0], 20))
            assert killed_after <= held[0] <= killed_after + 5  # within 1 s
            assert {log.remarks[step] for step in held} == {"neighbour 2 is lost (its liveliness token is gone)"}
            assert log.end is not None
            assert (log.end["end"], log.end["remark"]) == ("done", log.remarks[-1])
            assert np.linalg.norm(log.state[held[0], 2:]) > 0.05  # it was on its way
            np.testing.assert_array_equal(log.end["state"][2:], 0.0)  # and came to rest


def test_a_fleet_that_cannot_start_any_more_ends_before_its_patience_does(trio: Path, tmp_path: Path) -> None:
    changes = ["safety.neighbour_silent.then='continue'", "zenoh.ready_timeout=100.0"]
    with Launch(trio, tmp_path / "run", *changes) as launch:
        until(lambda: len(launch.daemons()) == 3, "three processes")
        os.kill(launch.daemons()[2], signal.SIGKILL)
        assert launch.end(30.0) == 1
        assert re.match(
            r"agentd: agent 2 was killed by SIGKILL \d+\.\d s after the launch, before its first step\n", launch.errors
        )


def test_a_killed_daemon_in_virtual_time_is_an_error_and_no_result(trio: Path, tmp_path: Path) -> None:
    before = shared_memory()
    with Launch(trio, tmp_path / "run", "time.clock='virtual'", "time.duration=1000.0") as launch:
        pids = launch.flying()
        os.kill(pids[2], signal.SIGKILL)
        assert until(lambda: not launch.daemons(), "the others have stopped") < 1.0
        assert launch.end() == 1
        assert re.search(r"agentd: agent 2 was killed by SIGKILL \d+\.\d s after the launch", launch.errors)
        assert "Traceback" not in launch.errors
        run = Run.read(launch.folder)
        for agent in (1, 3):
            end = run.agents[agent].end
            assert end is not None
            assert re.fullmatch(
                rf"agent {agent}: neighbour 2 is lost \(its liveliness token is gone\) in step \d+ round \d+",
                end["remark"],
            )
    assert shared_memory() <= before


@pytest.mark.parametrize(("number", "clock"), [(signal.SIGINT, "wall"), (signal.SIGTERM, "virtual")])
def test_a_signal_to_the_launcher_ends_all(number: signal.Signals, clock: str, trio: Path, tmp_path: Path) -> None:
    with Launch(trio, tmp_path / "run", f"time.clock='{clock}'", "time.duration=1000.0") as launch:
        pids = launch.flying()
        launch.process.send_signal(number)
        assert until(lambda: launch.process.poll() is not None, "the launcher has ended") < 2.0
        assert launch.end() == 128 + number
        assert launch.errors.splitlines()[-1] == f"agentd: stopped by {number.name}"
        assert "Traceback" not in launch.errors
        run = Run.read(launch.folder)
        assert len(run.agents) == len(pids)
        for log in run.agents.values():
            assert log.end is not None
            if log.end["end"] == "failed":  # in virtual time it may hear of a neighbour's end before its own signal
                assert clock == "virtual"
            else:
                assert (log.end["end"], log.end["remark"]) == ("stopped", "stopped by SIGTERM")


def test_daemons_end_by_themselves_when_the_launcher_is_killed(trio: Path, tmp_path: Path) -> None:
    with Launch(trio, tmp_path / "run") as launch:
        launch.flying()
        launch.process.kill()
        assert until(lambda: not launch.daemons(), "the daemons have stopped") < 2.0
        ends = [log.end for log in Run.read(launch.folder).agents.values()]
        assert {end and end["remark"] for end in ends} == {"stopped by the launcher's end"}


def test_an_algorithm_that_raises_is_named_with_step_round_and_line(fragile: Path, tmp_path: Path) -> None:
    with Launch(fragile, tmp_path / "run", "time.clock='wall'", "algorithm.fails='raise'") as launch:
        assert launch.end() == 1
        said = f"agent 2: step 3 round 3: ZeroDivisionError: division by zero (fragile.py:{LINE['1 / 0']})"
        lines = launch.errors.splitlines()
        assert re.fullmatch(
            r"agentd: agent 2 ended with exit code 1 \d+\.\d s after the launch, after step 2: " + re.escape(said),
            lines[-1],
        )
        assert len(lines) == 3  # each of the two agents, and the cause at last
        own = (launch.folder / "agent-2.err").read_text()
        assert own.startswith("about to divide\nTraceback (most recent call last):\n")
        assert "    1 / 0\n" in own
        assert own.endswith(f"\nagentd: {said}\n")
        other = (launch.folder / "agent-1.err").read_text()
        assert re.fullmatch(
            r"agentd: agent 1: step \d: neighbour 2 is lost \(it stopped because of an error\)\n", other
        )
        run = Run.read(launch.folder)
        assert [len(log.step) for log in run.agents.values()] == [len(run.agents[1].step), 3]
        end = run.agents[2].end
        assert end is not None
        assert (end["end"], end["remark"]) == ("failed", said)


@pytest.mark.parametrize(
    ("change", "last", "said"),  # after the rounds of a step its failure is noticed in the next one
    [
        ("algorithm.fails='decision'", 4, "agent 2: step 3 round 5: the algorithm's decision is not finite: [nan nan]"),
        ("plants.body.fails='state'", 3, "agent 2: step 3: the plant's state is not finite: [nan nan  0.  0.]"),
        ("plants.body.fails='act'", 4, "agent 2: step 3: act: KeyError: 'motor' (fragile.py:"),
    ],
)
def test_what_breaks_in_one_agent_ends_the_fleet_in_virtual_time(
    change: str, last: int, said: str, fragile: Path, tmp_path: Path
) -> None:
    with Launch(fragile, tmp_path / "run", "time.clock='virtual'", change) as launch:
        assert launch.end() == 1
        assert f" after the launch, after step 2: {said}" in launch.errors.splitlines()[-1]
        assert "Traceback" not in launch.errors
        run = Run.read(launch.folder)
        assert len(run.agents[1].step) == last
        assert len(run.agents[2].step) == 3
        assert run.about["exit_codes"] == {"1": 3, "2": 1}
        assert re.fullmatch(
            rf"agentd: agent 1: neighbour 2 stopped because of an error, seen in step {last} round 0\n",
            (launch.folder / "agent-1.err").read_text(),
        )


@pytest.mark.parametrize(
    ("change", "error", "said"),
    [
        (
            "algorithm.fails='raise'",
            AlgorithmError,
            f"agent 2: step 3 round 3: ZeroDivisionError: division by zero (fragile.py:{LINE['1 / 0']})",
        ),
        (
            "algorithm.fails='mix'",
            AlgorithmError,
            "agent 2: step 3 round 3: the agent's own payload has no entry 'y' to mix",
        ),
        (
            "algorithm.fails='residual'",
            NumericalError,
            "agent 2: step 3 round 3: the algorithm's residual is not a number; it diverges if a step size is too",
        ),
        (
            "plants.body.fails='sense'",
            PlantError,
            f"agent 2: step 3: sense: OSError: no answer from the radio (fragile.py:{LINE['raise OSError']})",
        ),
        ("plants.body.fails='start'", PlantError, "agent 2: start: RuntimeError: the battery is empty (fragile.py:"),
    ],
)
def test_the_simulator_says_the_same(change: str, error: type[DcfError], said: str, fragile: Path) -> None:
    with pytest.raises(error) as caught:
        dcf_zenoh.simulate(fragile, changes=[change])
    assert str(caught.value).startswith(said)
    assert caught.value.__cause__ is not None or error is NumericalError


def test_two_fleets_on_one_machine_do_not_disturb_each_other(trio: Path, fragile: Path, tmp_path: Path) -> None:
    changes = ["time.clock='virtual'", "time.duration=4.0"]
    with (
        Launch(trio, tmp_path / "a" / "run", *changes) as one,
        Launch(fragile, tmp_path / "b" / "run", *changes) as other,
        Launch(trio, tmp_path / "c" / "run", *changes, "seed=2", "exchange.max_rounds=30") as third,
    ):
        assert [launch.end() for launch in (one, other, third)] == [0, 0, 0]
        assert one.summary["digest"] == dcf_zenoh.simulate(trio, changes=changes).digest
        assert other.summary["digest"] == dcf_zenoh.simulate(fragile, changes=changes).digest
        expected = dcf_zenoh.simulate(trio, changes=[*changes, "seed=2", "exchange.max_rounds=30"]).digest
        assert third.summary["digest"] == expected
        assert len({launch.summary["digest"] for launch in (one, other, third)}) == 3
