"""Real Zenoh sessions over the loopback interface."""

import socket
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pytest
import zenoh

import dcf_zenoh
from agentd.daemon.inbound import Inbound
from dcf_zenoh import Run
from dcf_zenoh.errors import NetworkError, NotReady
from dcf_zenoh.graph import Neighbourhood
from dcf_zenoh.message import BYTES_MAX, VERSION, Last, Message, encode
from dcf_zenoh.messaging.address import Address, endpoints_to_connect
from dcf_zenoh.messaging.events import Lost, Refused, Stop
from dcf_zenoh.messaging.handshake import ClockOffset
from dcf_zenoh.messaging.mailbox import Mailbox
from dcf_zenoh.messaging.network import CHANNEL_SIZE, Network
from tests.support.daemons import TRIO, Launch
from tests.support.strangers import bare_session
from tests.support.waiting import until

pytestmark = pytest.mark.real_time

PREFIX = "dcf/test/run"
LINKS = {1: [2], 2: [1]}  # agent -> its in-neighbours


def free_ports(count: int) -> list[int]:
    with ExitStack() as stack:
        probes = [stack.enter_context(socket.socket()) for _ in range(count)]
        for probe in probes:
            probe.bind(("127.0.0.1", 0))
        return [probe.getsockname()[1] for probe in probes]


class Site:
    """Endpoints and in-neighbours of a fleet's agents."""

    def __init__(self, hears: Mapping[int, list[int]] = LINKS) -> None:
        ports = free_ports(len(hears))
        self.hears = hears
        self.endpoints = {i: f"tcp/127.0.0.1:{port}" for i, port in zip(hears, ports, strict=True)}

    def open(self, agent: int) -> Network:
        """Open the session of one agent."""
        receives = tuple(self.hears[agent])
        sends = tuple(j for j in self.hears if agent in self.hears[j])
        weights = dict.fromkeys((agent, *receives), 1 / (1 + len(receives)))
        neighbourhood = Neighbourhood(receives, sends, weights, 1, doubly_stochastic=False)
        connect = endpoints_to_connect(agent, sorted({*receives, *sends}), self.endpoints)
        return Network(agent, neighbourhood, Address(PREFIX, self.endpoints[agent], connect, {}))


@contextmanager
def met(hears: Mapping[int, list[int]] = LINKS) -> Iterator[tuple[dict[int, Network], Site]]:
    """Open the sessions of a fleet that has done its handshake."""
    site = Site(hears)
    with ExitStack() as stack:
        networks = {i: stack.enter_context(site.open(i)) for i in hears}
        meet(networks)
        yield networks, site


def meet(networks: Mapping[int, Network], timeout: float = 10.0) -> dict[int, dict[int, ClockOffset]]:
    with ThreadPoolExecutor() as pool:
        found = {i: pool.submit(network.do_handshake, "same", timeout) for i, network in networks.items()}
        return {i: future.result(timeout + 5.0) for i, future in found.items()}


def message(sender: int, sequence: int, size: int = 3, last: Last = Last.NO) -> Message:
    payload = {"x": np.full(size, float(sequence))}
    return Message(sender, 0, sequence, 4, sequence, 10 * sequence, -1, -1, 0, last, (0.5,), (), payload)


def soon(seconds: float = 10.0) -> float:
    return time.monotonic() + seconds


def receive(network: Network, sender: int, within: float = 10.0) -> Message:
    """Return the next message, skipping events."""
    deadline = soon(within)
    while (found := network.receive(sender, deadline)) is None:
        assert time.monotonic() < deadline, f"nothing from {sender}"
        network.next_event(0.0)
    assert isinstance(found, Message), found
    return found


def event_of(network: Network, kind: type, within: float = 10.0) -> object:
    """Return the next event of a kind."""
    deadline = soon(within)
    while not isinstance(event := network.next_event(deadline), kind):
        assert time.monotonic() < deadline, f"no {kind.__name__}"
    return event


def knock(stranger: zenoh.Session, key: str) -> None:
    """Wait until messages of a foreign session can be received."""
    publisher = stranger.declare_publisher(key)
    until(lambda: publisher.matching_status.matching, "a link")  # type: ignore[attr-defined]
    publisher.undeclare()  # type: ignore[no-untyped-call]


def next_refused(network: Network, sender: int = 1) -> Refused:
    deadline = soon()
    while (found := network.receive(sender, deadline)) is None:
        assert time.monotonic() < deadline, "nothing"
        network.next_event(0.0)
    assert isinstance(found, Refused)
    return found


def holds(true: Callable[[], bool], seconds: float) -> bool:
    """Return whether a condition holds for a while."""
    end = soon(seconds)
    while true():
        if time.monotonic() >= end:
            return True
        time.sleep(0.005)  # between two looks
    return False


