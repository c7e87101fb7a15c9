import hashlib
import json
from pathlib import Path

from dcf_zenoh.config import freeze, load
from tests.fleet_files import MINE
from topologies import star


def test_frozen_fleet_has_its_plugins_beside_it(file: Path, tmp_path: Path) -> None:
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
