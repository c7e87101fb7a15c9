from io import BytesIO
from pathlib import Path

import numpy as np
import pytest

import dcf_zenoh
from dcf_zenoh.assembly import Blueprint
from dcf_zenoh.config import Overrides, load
from dcf_zenoh.errors import DcfError
from dcf_zenoh.graph import Graph
from dcf_zenoh.loop.agent import Arrival
from dcf_zenoh.message import Last, Message
from dcf_zenoh.messaging.mailbox import Mailbox
from dcf_zenoh.simulation import run_agents
from dcf_zenoh.spec import Arrived

S = 1_000_000_000  # ns


def test_agent_has_arrived_when_it_stayed_near_for_long_enough() -> None:
    arrival = Arrival(Arrived.model_validate({"within": 0.05, "for": 1.0}))
    distances = {0: 0.04, 1: 0.06, 2: 0.05, 3: 0.01}
    assert [arrival.update(second * S, distance) for second, distance in distances.items()] == [False] * 3 + [True]
    assert not arrival.update(4 * S, 0.2)
    assert not arrival.update(5 * S, 0.0)


def test_without_a_rule_an_agent_never_arrives() -> None:
    assert not Arrival(None).update(9 * S, 0.0)


def test_the_run_ends_at_the_same_step_everywhere_when_all_have_arrived() -> None:
    run = dcf_zenoh.simulate("position_swap", topology="path")
    assert {len(log.step) for log in run.agents.values()} == {run.steps}
    assert run.steps < run.fleet.time.steps
    assert {log.end["end"] for log in run.agents.values() if log.end} == {"arrived"}
    assert run.arrival_time == pytest.approx((run.steps - 1) * 0.2 - 1.0)


# Two rounds of 0.09 s end a step by its budget of 0.15 s; the result is there at 0.27 s, after the next step's start.
SLOW = ["exchange.compute_time=0.09", "time.duration=2.0"]


def test_a_step_that_overruns_holds_if_the_fleet_says_so() -> None:
    run = dcf_zenoh.simulate("position_swap", changes=[*SLOW, "exchange.late=hold"])
    for log in run.agents.values():
        assert log.late.all()
        assert set(log.stopped_by) == {"budget"}
        assert np.isnan(log.setpoint[:, -2:]).all()  # no acceleration: come to rest
        np.testing.assert_array_equal(log.path, np.tile(log.path[0], (len(log.path), 1)))
    assert run.summary()["deadline_misses"] == 4 * run.steps


def test_steps_that_overrun_are_never_skipped_and_start_at_once() -> None:
    run = dcf_zenoh.simulate("position_swap", changes=SLOW)
    log = run.agents[1]
    np.testing.assert_array_equal(log.step, np.arange(10))
    np.testing.assert_allclose(log.sensed[1:], log.acted[:-1])


def test_agent_that_has_stopped_is_not_waited_for(tmp_path: Path) -> None:
    file = tmp_path / "early.py"
    file.write_text(
        "def early(problem, me):\n"
        "    for number in range(2 * me.id):\n"
        "        inbox = yield {'x': float(number)}, 1.0\n"
        "        if inbox.stop:\n"
        "            break\n"
        "    return me.result([number])\n"
    )
    run = dcf_zenoh.simulate("average", algorithm=f"{file}:early", changes=["exchange.max_rounds=7"])
    assert {i: int(log.rounds[0]) for i, log in run.agents.items()} == {1: 2, 2: 4, 3: 6, 4: 7, 5: 7}


def test_single_agent_flies_to_its_target(tmp_path: Path) -> None:
    file = tmp_path / "lone.toml"
    file.write_text(
        'name = "lone"\n[time]\nclock = "virtual"\narrived = {}\n[problem]\nkind = "position_swap"\n'
        '[algorithm]\nkind = "trades"\n[plants.point_mass]\n[agents.7]\nstart = [0.0, 0.0]\ntarget = [1.0, 0.5]\n'
    )
    run = dcf_zenoh.simulate(file)
    assert run.arrival_time is not None
    np.testing.assert_allclose(run.agents[7].path[-1], [1.0, 0.5], atol=0.05)
    assert run.summary()["min_distance"] is None
    assert run.summary()["ended_by"] == {"agreed": run.steps}  # it iterates without waiting
    assert run.agents[7].rounds[0] > 10
    assert (run.agents[7].negotiation == 0).all()


def test_stuck_simulation_names_what_each_agent_waits_for() -> None:
    blueprint = Blueprint.of(load("average", Overrides(clock="virtual")))
    parts = [blueprint.build(i, BytesIO(), {"run": "x"}) for i in (1, 2, 3, 4)]  # agent 5 never comes
    links = [link for link in blueprint.graph.links if 5 not in link]
    with pytest.raises(DcfError, match=r"the simulation is stuck: agent 1 waits for \[5\] in step -8 round 0"):
        run_agents(parts, Graph.of((1, 2, 3, 4), links))


def test_forged_arrival_of_the_fleet_ends_no_flight(monkeypatch: pytest.MonkeyPatch) -> None:
    put = Mailbox.put
    forged: list[Message] = []

    def put_with_a_forged_one(self: Mailbox, message: Message, entered: int, due: int | None = None) -> bool:
        if (message.sender, message.step, message.round) == (2, 3, 2) and not forged:
            forged.append(message._replace(last=Last.ARRIVED, payload={}))
            put(self, forged[0], entered, due)
        return put(self, message, entered, due)

    monkeypatch.setattr(Mailbox, "put", put_with_a_forged_one)
    run = dcf_zenoh.simulate("position_swap", changes=["time.duration=3.0"])
    assert len(forged) == 1
    assert {(log.end["end"], len(log.step)) for log in run.agents.values() if log.end} == {("done", 15)}