def attacks(sender: int) -> dict[str, bytes]:
    """Return bytes that are no message of `sender` -> why."""
    good = encode(message(sender, 10**6))
    fields = msgpack.unpackb(good, use_list=True)
    return {
        "not a msgpack message: FormatError": b"\xc1 anything",
        "not a msgpack message: ValueError": good[: len(good) // 2],
        "not a msgpack message: ValueError Unpack failed: incomplete input": b"",
        "expected a msgpack array, got int": b"\x07",
        f"version {VERSION + 1} is not spoken here": msgpack.packb([VERSION + 1, *fields[1:]]),
        "expected 13 fields after the version, got 12": msgpack.packb(fields[:-1]),
        "sequence: expected an integer of -1048576 to": msgpack.packb([*fields[:3], "7", *fields[4:]]),
        "payload 'x': dtype '|O' is not accepted": msgpack.packb([*fields[:-1], {"x": ["|O", [1], b"12345678"]}]),
        f"{BYTES_MAX + 1} bytes are too many": b"\0" * (BYTES_MAX + 1),
        f"it claims to come from agent {sender + 70}": encode(message(sender + 70, 0)),
    }


def test_handshake_measures_the_clock_offsets() -> None:
    site = Site({1: [2, 3], 2: [1, 3], 3: [1, 2]})
    with ExitStack() as stack:
        offsets = meet({i: stack.enter_context(site.open(i)) for i in site.hears})
    for i, found in offsets.items():
        assert sorted(found) == [j for j in site.hears if j != i]
        for offset in found.values():  # it is the same clock
            assert abs(offset.ahead) <= offset.error + 1_000
            assert offset.error < 0.5e9


def test_connecting_agent_waits_for_the_listening_one_to_start() -> None:
    site = Site()
    with site.open(2) as early, ThreadPoolExecutor() as pool:
        future = pool.submit(early.do_handshake, "same", 10.0)
        assert holds(lambda: not future.done(), 0.3)
        with site.open(1) as late:
            late.do_handshake("same", 10.0)
            assert list(future.result(10.0)) == [1]


class LosingHellos:
    """A session that loses some of its first hellos; everything else goes to the real one."""

    def __init__(self, session: zenoh.Session, pattern: int) -> None:
        self._session = session
        self._pattern = pattern

    def put(self, key: str, *args: Any, **options: Any) -> None:
        """Publish, unless it is a hello to be lost."""
        if "/hello/" in key:
            lost, self._pattern = self._pattern & 1, self._pattern >> 1
            if lost:
                return
        self._session.put(key, *args, **options)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._session, name)


@pytest.mark.parametrize("pattern", [0b0, 0b1, 0b10, 0b110, 0b1110, 0b111110, 0b1010, 0b11])
def test_handshake_completes_though_hellos_of_one_side_are_lost(pattern: int) -> None:
    site = Site()
    with site.open(1) as one, site.open(2) as two, ThreadPoolExecutor() as pool:
        one._session = LosingHellos(one._session, pattern)  # type: ignore[assignment]
        futures = {network: pool.submit(network.do_handshake, "same", 5.0) for network in (one, two)}
        deadline = soon(8.0)
        while not all(future.done() for future in futures.values()):
            assert time.monotonic() < deadline
            for network, future in futures.items():
                if future.done():  # it goes on, as its loop does
                    Inbound(network, Mailbox([]), _unstamped).events(time.monotonic() + 0.005)
        assert [sorted(future.result()) for future in futures.values()] == [[2], [1]]


def _unstamped(message: Message) -> tuple[int, int]:
    return message.sent, message.sent


def test_missing_neighbour_is_named_at_the_deadline() -> None:
    site = Site({1: [2, 3], 2: [1, 3], 3: [1, 2]})
    with site.open(1) as one, site.open(2) as two, ThreadPoolExecutor() as pool:
        began = time.monotonic()
        found = [pool.submit(network.do_handshake, "same", 0.6) for network in (one, two)]
        errors = [str(future.exception(10.0)) for future in found]
        assert 0.6 <= time.monotonic() - began < 2.0
        assert [type(future.exception()) for future in found] == [NotReady, NotReady]
    text = "not ready within 0.6 s: nothing heard of agent 3"
    assert errors == [f"agent 1: {text}", f"agent 2: {text}"]
    assert issubclass(NotReady, TimeoutError)


def test_neighbour_that_leaves_before_all_are_ready_has_to_come_back() -> None:
    site = Site({1: [2, 3], 2: [1, 3], 3: [1, 2]})
    with site.open(1) as one, ThreadPoolExecutor() as pool:
        patient = pool.submit(one.do_handshake, "same", 10.0)
        with site.open(2) as two, pytest.raises(NotReady):
            two.do_handshake("same", 0.5)
        with site.open(3) as three:
            other = pool.submit(three.do_handshake, "same", 10.0)
            assert holds(lambda: not patient.done(), 0.3)
            with site.open(2) as two:
                two.do_handshake("same", 10.0)
                assert sorted(patient.result(10.0)) == [2, 3]
                assert sorted(other.result(10.0)) == [1, 2]


