"""``servoscope assess`` of several data sets: by one process, and by workers that are killed."""

import json
import os
import shutil
import signal
import threading
import time
from pathlib import Path

import pytest

from html_page import check_page
from planar import planar_data_set
from servoscope.assessment.sets import failed_row, sets_table, sets_verdict, worst_first
from servoscope.cli import main
from servoscope.commands import run_sets
from servoscope.commands.run_sets import Assessed, folder_of, names_of
from servoscope.storage.run_folder import read_json

OPTIONS = ("--families", "moments", "--dofs", "tx", "--want", "tx=3mm")


@pytest.fixture(scope="module")
def sets(tmp_path_factory):
    """Two data sets, a third of which a chunk is damaged, and a name at which there is none."""
    folder = tmp_path_factory.mktemp("sets")
    for i in range(3):
        planar_data_set(60, 16, seed=i).save(folder / f"set{i}")
    damage(folder / "set2")
    return [str(folder / name) for name in ("set0", "nothing", "set1", "set2")]


def damage(folder):
    """Change a byte that is packed, so that only the check sum shows it; once more mends it."""
    chunk = folder / "images.zarr" / "c" / "1" / "0" / "0"
    whole = chunk.read_bytes()
    chunk.write_bytes(whole[:50] + bytes([whole[50] ^ 255]) + whole[51:])


def figures(run):
    """All that was found, but how long it took."""
    summary = read_json(run / "summary.json")
    return [{**row, "seconds": None} for row in summary["sets"]]


@pytest.fixture(scope="module")
def alone(sets, tmp_path_factory):
    """The run of one process."""
    run = tmp_path_factory.mktemp("alone") / "run"
    assert main(["assess", *sets, *OPTIONS, "--out", str(run), "--jobs", "1"]) == 1
    return run


@pytest.mark.slow
def test_each_set_is_a_row_and_one_that_cannot_be_read_its_reason(alone, sets):
    summary = read_json(alone / "summary.json")
    rows = {row["name"]: row for row in summary["sets"]}
    assert [row["name"] for row in summary["sets"][:2]] == ["nothing", "set2"]
    assert summary["n_failed"] == 2
    assert rows["nothing"]["error"].startswith(f"{sets[1]} is not a folder")
    assert "images.zarr cannot be read" in rows["set2"]["error"]
    for name in ("set0", "set1"):
        found = read_json(alone / "sets" / name / "summary.json")["assessed"]["dofs"]["tx"]
        assert rows[name]["dofs"]["tx"]["reached"] == found["one_look"]["rms"]
        assert rows[name]["dofs"]["tx"]["met"] is (found["one_look"]["rms"] <= 3.0)
        assert rows[name]["worst"]["ratio"] == pytest.approx(found["one_look"]["rms"] / 3.0)
    ratios = [row["worst"]["ratio"] for row in summary["sets"][2:]]
    assert ratios == sorted(ratios, reverse=True)


@pytest.mark.slow
def test_the_page_leads_to_the_report_of_every_set(alone, capsys):
    assert main(["report", str(alone), "--jobs", "1"]) == 0
    page = check_page(alone / "report.html")
    links = [a["href"] for a in page.all("a") if not a["href"].startswith("#")]
    assert sorted(links) == [f"sets/set{i}/report.html" for i in (0, 1)]
    assert "2 cannot be assessed" in page.source
    capsys.readouterr()
    assert main(["report", str(alone / "sets" / "set0"), "--jobs", "1"]) == 0


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::ResourceWarning")
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_killed_worker_changes_nothing_and_resume_goes_on_with_what_was_mended(
    alone, sets, tmp_path, capsys
):
    pytest.importorskip("distributed")
    from servoscope.cluster import on_cluster

    run = tmp_path / "run"
    command = ["assess", *sets, *OPTIONS, "--out", str(run)]
    with on_cluster(n_workers=2) as cluster:
        killed = threading.Thread(target=kill_one_that_works, args=(cluster.client,))
        killed.start()
        assert main(command) == 1
        killed.join(timeout=0)
        assert not killed.is_alive()
        assert "2 of 4 data sets could not be assessed" in capsys.readouterr().err
        assert figures(run) == figures(alone)

        mended = Path(sets[3])
        damage(mended)  # the same byte once more is as it was
        finished = (run / "sets" / "set0.json").stat().st_mtime_ns
        assert main([*command, "--resume"]) == 1
        damage(mended)
    assert [row["name"] for row in figures(run) if row["error"]] == ["nothing"]
    assert (run / "sets" / "set0.json").stat().st_mtime_ns == finished


def kill_one_that_works(client):
    """Kill a worker while it assesses a set."""
    pids = client.run(os.getpid)
    for _ in range(600):
        for worker, calls in client.processing().items():
            if calls and worker in pids:
                time.sleep(0.5)
                os.kill(pids[worker], signal.SIGKILL)
                return
        time.sleep(0.05)


@pytest.fixture
def assessed(monkeypatch):
    """The sets that were assessed, by their last two folders; all will do, and no time is taken."""
    names = []

    def assess_one(order, dataset):
        names.append("/".join(Path(dataset).parts[-2:]))
        row = {**failed_row(""), "state": "yes", "says": "It will do.", "error": None}
        row |= {"seconds": 1.0, "fingerprint": order.fingerprint(dataset)}
        return Assessed(row, {"report.html": dataset.encode()})

    monkeypatch.setattr(run_sets, "assess_one", assess_one)
    return names


