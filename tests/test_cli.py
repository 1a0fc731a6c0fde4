"""The command line, as its users meet it."""

import io
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import cv2
import numpy as np
import pytest

from planar import planar_data_set
from servoscope.cli import main
from servoscope.data.images import PoseImageSet
from servoscope.storage.folders import LOCK, owned
from small_study import STUDY, __file__, make_small

ALONE = ("--jobs", "1")
LONG = 120
"""After so many seconds a command hangs."""


def start(*arguments: str, **options) -> subprocess.Popen:
    command = [sys.executable, __file__, *arguments]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen(command, start_new_session=True, **pipes, **options)


def start_study(run: Path, finished: Path, moment: str, *options: str) -> subprocess.Popen:
    """Begin the study; with the images of another one where it is to be stopped after those."""
    if moment == "dataset/acquisition.json":
        return start(*STUDY, *options, "--out", str(run))
    for part in ("config.json", "stages/acquire.json"):
        (run / part).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(finished / part, run / part)
    shutil.copytree(finished / "dataset", run / "dataset")
    return start(*STUDY, *options, "--out", str(run), "--resume")


def wait_for(path: Path, process: subprocess.Popen) -> None:
    """Return once `path` exists; fail if the process ends first."""
    deadline = time.monotonic() + LONG
    while not path.exists():
        assert process.poll() is None, f"ended without {path.name}: {process.communicate()}"
        assert time.monotonic() < deadline, f"no {path.name} after {LONG} s"
        time.sleep(0.002)


def kill(process: subprocess.Popen) -> None:
    """Kill it with all that it started."""
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate(timeout=LONG)


def interrupt(process: subprocess.Popen) -> str:
    """Press Ctrl-C, and again if that fell into the moment in which processes are started."""
    for _ in range(15):
        os.killpg(process.pid, signal.SIGINT)
        try:
            return process.communicate(timeout=2)[1]
        except subprocess.TimeoutExpired:
            continue
    kill(process)
    pytest.fail("interrupts did not end it")


def results(run: Path) -> dict:
    """The summary without what a clock says."""
    summary = json.loads((run / "summary.json").read_text())
    del summary["timings_s"]
    return summary


@pytest.fixture(scope="module", autouse=True)
def _small():
    with pytest.MonkeyPatch.context() as patch:
        make_small(patch.setattr)
        yield


@pytest.fixture(scope="module")
def printed(tmp_path_factory) -> tuple[Path, str, str]:
    """The run folder of an undisturbed small study, and what was printed of it."""
    run = tmp_path_factory.mktemp("cli") / "run"
    with redirect_stdout(io.StringIO()) as out, redirect_stderr(io.StringIO()) as err:
        assert main([*STUDY, *ALONE, "--out", str(run)]) == 0
    return run, out.getvalue(), err.getvalue()


@pytest.fixture(scope="module")
def finished(printed) -> Path:
    """The run folder alone."""
    return printed[0]


@pytest.mark.slow
def test_study_makes_a_report_and_says_where_it_is(printed):
    run, out, err = printed
    assert str(run / "report.html") in out
    assert "Honest protocol, displacement about the pivot" in out
    assert "Traceback" not in err
    assert "</html>" in (run / "report.html").read_text()


