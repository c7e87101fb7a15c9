from pathlib import Path

import pytest

from dcf_zenoh.config import load
from tests.support.fleet_files import problems

SWAP, AVERAGE = (Path(load(each).source) for each in ("position_swap", "average"))
ALLOWED = "allowed: tcp, udp, tls, quic, ws, unixsock-stream, unixpipe, vsock, serial"


@pytest.mark.parametrize(
    ("endpoint", "problem"),
    [
        ("tpc/127.0.0.1:7447", f"unknown protocol 'tpc'; did you mean 'tcp'? {ALLOWED}"),
        ("tcp/127.0.0.1", "expected tcp/HOST:PORT, not 'tcp/127.0.0.1'"),
        ("udp/:7447", "expected udp/HOST:PORT, not 'udp/:7447'"),
        ("tcp/fe80::1:7447", "expected tcp/HOST:PORT, not 'tcp/fe80::1:7447'"),
        ("tls/pi1.local:70000#iface=eth0", "expected a port from 1 to 65535, not 70000"),
        ("tcp/127.0.0.1:0", "expected a port from 1 to 65535, not 0"),
        (
            "tcp/127.0.0.1:7452",
            "tcp/127.0.0.1:7452 is the default endpoint of agent 2 (zenoh.base_port + id); each needs its own",
        ),
    ],
)
def test_an_endpoint_on_which_no_agent_can_listen_is_refused(endpoint: str, problem: str) -> None:
    assert problems(SWAP, f"agents.1.endpoint={endpoint!r}") == [f"agents.1.endpoint: {problem}"]


@pytest.mark.parametrize(
    "endpoint", ["tcp/[::1]:7447", "udp/192.168.1.11:7447?rel=0", "unixsock-stream//run/a.sock", "serial//dev/ttyACM0"]
)
def test_endpoints_of_all_forms_are_accepted(endpoint: str) -> None:
    assert load(SWAP, changes=[f"agents.1.endpoint={endpoint!r}"]).notes == ()


def test_an_id_beyond_what_ports_or_messages_carry_is_told() -> None:
    assert load(AVERAGE, changes=["agents.60000.problem.value=[1.0]"]).notes == (
        "zenoh.base_port: 7450 + 60000 is no port, so agent 60000 has no endpoint unless `agentd launch` starts it:"
        " set agents.60000.endpoint, or give it a smaller id",
    )
    both = ["agents.60000.problem.value=[1.0]", "agents.60000.endpoint=tcp/127.0.0.1:7000"]
    assert load(AVERAGE, changes=both).notes == ()
    assert problems(AVERAGE, f"agents.{2**53 + 1}.problem.value=[1.0]") == [
        f"agents.{2**53 + 1}: the id of an agent is at most {2**53}, as messages carry it"
    ]