def test_another_fleet_file_is_refused() -> None:
    site = Site()
    with site.open(1) as one, site.open(2) as two, ThreadPoolExecutor() as pool:
        found = pool.submit(one.do_handshake, "abc", 10.0), pool.submit(two.do_handshake, "xyz", 10.0)
        errors = [future.exception(10.0) for future in found]
    assert str(errors[0]) == (
        "agent 1: agent 2 runs another fleet file, other plug-ins or another version: fingerprint xyz, expected abc"
    )
    assert isinstance(errors[1], NetworkError)


def test_stop_ends_the_wait_for_neighbours() -> None:
    site = Site()
    with site.open(1) as one, ThreadPoolExecutor() as pool:
        future = pool.submit(one.do_handshake, "same", 10.0)
        one.notify(Stop("stopped by SIGTERM"))
        assert str(future.exception(2.0)) == "agent 1: stopped by SIGTERM before all neighbours were ready"


def test_port_in_use_is_named() -> None:
    site = Site()
    with site.open(1), pytest.raises(NetworkError) as caught:
        site.open(1)
    assert str(caught.value).startswith(f"agent 1: cannot listen on {site.endpoints[1]}, or cannot connect to []: ")
    assert "\n" not in str(caught.value)


def test_setting_unknown_to_zenoh_is_named() -> None:
    with pytest.raises(NetworkError, match=r"zenoh\.settings.*transport/link/tx/leese.* 3: "):
        Address(PREFIX, "tcp/127.0.0.1:0", (), {"transport/link/tx/leese": 3}).config()


def test_one_way_links_become_ready_and_carry_messages_one_way() -> None:
    with met({1: [], 2: [1], 3: [2]}) as (networks, _):
        networks[1].publish(message(1, 0))
        assert receive(networks[2], 1).sequence == 0
        networks[2].publish(message(2, 5))
        assert receive(networks[3], 2).sequence == 5
        assert networks[2].poll(1) is None
        with pytest.raises(KeyError):
            networks[1].receive(2, soon())


def test_messages_to_all_and_to_one_are_received_in_order() -> None:
    with met({1: [2, 3], 2: [1, 3], 3: [1, 2]}) as (networks, _):
        for number in range(300):
            networks[1].publish(message(1, number), (None, 2, 3)[number % 3])
        for number in range(300):
            if number % 3 != 2:
                found = receive(networks[2], 1)
                assert found.sequence == number
                np.testing.assert_array_equal(found.payload["x"], np.full(3, float(number)))
            if number % 3 != 1:
                assert receive(networks[3], 1).sequence == number
        assert networks[2].poll(1) is None
        assert networks[3].poll(1) is None


def test_time_of_sending_can_be_stamped_at_the_last_moment() -> None:
    with met() as (networks, _):
        networks[1].publish(message(1, 3), None, 12345)
        found = receive(networks[2], 1)
        assert found.sent == 12345
        assert found[:5] == message(1, 3)[:5]
        assert found[6:-1] == message(1, 3)[6:-1]


def test_message_of_a_megabyte_is_received_whole() -> None:
    with met() as (networks, _):
        large = np.random.default_rng(1).normal(size=125_000)
        networks[1].publish(message(1, 0)._replace(payload={"x": large}))
        np.testing.assert_array_equal(receive(networks[2], 1).payload["x"], large)


def test_closed_session_is_reported_to_its_neighbours() -> None:
    site = Site({1: [2, 3], 2: [1, 3], 3: [1, 2]})
    with site.open(1) as one, site.open(2) as two:
        with site.open(3) as three:
            meet({1: one, 2: two, 3: three})
            three.publish(message(3, 0))
            receive(one, 3)
        assert event_of(one, Lost) == Lost(3)
        assert event_of(two, Lost) == Lost(3)
        receive(two, 3)  # its earlier messages are still there
        one.publish(message(1, 0))  # the others continue
        assert receive(two, 1).sequence == 0


