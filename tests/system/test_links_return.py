"""Links that break in flight and come back, and links that lose: real daemons, on the wall clock."""

import json
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from dcf_zenoh.records.agent_log import AgentLog
from dcf_zenoh.records.log_writer import log_name
from tests.dcf_zenoh.messaging.test_network import free_ports
from tests.support.namespaces import DEVICE, Cable
from tests.support.relays import LossyUdpRelay, TcpRelay
from tests.support.small_fleet import TRIO, small_fleet
from tests.support.waiting import until

pytestmark = [pytest.mark.real_time, pytest.mark.whole_fleet]

ROUNDS = 5  # per step
DAEMON = """
import json, sys
from pathlib import Path
from agentd.daemon.daemon import Assignment, run_agent
from dcf_zenoh.config import load
file, folder, agent, endpoints = sys.argv[1:]
endpoints = {int(i): endpoint for i, endpoint in json.loads(endpoints).items()}
run_agent(load(file), Assignment(int(agent), "r", Path(folder), endpoints))
"""


def write(
    folder: Path, duration: float, endpoints: Mapping[int, str], settings: Mapping[str, int] | None = None
) -> Path:
    file = folder / "pair.toml"
    text = small_fleet(
        "pair",
        time={"clock": "wall", "sample_time": 0.1, "duration": duration, "arrived": {"within": 1e-9}},
        exchange={"threshold": 0.0, "round_timeout": 0.01, "max_rounds": ROUNDS},
        agents={str(i): {**TRIO["agents"][str(i)], "endpoint": endpoint} for i, endpoint in endpoints.items()},
        safety={"neighbour_silent": {"then": "continue"}},
        zenoh={"ready_timeout": 20.0, "settings": settings or {}},
    )
    file.write_text(text)
    return file


def steps_of(folder: Path, agent: int) -> int:
    """How many steps an agent has recorded so far."""
    path = folder / log_name(agent)
    data = path.read_bytes() if path.is_file() else b""
    return len(AgentLog.read(data, path.name).step) if data else 0


def logs(folder: Path) -> dict[int, AgentLog]:
    return {i: AgentLog.read((folder / log_name(i)).read_bytes(), log_name(i)) for i in (1, 2)}


@contextmanager
def pair(folder: Path, duration: float, protocol: str, seen: Mapping[int, Mapping[int, str]]) -> Iterator[Path]:
    """Run agents 1 and 2 to their end, each with the endpoints that it sees; the run directory."""
    settings = {f"transport/unicast/{side}_timeout": 300 for side in ("open", "accept")}  # ms
    file = write(folder, duration, {i: f"{protocol}/127.0.0.1:{7000 + i}" for i in (1, 2)}, settings)
    out = folder / "run"
    with ExitStack() as ending:
        daemons = []
        for i in (1, 2):
            words = [str(file), str(out), str(i), json.dumps(seen[i])]
            daemon = subprocess.Popen([sys.executable, "-c", DAEMON, *words], stderr=subprocess.PIPE, text=True)
            ending.enter_context(daemon)
            ending.callback(daemon.kill)
            daemons.append(daemon)
        until(lambda: steps_of(out, 1) > 3 and steps_of(out, 2) > 3, "the agents fly", 15.0)
        yield out
        for daemon in daemons:
            errors = daemon.communicate(timeout=duration + 20.0)[1]
            assert daemon.returncode == 0, errors


def assert_healed(log: AgentLog, agent: int, neighbour: int, last: int) -> None:
    """The link broke, came back, and in the last steps messages are received in all rounds."""
    said = [remark for remark in log.remarks if remark]
    assert said[0].startswith(f"neighbour {neighbour} is lost"), said
    assert said[-1] == f"neighbour {neighbour} is back", said
    received, _, late, _ = log.links[neighbour][-last:].sum(axis=0)
    assert received >= 0.6 * ROUNDS * last, (agent, received)
    assert late <= 0.3 * ROUNDS * last, (agent, late)


def test_link_through_a_relay_that_is_restarted_is_used_again(tmp_path: Path) -> None:
    one, two = free_ports(2)
    with TcpRelay(one) as relay:
        ends = {1: f"tcp/127.0.0.1:{one}", 2: f"tcp/127.0.0.1:{two}"}
        with pair(tmp_path, 4.0, "tcp", {1: ends, 2: {**ends, 1: f"tcp/127.0.0.1:{relay.port}"}}) as folder:
            relay.stop()
            time.sleep(0.8)  # the outage
            relay.start()
        for agent, log in logs(folder).items():
            assert_healed(log, agent, 3 - agent, 10)


@pytest.mark.large
def test_link_over_an_interface_that_was_down_is_used_again(tmp_path: Path) -> None:
    with Cable(tools=("ip",)) as cable:
        file = write(tmp_path, 6.0, {i: f"tcp/{cable.address(i)}:7447" for i in (1, 2)})
        folder = tmp_path / "run"

        def interrupt() -> None:
            until(lambda: steps_of(folder, 1) > 3 and steps_of(folder, 2) > 3, "the agents fly", 15.0)
            cable.inside(1, "ip", "link", "set", DEVICE, "down")
            time.sleep(1.0)  # the outage
            cable.inside(1, "ip", "link", "set", DEVICE, "up")

        for agent, log in cable.run(file, folder, within=60.0, meanwhile=interrupt).items():
            assert_healed(log, agent, 3 - agent, 10)


@pytest.mark.parametrize("seed", [1, *(pytest.param(each, marks=pytest.mark.large) for each in (2, 3))])
def test_fleet_over_udp_with_loss_starts_and_loses_messages_of_rounds_only(tmp_path: Path, seed: int) -> None:
    one, two = free_ports(2)
    with LossyUdpRelay(one, 0.2, seed) as relay, TcpRelay(one, relay.port):
        ends = {1: f"udp/127.0.0.1:{one}", 2: f"udp/127.0.0.1:{two}"}
        began = time.monotonic()
        with pair(tmp_path, 3.0, "udp", {1: ends, 2: {**ends, 1: f"udp/127.0.0.1:{relay.port}"}}) as folder:
            assert time.monotonic() - began < 10.0
        for log in logs(folder).values():
            assert log.end is not None
            assert log.end["end"] == "done"
            (counts,) = log.links.values()
            missing = counts[:, 1].sum() / log.rounds.sum()
            assert 0.02 < missing < 0.6, missing
        assert relay.passed > 50  # the rounds go this way
