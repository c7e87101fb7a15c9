import hashlib
import json
from pathlib import Path

import pytest

from agentd.daemon.daemon import fingerprint
from dcf_zenoh.config import freeze, load
from dcf_zenoh.errors import PluginError
from dcf_zenoh.spec import FaultTable
from tests.support.fleet_files import MINE
from tests.support.lossy_fleets import MINE as FAULTS
from tests.support.lossy_fleets import lossy
from topologies import star


def test_frozen_fleet_has_its_plugins_next_to_it(file: Path, tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "mine.py").write_text(MINE + "\n# other")
    changes = ["topology.kind=topologies.star:star", "plants.point_mass.kind=./other/mine.py:Blimp"]
    fleet = load(file, changes=changes)
    run = tmp_path / "runs" / "1"
    frozen = freeze(fleet, run)
    assert frozen.folder == run
    assert frozen.spec.problem.kind == "./plugins/mine.py:Meet"
    assert frozen.spec.algorithm.kind == frozen.spec.algorithms["fine"].kind == "./plugins/mine.py:descend"
    assert frozen.spec.plants["point_mass"].kind == "./plugins/mine_2.py:Blimp"
    assert frozen.spec.topology.kind == "topologies.star:star"
    assert frozen.notes == fleet.notes
    assert load(run / "fleet.toml").spec == frozen.spec

    digests = json.loads((run / "plugins.json").read_text())
    assert star.__file__ is not None
    assert digests == {
        "plugins/mine.py": hashlib.sha256(MINE.encode()).hexdigest(),
        "plugins/mine_2.py": hashlib.sha256((MINE + "\n# other").encode()).hexdigest(),
        "topologies.star": hashlib.sha256(Path(star.__file__).read_bytes()).hexdigest(),
    }
    assert (run / "plugins" / "mine.py").read_text() == MINE


def test_frozen_faults_have_their_files_next_to_them(tmp_path: Path) -> None:
    (tmp_path / "here").mkdir()
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "tale.txt").write_text("twice upon a time")
    (tmp_path / "here" / "tale.txt").write_text("once upon a time")
    faults = (
        "[faults]\na = { kind = './mine.py:Told', story = 'tale.txt' }\n"
        "[[faults.rule]]\nto = 1\na = 'tale.txt'\n"
        "[[faults.rule]]\nto = 2\na = '../there/tale.txt'\n"
    )
    fleet = load(lossy(tmp_path / "here", faults))
    run = tmp_path / "run"
    frozen = freeze(fleet, run)
    kind = "./plugins/mine.py:Told"
    told = [rule.faults["a"] for rule in frozen.spec.faults.rules]
    assert told == [
        FaultTable.model_validate({"kind": kind, "story": story, "pace": 1.0})
        for story in ("profiles/tale.txt", "profiles/tale.txt", "profiles/tale_2.txt")
    ]
    assert load(run / "fleet.toml").spec == frozen.spec
    assert (run / "profiles" / "tale_2.txt").read_text() == "twice upon a time"
    assert json.loads((run / "plugins.json").read_text()) == {
        "plugins/mine.py": hashlib.sha256(FAULTS.encode()).hexdigest(),
        "profiles/tale.txt": hashlib.sha256(b"once upon a time").hexdigest(),
        "profiles/tale_2.txt": hashlib.sha256(b"twice upon a time").hexdigest(),
    }

    again = freeze(load(run / "fleet.toml"), tmp_path / "again")
    assert (again.spec, fingerprint(again)) == (frozen.spec, fingerprint(frozen))
    (run / "profiles" / "tale.txt").write_text("never")
    other = freeze(load(run / "fleet.toml"), tmp_path / "other")
    assert other.spec == frozen.spec
    assert fingerprint(other) != fingerprint(frozen)


def test_file_that_is_gone_is_named(tmp_path: Path) -> None:
    (tmp_path / "tale.txt").write_text("once")
    fleet = load(lossy(tmp_path, "[faults]\na = { kind = './mine.py:Told', story = 'tale.txt' }\n"))
    (tmp_path / "tale.txt").unlink()
    with pytest.raises(PluginError, match=r"^\./mine\.py:Told: cannot read .*tale\.txt: No such file or directory$"):
        freeze(fleet, tmp_path / "run")
