import re
import textwrap
from pathlib import Path
from typing import Any

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from dcf_zenoh.config import LoadedFleet, Overrides, load, to_toml
from tests.support.lossy_fleets import lossy


def again(spec_text: str, folder: Path) -> LoadedFleet:
    copy = folder / "again.toml"
    copy.write_text(spec_text, encoding="utf-8")
    return load(copy)


def test_written_out_file_loads_to_the_same_fleet(file: Path) -> None:
    changes = ["zenoh.settings.a/b='x [\\n'", "time.arrived.within=0.1", "agents.1.endpoint=tcp/127.0.0.1:9"]
    for fleet in (load("position_swap"), load(file, Overrides(topology="star", algorithm="fine"), changes=changes)):
        assert again(to_toml(fleet.spec), file.parent).spec == fleet.spec


def test_written_out_file_is_complete_and_in_order(file: Path) -> None:
    text = to_toml(load(file).spec)
    assert re.findall(r"^\[(\w+)\]", text, re.M) == [
        "time",
        "exchange",
        "topology",
        "problem",
        "algorithm",
        "controller",
        "safety",
        "log",
        "zenoh",
    ]
    assert "start = [0.0, 1.0]\n" in text
    assert "max_rounds = 200\n" in text


def test_fleet_with_faults_loads_to_the_same_fleet(tmp_path: Path) -> None:
    changes = [
        "faults.loss=0.1",
        "faults.a={kind='./mine.py:Dull',often=3}",
        "faults.rule.3={from=[1,2],to=4,loss=false,noise=0.1}",
        "faults.rule.4={during=[1,2],a=4}",
        "agents.1.faults={crash={at=8,restart_after=0.5},slow={factor=2,during=[1,2]}}",
        "agents.2.faults.pause=[1,2]",
        "agents.3.exchange.period=0.01",
    ]
    for texts in ([], changes, ["faults.rule=[]"], ["faults.rule=[{from=1,to=2,loss=0.3}]"]):
        fleet = load(lossy(tmp_path), changes=texts)
        assert again(to_toml(fleet.spec), tmp_path).spec == fleet.spec


def test_faults_are_written_as_one_would_write_them(tmp_path: Path) -> None:
    text = to_toml(load(lossy(tmp_path)).spec)
    assert text[text.index("[faults") : text.index("\n[safety")] == textwrap.dedent("""\
        [faults.latency]
        kind = "latency"
        distribution = "uniform"
        low = 0.0002
        high = 0.0008
        reorder = true

        [[faults.rule]]
        from = 2
        to = 3

        [faults.rule.bursts]
        kind = "bursts"
        mean_loss = 0.2
        mean_length = 4
        loss_good = 0.0
        loss_bad = 1.0

        [[faults.rule]]
        during = [4.0, 4.5]

        [faults.rule.partition]
        kind = "partition"
        groups = [[1, 2], [3, 4]]
        """)
    assert "faults" not in to_toml(load("position_swap").spec)


OPTIONS = st.recursive(
    st.booleans() | st.integers(-(2**53), 2**53) | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(
    options=st.dictionaries(st.text(min_size=1), OPTIONS, max_size=4),
    threshold=st.floats(0, 1e300),
    seed=st.integers(0, 2**63 - 1),
)
def test_any_value_survives_writing_out(file: Path, options: dict[str, Any], threshold: float, seed: int) -> None:
    spec = load(file, Overrides(seed=seed), changes=[f"exchange.threshold={threshold!r}"]).spec
    zenoh = spec.zenoh.model_copy(update={"settings": options})
    spec = spec.model_copy(update={"zenoh": zenoh})
    assert again(to_toml(spec), file.parent).spec == spec