def test_wait_ends_at_its_deadline_without_a_message() -> None:
    late = []
    with met() as (networks, _):
        while networks[1].next_event(soon(0.1)) is not None:  # hellos
            pass
        for ahead in (0.0, 0.001, 0.01, 0.03, 0.05) * 5:
            deadline = time.monotonic() + ahead
            assert networks[1].receive(2, deadline) is None
            late.append(time.monotonic() - deadline)
    assert min(late) >= 0.0
    assert sorted(late)[len(late) // 2] < 0.02
    assert max(late) < 0.5


def test_message_ends_a_wait_long_before_its_deadline() -> None:
    with met() as (networks, _), ThreadPoolExecutor() as pool:
        for number in range(20):
            waiting = pool.submit(receive, networks[2], 1)
            networks[1].publish(message(1, number))
            assert waiting.result(2.0).sequence == number


def test_event_ends_a_wait_for_messages_and_loses_none() -> None:
    with met() as (networks, _), ThreadPoolExecutor() as pool:
        while networks[2].next_event(soon(0.1)) is not None:
            pass
        for number in range(20):
            waiting: Future[Message | Refused | None] = pool.submit(networks[2].receive, 1, soon(30.0))
            networks[2].notify(Stop(f"number {number}"))
            assert waiting.result(2.0) is None
            assert networks[2].next_event(0.0) == Stop(f"number {number}")
            networks[1].publish(message(1, number))
            assert receive(networks[2], 1).sequence == number


def test_session_with_a_full_channel_closes() -> None:
    with ExitStack() as stack:
        site = Site()
        one, two = stack.enter_context(site.open(1)), site.open(2)
        meet({1: one, 2: two})
        sent = 0
        over = threading.Event()

        def flood() -> None:
            nonlocal sent
            while sent < 3 * CHANNEL_SIZE and not over.is_set():
                one.publish(message(1, sent, size=100))
                sent += 1

        sender = threading.Thread(target=flood)
        sender.start()
        stack.callback(sender.join)
        until(lambda: sent > CHANNEL_SIZE, "a full channel")
        closing = threading.Thread(target=two.__exit__, args=(None, None, None), daemon=True)
        closing.start()
        closing.join(5.0)
        over.set()
        assert not closing.is_alive()
        sender.join(5.0)
        assert not sender.is_alive()


def test_bytes_that_are_no_message_are_refused_and_change_nothing() -> None:
    with met() as (networks, site), bare_session(site.endpoints[2]) as stranger:
        key = f"{PREFIX}/from/1/to/2"
        knock(stranger, key)
        for reason, data in attacks(1).items():
            stranger.put(key, data)
            found = next_refused(networks[2])
            assert found.key == key
            assert reason in found.reason
            networks[1].publish(message(1, 7))
            assert receive(networks[2], 1).sequence == 7
        for data in (b"", b"\xc1", msgpack.packb([9, "same", 1, 2, 3]), msgpack.packb([1, "same", 1, 2, None])):
            stranger.put(f"{PREFIX}/hello/1/to/2", data)
            event = event_of(networks[2], Refused)
            assert isinstance(event, Refused)
            assert event.key == f"{PREFIX}/hello/1/to/2"


def test_refused_hellos_before_the_start_are_reported_after_it() -> None:
    site = Site()
    with site.open(1) as one, bare_session(site.endpoints[1]) as stranger, ThreadPoolExecutor() as pool:
        future = pool.submit(one.do_handshake, "same", 20.0)
        key = f"{PREFIX}/hello/2/to/1"
        knock(stranger, key)
        stranger.put(key, b"no hello")
        with site.open(2) as two:
            two.do_handshake("same", 10.0)
            future.result(10.0)
        assert str(getattr(event_of(one, Refused), "reason", "")).startswith("not a hello")


def test_fleet_under_attack_gives_the_same_result(tmp_path: Path) -> None:
    fleet = tmp_path / "trio.toml"
    fleet.write_text(TRIO[: TRIO.index("[agents.3]")])
    changes = ["time.clock='virtual'", "time.duration=20.0"]
    with Launch(fleet, tmp_path / "run", *changes) as launch, ExitStack() as stack:
        until(lambda: launch.about.get("endpoints"), "the endpoints")
        stranger = stack.enter_context(bare_session(*launch.about["endpoints"].values()))
        attacked = {f"dcf/trio/run/{kind}/{i}/to/{j}": i for i, j in ((1, 2), (2, 1)) for kind in ("from", "hello")}
        for key in attacked:
            knock(stranger, key)
            stranger.put(key, b"\0" * (BYTES_MAX + 1))
        deadline = soon(60.0)
        while launch.process.poll() is None and time.monotonic() < deadline:
            for key, sender in attacked.items():
                for data in attacks(sender).values():
                    if len(data) < BYTES_MAX:
                        stranger.put(key, data)
        assert launch.end() == 0
        run = Run.read(launch.folder)
        for agent, log in run.agents.items():
            assert log.end is not None
            assert log.end["counts"]["refused"] > 10
            assert log.end["counts"]["duplicates"] == 0
            complaints = (launch.folder / f"agent-{agent}.err").read_text().splitlines()
            assert len(complaints) == 5
            assert all(line.startswith("refused a message on dcf/trio/run/") for line in complaints)
        assert run.digest == dcf_zenoh.simulate(fleet, changes=changes).digest