@pytest.mark.filterwarnings("default::servoscope.errors.ServoscopeWarning")
def test_resume_assesses_sets_again_whose_images_have_changed_and_keeps_what_cannot_be_read(
    tmp_path, assessed, capsys
):
    sets = [tmp_path / "all" / name for name in ("kept", "changed", "lost")]
    for i, folder in enumerate(sets):
        planar_data_set(60, 16, seed=i).save(folder)
    command = ["assess", *map(str, sets), *OPTIONS, "--out", str(tmp_path / "run"), "--jobs", "1"]
    assert main(command) == 0
    assert assessed == ["all/kept", "all/changed", "all/lost"]
    shutil.rmtree(sets[1])
    shutil.rmtree(sets[2])
    planar_data_set(60, 16, seed=9).save(sets[1])
    for _ in range(2):
        assert main([*command, "--resume"]) == 0
        said = capsys.readouterr().err
        assert f"What was found before stays, but now: {sets[2]} is not a folder" in said
        assert assessed[3:] == ["all/changed"]


def test_resume_with_other_sets_keeps_names_and_what_is_no_longer_asked_for(
    tmp_path, assessed, capsys
):
    sets = {}
    for i, name in enumerate(("mon/cell", "tue/cell", "mon/shelf")):
        planar_data_set(60, 16, seed=i).save(tmp_path / name)
        sets[name] = str(tmp_path / name)
    run = tmp_path / "run"

    def names(*asked):
        options = [*OPTIONS, "--out", str(run), "--jobs", "1", "--resume"]
        assert main(["assess", *(sets[name] for name in asked), *options]) == 0
        rows = read_json(run / "summary.json")["sets"]
        for row in rows:
            assert (run / row["run"] / "report.html").read_text() == row["dataset"]
        return {row["dataset"].removeprefix(f"{tmp_path}/"): row["name"] for row in rows}

    assert names("mon/cell", "mon/shelf") == {"mon/cell": "cell", "mon/shelf": "shelf"}
    assert names("mon/cell", "tue/cell") == {"mon/cell": "cell", "tue/cell": "tue/cell"}
    assert names("tue/cell", "mon/shelf") == {"tue/cell": "tue/cell", "mon/shelf": "shelf"}
    assert names("tue/cell", "mon/shelf", "mon/cell").keys() == sets.keys()
    assert assessed == ["mon/cell", "mon/shelf", "tue/cell"]
    (run / "sets.json").write_text(json.dumps({"a": "../../etc", "b": "etc"}))
    options = [*OPTIONS, "--out", str(run), "--jobs", "1", "--resume"]
    assert main(["assess", sets["mon/cell"], sets["tue/cell"], *options]) == 1
    assert f"{run / 'sets.json'} is damaged" in capsys.readouterr().err


def fails_in_a_way_nobody_thought_of(order, dataset):
    raise ZeroDivisionError(Path(dataset).name)


def test_debug_shows_where_sets_have_failed(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(run_sets, "assess_one", fails_in_a_way_nobody_thought_of)
    command = ["assess", "one", "two", *OPTIONS, "--out", str(tmp_path / "run"), "--jobs", "1"]
    assert main(command) == 1
    row = read_json(tmp_path / "run" / "summary.json")["sets"][0]
    assert row["error"] == "unexpected ZeroDivisionError: one; --debug shows where it came from"
    message = (
        f"servoscope: 2 of 2 data sets could not be assessed, such as one; mend what "
        f"{tmp_path / 'run' / 'report.html'} says, and repeat the command with --resume.\n"
    )
    assert capsys.readouterr().err.endswith(message)
    assert main([*command, "--resume", "--debug"]) == 1
    shown = capsys.readouterr().err
    assert shown.count("in fails_in_a_way_nobody_thought_of") == 2
    assert shown.endswith(message)


def test_sets_of_one_name_are_told_apart_by_their_folders():
    sets = ["/mon/cell", "/tue/cell", "/wed/Cell", "s3://bucket/part 7", "/x/a b/c", "/x/a_b/c"]
    names = names_of(sets)
    assert list(names.values())[:4] == ["mon/cell", "tue/cell", "wed/Cell", "part 7"]
    folders = [folder_of(name) for name in names.values()]
    assert folders == ["mon_cell", "tue_cell", "wed_cell", "part_7", "x_a_b_c", "x_a_b_c-2"]
    assert names_of(["/y/mon_cell"], names)["/y/mon_cell"] == "y/mon_cell"  # mon_cell is taken
    assert names_of(sets[::-1], names) == names


def test_rows_come_with_the_worst_first_and_so_says_the_verdict():
    def row(name, state, ratio):
        said = {**failed_row("it is lost."), "error": None, "state": state, "name": name}
        return {**said, "run": None, "worst": {"dof": "tx", "ratio": ratio}}

    rows = [row("fine", "yes", 0.5), row("bad", "no", 2.0), row("worse", "no", None)]
    rows.append({**failed_row("it is lost."), "name": "lost", "run": None})
    ordered = worst_first(rows)
    assert [one["name"] for one in ordered] == ["lost", "worse", "bad", "fine"]
    verdict = sets_verdict(ordered)
    assert verdict.state == "no"
    assert "2 not accurate enough, 1 accurate enough, 1 cannot be" in verdict.answer
    assert "it is lost." in verdict.next_step
    assert "it is lost." in sets_table(ordered).to_markdown()
    assert sets_verdict([rows[0]]).state == "yes"
