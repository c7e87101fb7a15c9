import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat

import dcf_zenoh
from agentd.results.export import export
from dcf_zenoh import Run
from dcf_zenoh.errors import ConfigurationError, RecordingError
from dcf_zenoh.records.agent_log import AgentLog
from dcf_zenoh.rounds.dialogue import RoundRecord


@pytest.fixture(scope="module")
def run() -> Run:
    return dcf_zenoh.simulate("position_swap", changes=["time.duration=1.0"])


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def column(rows: list[dict[str, str]], name: str) -> list[float]:
    return [float(row[name]) for row in rows]


def test_csv_holds_the_numbers_of_the_run_as_people_write_them(run: Run, tmp_path: Path) -> None:
    export(run, "csv", tmp_path / "run.csv")
    rows = rows_of(tmp_path / "run.csv")
    assert len(rows) == 4 * 5
    for agent, log in run.agents.items():
        own = [row for row in rows if row["agent"] == str(agent)]
        tables = {
            ("px", "py", "vx", "vy"): log.state,
            ("p_set_x", "p_set_y", "v_set_x", "v_set_y", "ax", "ay"): log.setpoint,
            tuple(f"decision_{n}" for n in range(6)): log.decision,
            ("sensed_s",): log.sensed[:, None],
            ("compute_s",): log.compute[:, None],
            ("negotiation_s",): log.negotiation[:, None],
            ("residual",): log.residual[:, None],
            ("step",): log.step[:, None],
            ("rounds",): log.rounds[:, None],
            ("messages_received",): sum(log.links.values(), np.zeros((5, 4)))[:, :1],
        }
        for names, table in tables.items():
            np.testing.assert_allclose(np.transpose([column(own, name) for name in names]), table, atol=1e-12, rtol=0)
        assert [row["sensed_s"] for row in own] == ["0.0", "0.2", "0.4", "0.6", "0.8"]
        assert [row["stopped_by"] for row in own] == list(log.stopped_by)
        assert column(own, "late") == [0.0] * 5


def test_csv_marks_what_is_not_a_number_and_leaves_empty_what_an_agent_does_not_have(run: Run, tmp_path: Path) -> None:
    setpoint = run.agents[1].setpoint.copy()
    setpoint[2, 4:] = np.nan  # come to rest
    resting = replace(run.agents[1], setpoint=setpoint)
    tall = replace(run.agents[2], state=np.zeros((5, 6)), setpoint=np.zeros((5, 9)))
    export(replace(run, agents={1: resting, 2: tall}), "csv", tmp_path / "run.csv")
    rows = rows_of(tmp_path / "run.csv")
    assert (rows[2]["ax"], rows[2]["pz"], rows[5]["pz"]) == ("nan", "", "0.0")
    names = list(rows[0])
    assert names.index("pz") == names.index("py") + 1


def test_npz_loads_without_pickle_and_holds_every_array(run: Run, tmp_path: Path) -> None:
    export(run, "npz", tmp_path / "run.npz")
    with np.load(tmp_path / "run.npz", allow_pickle=False) as found:
        assert found["agents"].tolist() == [1, 2, 3, 4]
        assert found["sample_time"] == 0.2
        for agent, log in run.agents.items():
            for name in ("state", "setpoint", "decision", "rounds", "late", "negotiation", "path"):
                np.testing.assert_array_equal(found[f"agent_{agent}_{name}"], getattr(log, name))
            assert found[f"agent_{agent}_stopped_by"].tolist() == list(log.stopped_by)
        np.testing.assert_array_equal(found["agent_1_links_2"], run.agents[1].links[2])


def test_mat_holds_a_struct_per_agent(run: Run, tmp_path: Path) -> None:
    export(run, "mat", tmp_path / "run.mat")
    found = loadmat(tmp_path / "run.mat", simplify_cells=True)
    assert (found["fleet"], found["agents"].tolist()) == ("position_swap", [1, 2, 3, 4])
    for agent, log in run.agents.items():
        struct = found[f"agent_{agent}"]
        np.testing.assert_array_equal(struct["state"], log.state)
        np.testing.assert_array_equal(struct["rounds"], log.rounds)
        assert list(struct["stopped_by"]) == list(log.stopped_by)


@pytest.mark.parametrize("fmt", ["csv", "npz", "mat"])
def test_logs_without_a_step_can_be_exported(run: Run, tmp_path: Path, fmt: str) -> None:
    log = run.agents[1]
    empty = {
        name: getattr(log, name)[:0] for name in AgentLog.__dataclass_fields__ if hasattr(getattr(log, name), "ndim")
    }
    nothing = replace(log, **empty, stopped_by=(), remarks=(), rounds_log=(), links={}, end=None)
    export(replace(run, agents={1: nothing}), fmt, tmp_path / "run")
    assert (tmp_path / "run").is_file()


def test_an_unknown_format_is_refused_with_the_nearest_spelling(run: Run, tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"unknown format 'cvs'; did you mean 'csv'\? known: csv, npz, mat"):
        export(run, "cvs", tmp_path / "run.csv")
    assert not list(tmp_path.iterdir())


def test_an_existing_file_is_left_alone(run: Run, tmp_path: Path) -> None:
    (tmp_path / "run.csv").write_text("mine")
    with pytest.raises(RecordingError, match=r"run\.csv: is there already; choose another file"):
        export(run, "csv", tmp_path / "run.csv")
    assert (tmp_path / "run.csv").read_text() == "mine"


def test_a_file_that_cannot_be_written_is_named(run: Run, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"nowhere/run\.csv: cannot be written: No such file or directory"):
        export(run, "csv", tmp_path / "nowhere" / "run.csv")


def test_without_a_file_it_is_named_after_the_run(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert export(run, "csv") == Path("position_swap.csv")
    assert Path("position_swap.csv").is_file()


def test_rounds_are_in_every_export(tmp_path: Path) -> None:
    run = dcf_zenoh.simulate("position_swap", changes=["log.rounds=true", "time.duration=0.4"])
    log = run.agents[2]
    residuals = [RoundRecord(*record).residual for rounds in log.rounds_log for record in rounds]
    assert len(residuals) == log.rounds.sum() > 20
    export(run, "npz", tmp_path / "run.npz")
    with np.load(tmp_path / "run.npz", allow_pickle=False) as found:
        np.testing.assert_array_equal(found["agent_2_round_residual"], residuals)
        np.testing.assert_array_equal(found["agent_2_round_step"], np.repeat([0, 1], log.rounds))
        np.testing.assert_array_equal(found["agent_2_round_number"][: log.rounds[0]], np.arange(log.rounds[0]))
        last = np.ravel(RoundRecord(*log.rounds_log[1][-1]).payload["lam"])
        np.testing.assert_array_equal(found["agent_2_round_payload_lam"][-1], last)
    assert export(run, "csv", tmp_path / "run.csv") == tmp_path / "run.csv"
    rows = [row for row in rows_of(tmp_path / "run_rounds.csv") if row["agent"] == "2"]
    assert [float(row["residual"]) for row in rows] == pytest.approx(residuals)
    assert (rows[-1]["step"], float(rows[-1]["lam_0"])) == ("1", last[0])
    export(run, "mat", tmp_path / "run.mat")
    struct = loadmat(tmp_path / "run.mat")["agent_2"][0, 0]
    np.testing.assert_array_equal(struct["round_residual"][:, 0], residuals)
