"""What happens when a daemon freezes: it lives, and neither says nor takes anything."""

import os
import re
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from dcf_zenoh import Run
from tests.support.daemons import PROCESSES, Launch
from tests.support.waiting import until

pytestmark = [
    pytest.mark.real_time,
    pytest.mark.whole_fleet,
    pytest.mark.skipif(not (PROCESSES / "self").exists(), reason="processes are found in /proc"),
]
FLY_ON = "time.arrived.within=1e-9"  # nobody has ever arrived
IN_A_HURRY = "import agentd.launcher.launch as f; f.REACTION = f.TERM = 0.5; f.LINGER = 3.0"


@contextmanager
def frozen(fleet: Path | str, folder: Path, *changes: str) -> Iterator[Launch]:
    """A fleet whose agent 2 freezes in flight."""
    with Launch(fleet, folder / "run", *changes, before=IN_A_HURRY) as launch:
        os.kill(launch.flying()[2], signal.SIGSTOP)
        yield launch


def test_a_frozen_daemon_is_noticed_by_the_age_of_its_messages(trio: Path, tmp_path: Path) -> None:
    with frozen(trio, tmp_path) as launch:
        took = until(lambda: set(launch.daemons()) <= {2}, "the others have stopped")
        assert launch.end() == 1
        assert took < 1.5
        run = Run.read(launch.folder)
        for agent in (1, 3):
            end = run.agents[agent].end
            assert end is not None
            found = re.match(
                rf"agent {agent}: step \d+: .*neighbour 2 is lost \(nothing heard for (\d\.\d+) s\)", end["remark"]
            )
            assert found, end["remark"]
            assert 0.6 <= float(found[1]) < 1.0
        assert re.fullmatch(
            r"agent 2 did not end within 0\.5 s of SIGTERM: killed, after step \d+", run.about["problems"][0]
        )
        assert run.about["exit_codes"] == {"1": 3, "2": -9, "3": 3}


def test_a_frozen_daemon_does_not_keep_the_launcher_from_ending_when_the_others_hold(
    trio: Path, tmp_path: Path
) -> None:
    changes = ["safety.neighbour_silent.then='hold'", "time.duration=2.0"]
    with frozen(trio, tmp_path, *changes) as launch:
        assert launch.end() == 1
        assert re.search(r"agentd: agent 2 did not end within 0\.5 s of SIGTERM: killed", launch.errors)
        run = Run.read(launch.folder)
        assert run.about["exit_codes"] == {"1": 0, "2": -9, "3": 0}
        assert {run.agents[i].stopped_by[-1] for i in (1, 3)} == {"abstained"}


def test_those_who_fly_on_without_a_frozen_daemon_end_as_planned(tmp_path: Path) -> None:
    changes = ["time.duration=4.0", FLY_ON]
    with frozen("position_swap_lossy", tmp_path, *changes) as launch:
        assert launch.end(60.0) == 1
        run = Run.read(launch.folder)
        assert run.about["exit_codes"] == {"1": 0, "2": -9, "3": 0, "4": 0}
        assert [log.end and log.end["end"] for log in run.agents.values()] == ["done", None, "done", "done"]
        assert {(launch.folder / f"agent-{i}.err").read_text() for i in (1, 3, 4)} == {""}


def test_a_frozen_daemon_does_not_cut_the_others_off_from_each_other(tmp_path: Path) -> None:
    """Zenoh gives a link up after the lease, and waits for what it could not send; so long nothing else may wait."""
    changes = [
        "time.duration=6.0",
        FLY_ON,
        "zenoh.settings.transport/link/tx/lease=1000",
        "zenoh.settings.transport/link/tcp/so_rcvbuf=4096",
    ]
    with frozen("position_swap_lossy", tmp_path, *changes) as launch:
        launch.end(60.0)
        run = Run.read(launch.folder)
        said = [remark for i in (1, 3, 4) for remark in run.agents[i].remarks if remark]
        assert {int(word) for remark in said for word in re.findall(r"neighbour (\d) is", remark)} == {2}


def test_a_neighbour_that_takes_nothing_holds_up_the_others_for_a_moment_only(tmp_path: Path) -> None:
    changes = [
        "time.duration=8.0",
        FLY_ON,
        "zenoh.settings.transport/link/tcp/so_rcvbuf=4096",
        "zenoh.settings.transport/link/tcp/so_sndbuf=4096",
    ]
    with frozen("position_swap_lossy", tmp_path, *changes) as launch:
        launch.end(60.0)
        run = Run.read(launch.folder)
        for i in (1, 3, 4):
            assert len(run.agents[i].step) >= 30
            assert np.diff(run.agents[i].sensed).max() < 2.0  # s; Zenoh itself would wait for 5


def test_a_daemon_that_freezes_before_the_start_does_not_keep_the_launcher_from_ending(
    trio: Path, tmp_path: Path
) -> None:
    (tmp_path / "frozen.py").write_text(
        "import os, signal\n"
        "from plants.point_mass import PointMass\n"
        "class Frozen(PointMass):\n"
        "    def prepare(self):\n"
        "        os.kill(os.getpid(), signal.SIGSTOP)\n"
    )
    changes = [
        f"plants.frozen.kind='{tmp_path}/frozen.py:Frozen'",
        "agents.2.plant='frozen'",
        "safety.neighbour_silent.then='continue'",
        "zenoh.ready_timeout=2.0",
    ]
    with Launch(trio, tmp_path / "run", *changes, before=IN_A_HURRY) as launch:
        assert launch.end(40.0) == 1
        assert re.search(r"agent 1 ended with exit code 1 .* before its first step: agent 1: .*\b2\b", launch.errors)
        assert "agent 2 did not end within 0.5 s of SIGTERM: killed, before its first step" in launch.errors