def test_study_prints_its_summary_as_json(finished, capsys):
    assert main([*STUDY, *ALONE, "--out", str(finished), "--resume", "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["protocols"].keys() == {"honest"}
    assert {"acquire", "features", "assessment", "report", "total"} <= summary["timings_s"].keys()
    assert summary["timings_s"]["total"] > 0


def write_page(run: Path, **_: object) -> None:
    """What a test of something else needs of a report."""
    (run / "report.html").write_text("</html>")


@pytest.mark.slow
@pytest.mark.parametrize("moment", ["dataset/acquisition.json", "models"])
def test_a_killed_study_resumes_to_the_same_summary(finished, tmp_path, monkeypatch, moment):
    run = tmp_path / "run"
    process = start_study(run, finished, moment, *ALONE)
    wait_for(run / moment, process)
    kill(process)
    assert not (run / "report.html").exists()
    monkeypatch.setattr("servoscope.commands.run_study.write_report", write_page)
    assert main([*STUDY, *ALONE, "--out", str(run), "--resume"]) == 0
    assert results(run) == results(finished)


@pytest.mark.slow
@pytest.mark.parametrize("moment", ["dataset/acquisition.json", "summary.json"])
def test_an_interrupted_study_says_so_in_one_line_and_can_be_resumed(
    finished, tmp_path, monkeypatch, moment
):
    run = tmp_path / "run"
    process = start_study(run, finished, moment)
    wait_for(run / moment, process)
    time.sleep(0.3)
    err = interrupt(process)
    assert process.returncode == 130
    assert "Traceback" not in err
    assert err.strip().splitlines()[-1].startswith("servoscope: interrupted")
    monkeypatch.setattr("servoscope.commands.run_study.write_report", write_page)
    assert main([*STUDY, *ALONE, "--out", str(run), "--resume"]) == 0
    assert results(run) == results(finished)


def test_report_needs_the_run_folder_only(finished, tmp_path, capsys):
    moved = tmp_path / "moved"
    shutil.copytree(finished, moved, ignore=shutil.ignore_patterns("dataset", "report.html"))
    assert main(["report", str(moved), *ALONE, "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"report": str(moved / "report.html")}
    assert (moved / "report.html").exists()


def test_info_describes_installations_data_sets_and_runs(finished, capsys):
    assert main(["info", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["cores"] == os.cpu_count()
    assert main(["info", str(finished / "dataset"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["size_px"] == [24, 24]
    assert main(["info", str(finished), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["finished"] is True


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["assess", "nowhere"], "nowhere is not a folder"),
        (["info", "nowhere"], "nowhere is not a folder"),
        (["report", "nowhere"], "nowhere is not a run folder"),
        (["import", "folder", "nowhere", "out"], "nowhere does not exist"),
        (["import", "tum", "nowhere", "out"], "nowhere does not exist"),
        (["study", "--n-images", "20"], "at least 144 images"),
        (["study", "--seed", "-1"], "seed must"),
        (["study", "--jobs", "0"], "--jobs must be at least 1"),
        (["study", "--image-size", "3"], "image_size must"),
        (["study", "--image-size", "0"], "image_size must"),
        (["study", "--cells", "2", "--image-size", "0"], "image_size must"),
        (["acquire", "out", "--n-images", "0"], "n_images must"),
    ],
)
def test_bad_requests_end_with_one_line_and_leave_nothing(
    arguments, message, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("servoscope: ")
    assert message in err
    assert len(err.splitlines()) == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("arguments", [["study", "--bins"], ["assess"], ["fly"]])
def test_wrong_usage_exits_with_2(arguments, capsys):
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 2
    assert capsys.readouterr().out == ""


def test_debug_shows_where_an_error_came_from(capsys):
    assert main(["info", "nowhere", "--debug"]) == 1
    assert "Traceback" in capsys.readouterr().err


def test_called_from_python_it_leaves_ctrl_c_as_it_was(monkeypatch, capsys):
    def interrupted():
        raise KeyboardInterrupt

    monkeypatch.setattr("servoscope.commands.info.describe_installation", interrupted)
    before = signal.getsignal(signal.SIGINT)
    assert main(["info"]) == 130
    assert signal.getsignal(signal.SIGINT) is before
    assert capsys.readouterr().err.startswith("servoscope: interrupted")


def test_a_command_that_is_ended_while_it_imports_imports_nothing_more():
    program = (
        "import sys, servoscope.cli as cli, servoscope.commands.info as info\n"
        "class Interrupted:\n"
        "    def find_spec(self, name, *_):\n"
        "        if name == 'numpy':\n"
        "            sys.modules['numpy'] = None  # what is left of it can be imported no more\n"
        "            raise KeyboardInterrupt\n"
        "sys.meta_path.insert(0, Interrupted())\n"
        "sys.argv[1:] = ['info', 'x']\n"
        "sys.exit(cli.main())"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    said = "servoscope: interrupted; what is finished is kept\n"
    assert (done.returncode, done.stdout, done.stderr) == (130, "", said)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
@pytest.mark.parametrize("moment", ["a result is taken", "a call is handed out"])
def test_a_command_that_is_ended_while_processes_share_arrays_says_one_line(number, moment):
    program = (
        "import os, sys, time, numpy as np\n"
        "import servoscope.cli as cli, servoscope.commands.info as info\n"
        "from servoscope.processes import in_processes\n"
        f"end = lambda moment: moment == {moment!r} and os.kill(os.getpid(), {int(number)})\n"
        "def calls():\n"
        "    for i in range(9):\n"
        "        i == 5 and end('a call is handed out')\n"
        "        yield (np.full(300_000, float(i)),)\n"
        "def ended():\n"
        "    for _ in in_processes(np.sum, calls(), 2):\n"
        "        end('a result is taken')\n"
        "        time.sleep(0.2)\n"
        "info.describe_installation = ended\n"
        "sys.argv[1:] = ['info']\n"
        "sys.exit(cli.main())"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=LONG
    )
    said = "servoscope: interrupted; what is finished is kept\n"
    assert (done.returncode, done.stdout, done.stderr) == (130, "", said)


def test_the_command_line_starts_without_what_only_some_commands_need():
    code = (
        "import sys; from servoscope.commands.catalogue import _app; _app((), whole=True); "
        "print(sorted({'numba', 'sklearn', 'manifold3d', 'matplotlib'} & set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=LONG
    )
    assert done.stdout.strip() == "[]"


def test_version(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("servoscope ")


def test_a_run_is_not_overwritten_without_force(finished, capsys):
    before = results(finished)
    assert main([*STUDY, *ALONE, "--out", str(finished)]) == 1
    assert "--resume" in capsys.readouterr().err
    assert results(finished) == before


def test_a_damaged_image_stack_is_named(tmp_path, capsys):
    planar_data_set(60, 16).save(tmp_path / "data")
    stack = tmp_path / "data" / "images.zarr"
    chunk = next(p for p in stack.rglob("*") if p.is_file() and p.name != "zarr.json")
    chunk.write_bytes(chunk.read_bytes()[:40])
    assert main(["assess", str(tmp_path / "data"), "--out", str(tmp_path / "run")]) == 1
    err = capsys.readouterr().err
    assert "images.zarr" in err
    assert "Traceback" not in err


def full(*_: object, **__: object) -> None:
    raise OSError(28, "No space left on device", "features.npz")


def test_a_full_disk_is_said_in_one_line(finished, tmp_path, monkeypatch, capsys):
    shutil.copytree(finished, tmp_path / "run")
    (tmp_path / "run" / "features.npz").unlink()
    monkeypatch.setattr("servoscope.study.run.write_arrays", full)
    assert main([*STUDY, *ALONE, "--out", str(tmp_path / "run"), "--resume"]) == 1
    last = capsys.readouterr().err.splitlines()[-1]
    assert last.startswith("servoscope: features.npz: No space left on device; free some")


def of_folder(folder: Path) -> dict[str, bytes]:
    """What the files of a folder hold, but for hidden ones at its top."""
    shown = [path for path in folder.iterdir() if not path.name.startswith(".")]
    files = [file for path in shown for file in (path, *path.rglob("*")) if file.is_file()]
    return {str(file.relative_to(folder)): file.read_bytes() for file in files}


def test_a_full_disk_costs_nothing_of_a_run_that_is_replaced(
    finished, tmp_path, monkeypatch, capsys
):
    run = tmp_path / "run"
    shutil.copytree(finished, run)
    monkeypatch.setattr("servoscope.data.folder.write_images", full)
    assert main([*STUDY, *ALONE, "--out", str(run), "--force"]) == 1
    assert "No space left on device" in capsys.readouterr().err
    assert of_folder(run) == of_folder(finished)


def test_a_full_disk_costs_nothing_of_a_set_that_an_import_replaces(tmp_path, monkeypatch, capsys):
    planar_data_set(12, 24).save(tmp_path / "data")
    before = of_folder(tmp_path / "data")
    (tmp_path / "source").mkdir()
    for k, name in enumerate(("a.png", "b.png")):
        cv2.imwrite(str(tmp_path / "source" / name), 200 * np.eye(24, k=k, dtype=np.uint8))
    poses = "name,tx,ty,tz,qx,qy,qz,qw\na.png,0,0,0,0,0,0,1\nb.png,0,0,1,0,0,0,1\n"
    (tmp_path / "source" / "poses.csv").write_text(poses)
    command = ["import", "folder", str(tmp_path / "source"), str(tmp_path / "data"), "--force"]
    with monkeypatch.context() as patch:
        patch.setattr("servoscope.data.folder.write_text", full)
        assert main(command) == 1
    assert "No space left on device" in capsys.readouterr().err
    assert of_folder(tmp_path / "data") == before
    assert main(command) == 0
    assert len(PoseImageSet.load(tmp_path / "data")) == 2
    assert not list((tmp_path / "data").glob(".*"))


@pytest.mark.slow
def test_a_killed_replacement_leaves_the_old_set_and_goes_on(tmp_path):
    data = tmp_path / "data"
    planar_data_set(12, 24).save(data)
    before = of_folder(data)
    command = ["acquire", str(data), "--n-images", "300", "--image-size", "16", "--force"]
    command += ["--part", "textured_plane", "--jobs", "1"]
    process = start(*command)
    wait_for(data / ".servoscope-new" / "images.zarr" / "c", process)
    kill(process)
    assert of_folder(data) == before
    assert main(command) == 0
    assert len(PoseImageSet.load(data)) == 300
    assert not list(data.glob(".*"))


@pytest.mark.slow
def test_a_killed_process_is_one_line_and_the_command_goes_on(tmp_path):
    """Images so small that a message is sent at once: half of one would leave all waiting."""
    data = tmp_path / "data"
    command = ["acquire", str(data), "--n-images", "2000", "--image-size", "40"]
    command += ["--part", "textured_plane"]
    process = start(*command, "--jobs", "2")
    wait_for(data / "images.zarr" / "c", process)
    listed = subprocess.run(
        ["ps", "-ww", "-eo", "pid=,ppid=,args="], capture_output=True, text=True, timeout=LONG
    )
    rows = [line.split(maxsplit=2) for line in listed.stdout.splitlines()]
    workers = [
        int(pid)
        for pid, parent, what in rows
        if int(parent) == process.pid and "popen_loky" in what
    ]
    os.kill(workers[0], signal.SIGKILL)
    try:
        err = process.communicate(timeout=LONG)[1]
    except subprocess.TimeoutExpired:
        kill(process)
        raise
    assert process.returncode == 1
    assert "Traceback" not in err
    assert err.splitlines()[-1].startswith("servoscope: A process was killed, most likely")
    assert json.loads((data / "acquisition.json").read_text())["n_done"] >= 25
    assert main([*command, *ALONE]) == 0
    assert len(PoseImageSet.load(data)) == 2000


@pytest.mark.parametrize(
    "command",
    [
        ["acquire", "OUT"],
        ["acquire", "OUT", "--force"],
        ["import", "folder", "SOURCE", "OUT"],
        ["import", "tum", "SOURCE", "OUT", "--force"],
        ["study", "--out", "OUT"],
        ["study", "--out", "OUT", "--resume"],
        ["assess", "DATA", "--out", "OUT"],
        ["sensitivity", "--out", "OUT", "--force"],
        ["benchmark", "positioning", "--out", "OUT"],
    ],
    ids=" ".join,
)
def test_a_folder_that_a_command_writes_is_refused_to_a_second_one(command, tmp_path, capsys):
    if "DATA" in command:
        planar_data_set(60, 24).save(tmp_path / "DATA")
    asked = [str(tmp_path / word) if word.isupper() else word for word in command]
    with owned(tmp_path / "OUT"):
        assert main(asked) == 1
        assert [path.name for path in (tmp_path / "OUT").iterdir()] == [LOCK]
    (line,) = capsys.readouterr().err.splitlines()
    assert "OUT is being written by another command" in line


def test_training_is_refused_before_it_begins_where_another_writes(tmp_path, capsys):
    with owned(tmp_path / "model", beside=True):
        assert main(["train", "nowhere", "--out", str(tmp_path / "model")]) == 1
    assert "model is being written by another command" in capsys.readouterr().err


def test_a_report_is_refused_while_its_run_is_written(finished, capsys):
    with owned(finished):
        assert main(["report", str(finished)]) == 1
    assert "is being written by another command" in capsys.readouterr().err


def test_a_data_set_is_not_assessed_into_a_folder_that_holds_it(finished, capsys):
    dataset = finished / "dataset"
    for out in (dataset, finished):
        assert main(["assess", str(dataset), "--out", str(out), "--force"]) == 1
        assert "is or holds the data set" in capsys.readouterr().err
    assert (dataset / "meta.json").exists()
    assert (finished / "summary.json").exists()


def test_import_only_reads_its_source(tmp_path, capsys):
    (tmp_path / "poses.csv").write_text("name,tx,ty,tz,qx,qy,qz,qw\na.png,1,0,0,0,0,0,1\n")
    before = (tmp_path / "poses.csv").read_bytes()
    for force in ([], ["--force"]):
        assert main(["import", "folder", str(tmp_path), str(tmp_path), *force]) == 1
        assert "holds a poses.csv" in capsys.readouterr().err
    assert main(["acquire", str(tmp_path), "--n-images", "1", "--image-size", "16"]) == 1
    assert (tmp_path / "poses.csv").read_bytes() == before


def test_too_few_images_are_refused_before_a_run_is_made(tmp_path, capsys):
    planar_data_set(19, 24).save(tmp_path / "data")
    assert main(["assess", str(tmp_path / "data"), "--out", str(tmp_path / "run")]) == 1
    assert "at least 20 images" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_a_report_that_is_gone_is_made_again_and_brackets_of_its_path_are_shown(
    finished, tmp_path, monkeypatch, capsys
):
    run = tmp_path / "run[/bold]"
    monkeypatch.setattr("servoscope.commands.run_study.write_report", write_page)
    shutil.copytree(finished, run, ignore=shutil.ignore_patterns("report.html"))
    assert main([*STUDY, *ALONE, "--out", str(run), "--resume"]) == 0
    assert (run / "report.html").exists()
    assert str(run / "report.html") in capsys.readouterr().out


def test_a_folder_that_cannot_be_made_is_named(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    planar_data_set(60, 16).save(tmp_path / "data")
    out = tmp_path / "file" / "run"
    assert main(["assess", str(tmp_path / "data"), "--out", str(out)]) == 1
    err = capsys.readouterr().err
    assert str(out) in err
    assert len(err.splitlines()) == 1
