"""Injected faults against the kernel's own, on the same run: one direction of a cable has these, the other those.

Two daemons in two network namespaces speak Zenoh over UDP, whose lost packets nobody sends again. Publications are
express and smaller than the MTU, so one message is one packet; the tests count both and see that it is so. Hellos and
the start are smaller than any message, so a rule for large packets leaves them alone.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from dcf_zenoh.message import Last, Message, canonical
from dcf_zenoh.messaging.delivery import Delivery
from dcf_zenoh.records.agent_log import AgentLog
from tests.support.namespaces import DEVICE, Cable

pytestmark = [pytest.mark.real_time, pytest.mark.whole_fleet]

CONFIDENCE = 0.999
VALUES = tuple(0.5 + k for k in range(60))  # 480 bytes of payload
LARGE = 300  # bytes; hellos and the like are shorter, messages with VALUES longer
ETHERNET = 14  # bytes that tc counts of a frame, and nft does not

FLEET = f"""
name = "kernel"

[time]
clock = "wall"
sample_time = 6.0

[exchange]
threshold = 0
skip_after_rounds = 1000000
KEYS

[problem]
kind = "average"
value = {list(VALUES)}

[algorithm]
kind = "average_consensus"

[agents.1]
endpoint = "udp/{Cable.address(1)}:7447"

[agents.2]
endpoint = "udp/{Cable.address(2)}:7447"

[safety.neighbour_silent]
then = "continue"

[zenoh.settings]
"transport/unicast/open_timeout" = 300     # ms; who calls before the other listens calls again soon
"transport/unicast/accept_timeout" = 300

[[faults.rule]]
from = 2
to = 1
"""


@pytest.fixture
def cable() -> Iterator[Cable]:
    with Cable() as cable:
        cable.inside(2, "nft", "add table inet kernel; add chain inet kernel in { type filter hook input priority 0; }")
        yield cable


def fly(cable: Cable, folder: Path, keys: str, fault: str) -> tuple[AgentLog, AgentLog]:
    """Run the fleet with `keys` of its exchange and `fault` from 2 to 1; what agents 1 and 2 recorded."""
    path = folder / "kernel.toml"
    path.write_text(FLEET.replace("KEYS", keys) + fault)
    logs = cable.run(path, folder / "run", within=30)
    return logs[1], logs[2]


def filtered(cable: Cable) -> list[tuple[int, int]]:
    """Packets and bytes that each rule at agent 2 has counted."""
    words = cable.inside(2, "nft", "list", "table", "inet", "kernel").split()
    return [(int(words[k + 2]), int(words[k + 4])) for k, word in enumerate(words) if word == "counter"]


def message_size() -> int:
    """Of one message of the fleet, in bytes; it varies by a few with its numbers."""
    payload = canonical({"x": np.array(VALUES)})
    message = Message(1, 0, 1000, 0, 1000, 2 * 10**9, -1, -1, 0, Last.NO, (0.1,), (), payload)
    return Delivery(message, 0, 0).size


@pytest.mark.parametrize(
    "mode",
    ["synchronous", "asynchronous"],
)
def test_injected_loss_is_that_of_random_drops_in_the_kernel(cable: Cable, tmp_path: Path, mode: str) -> None:
    rule = f"add rule inet kernel in udp length > {LARGE} counter numgen random mod 100 < 20 counter drop"
    cable.inside(2, "nft", rule)
    keys = f'mode = "{mode}"\nround_timeout = 0.002\nperiod = 0.001\nbudget = 5.0\nmax_rounds = 4000'
    one, two = fly(cable, tmp_path, keys, "loss = 0.2")
    (packets, _), (dropped, _) = filtered(cable)

    sent = 1 + max(each.round for each in two.passed)  # up to the last that came
    kernel = sent - len(two.passed)
    assert packets == one.rounds.sum(), "one message is not one packet"
    assert kernel <= dropped, "something is missing that the kernel did not drop"
    assert not any(each.lost_by for each in two.passed)

    conveyed = len(one.passed)
    injected = sum(each.lost_by == "loss" for each in one.passed)
    assert conveyed == 1 + max(each.round for each in one.passed), "the clean direction is not clean"
    assert min(sent, conveyed) > 300  # 4000 where the machine is not too busy

    for lost, count in ((kernel, sent), (injected, conveyed)):
        interval = stats.binomtest(lost, count).proportion_ci(CONFIDENCE)
        assert interval.low <= 0.2 <= interval.high
    both = [[kernel, sent - kernel], [injected, conveyed - injected]]
    assert stats.fisher_exact(both).pvalue > 1 - CONFIDENCE


def test_injected_bandwidth_is_that_of_a_token_bucket_in_the_kernel(cable: Cable, tmp_path: Path) -> None:
    """Rate, burst and queue are the same numbers on both sides, each in the bytes that it counts.

    The kernel counts Ethernet frames: the message, and what Zenoh, UDP, IP (nft sees so far) and Ethernet add, some 80
    bytes here. The injected fault counts encoded messages. Both are offered more than they carry.
    """
    rate, burst, queue = 40_000, 3000, 30_000  # bytes/s, bytes, bytes
    cable.inside(2, "nft", f"add rule inet kernel in udp length > {LARGE} counter")
    bucket = f"tbf rate {8 * rate}bit burst {burst} limit {queue}"
    cable.inside(1, "tc", "qdisc", "add", "dev", DEVICE, "root", *bucket.split())
    keys = "round_timeout = 0.0015\nbudget = 4.0\nmax_rounds = 1000000"
    one, two = fly(cable, tmp_path, keys, f"bandwidth = {{ rate = {rate}, burst = {burst}, queue = {queue} }}")
    ((packets, length),) = filtered(cable)

    sizes = {"kernel": length / packets + ETHERNET, "injected": float(message_size())}
    offered = {"kernel": one.rounds.sum(), "injected": two.rounds.sum()}
    windows = np.linspace(0.5, 4.0, 8)  # s; the queues fill up before
    flow = {}  # bytes/s, window by window
    for side, log in (("kernel", two), ("injected", one)):
        if offered[side] * sizes[side] < 1.5 * 4.0 * rate:
            pytest.skip(f"the machine is too busy to fill a link: {offered[side]} messages in 4 s")
        due = [each.due * 1e-9 for each in log.passed if each.due >= 0]
        flow[side] = np.histogram(due, windows)[0] * sizes[side] / np.diff(windows)
        assert flow[side].mean() == pytest.approx(rate, rel=0.03)
    apart = flow["kernel"] - flow["injected"]
    spread = stats.t.ppf(0.5 + CONFIDENCE / 2, len(apart) - 1) * apart.std(ddof=1) / np.sqrt(len(apart))
    one_message = max(sizes.values()) / np.diff(windows)[0]  # a window holds a whole number of them
    assert abs(apart.mean()) <= spread + one_message
