"""A study as a job array: the script, what its tasks do, and a real Slurm that runs it through kills and requeues."""

import getpass
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import tempfile
import time
from pathlib import Path

import pytest
from toy_lab import APP, ROOT, arrays, labbook, study_file
from typer.testing import CliRunner

from labbook.lab import Catalogue, LabFolder
from labbook.run.slurm import seconds

FOLDERS = os.pathsep.join(map(str, (ROOT, ROOT / "backends", ROOT / "tests/toy")))


def files(lab):
    """The bits of all runs and packings of a lab."""
    return {f"{kind}/{one.name}": arrays(one) for kind in ("runs", "packings") for one in (lab / kind).iterdir()}


def script(path, lab, *words):
    """What `labbook slurm` prints."""
    return labbook("slurm", path, "--lab", lab, "--backend", "toy", *words).stdout


def begin(text, task, **environment):
    """A task of a script, as Slurm begins it: in a batch shell of its own."""
    given = {**os.environ, "PYTHONPATH": FOLDERS, "SLURM_ARRAY_TASK_ID": str(task), "SLURM_ARRAY_JOB_ID": "7"}
    process = subprocess.Popen(
        ["bash", "-s"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        env={**given, **environment}, start_new_session=True,
    )  # fmt: skip
    assert process.stdin is not None
    process.stdin.write(text)
    process.stdin.close()
    process.stdin = None
    return process


def ended(process):
    """Exit status and output of a task."""
    out, _ = process.communicate(timeout=120)
    return process.returncode, out


def argument(line):
    """The option in a line of sbatch, as its own parser has it (`_get_argument` in src/sbatch/opt.c)."""
    found, mark, escaped = "", "", False
    for one in line.removeprefix("#SBATCH").lstrip():
        if escaped:
            found, escaped = found + one, False
        elif one == "\\":
            escaped = True
        elif mark:
            mark, found = ("", found) if one == mark else (mark, found + one)
        elif one in "\"'":
            mark = one
        elif one.isspace() or one == "#":
            break
        else:
            found += one
    assert not mark
    return found


FOLDERS_OF_LABS = ("a b", "50%", "%a", "%%j", "it's", 'a "b"', "#1", "größe", "$HOME", "`id`", "a\tb", "(x) & y; z")


@pytest.mark.parametrize("name", FOLDERS_OF_LABS)
def test_logs_lie_beside_the_parts_whatever_their_folder_is_called(tmp_path, name):
    text = script(study_file(tmp_path), tmp_path / name / "lab", "--tasks", 2, "--time", "1:00:00")
    (line,) = [line for line in text.splitlines() if "--output=" in line]
    option, _, pattern = argument(line).partition("=")
    assert option == "--output"
    assert "\\" not in pattern, "it would switch patterns off"
    log = re.sub("%(.)", lambda found: {"%": "%", "a": "1"}[found[1]], pattern)
    assert log == str(tmp_path / name / "lab-parts/toy-study-1-of-2.log")
    checked = subprocess.run(["bash", "-n"], input=text, capture_output=True, text=True, check=False)
    assert (checked.returncode, checked.stderr) == (0, "")


@pytest.mark.parametrize("name", ["a\nb", "a\rb", "a\\b"])
def test_a_folder_that_no_line_of_sbatch_can_have_is_refused(tmp_path, name):
    words = ("slurm", study_file(tmp_path), "--lab", tmp_path / name / "lab", "--tasks", 2, "--time", "1:00:00")
    ended = labbook(*words, "--backend", "toy", check=False)
    assert ended.exit_code == 1
    assert "which sbatch cannot read; give another folder with --labs" in ended.output
    assert "#!/bin/bash" not in ended.output


@pytest.mark.parametrize(
    ("text", "expected"),
    [("90", 5400), ("1:30", 90), ("04:00:00", 14400), ("2-0", 172800), ("1-2:30", 95400), ("1-2:30:05", 95405)],
)
def test_times_are_read_as_slurm_writes_them(text, expected):
    assert seconds(text) == expected


@pytest.mark.parametrize("text", ["4h", "", "1:2:3:4", "-5"])
def test_other_times_are_refused(text):
    with pytest.raises(ValueError, match="write HH:MM:SS"):
        seconds(text)


def test_a_script_asks_slurm_for_what_it_was_told(tmp_path):
    site = tmp_path / "site.sh"
    site.write_text("#!/bin/bash\n#SBATCH --constraint=a100\nmodule load cuda\n")
    given = ("--tasks", 3, "--time", "1-00:00:00", "--gpus", 2, "--cpus", 8, "--site", site)
    text = script(study_file(tmp_path), tmp_path / "lab", *given, "--", "--partition=big", "--account=me")
    head, _, body = text.partition("\n\n")
    wanted = "array=1-3 time=1-00:00:00 signal=B:TERM@120 requeue open-mode=append gpus=2 cpus-per-task=8"
    wanted += " partition=big account=me constraint=a100"
    assert {f"#SBATCH --{one}" for one in wanted.split()} < set(head.splitlines())
    assert head.startswith("#!/bin/bash\n")
    assert all(line.startswith("#") for line in head.splitlines()), "Slurm reads no option below a command"
    assert "\nmodule load cuda\n" in body
    assert "--device cuda:all" in body
    assert subprocess.run(["bash", "-n"], input=text, text=True, check=False).returncode == 0


@pytest.mark.parametrize(
    ("given", "problem"),
    [
        (("--tasks", 20000), "--tasks: 20000 is not between 1 and 10000"),
        (("--time", "3:00"), "too short"),
        (("--time", "soon"), "is not a time"),
    ],
)
def test_what_cannot_be_is_refused(given, problem, tmp_path):
    words = ("slurm", study_file(tmp_path), "--backend", "toy", "--lab", tmp_path / "lab", *given)
    result = labbook(*words, check=False)
    assert result.exit_code == 1
    assert problem in result.output
    assert not list(tmp_path.glob("lab*"))


@pytest.mark.ring
@pytest.mark.slow
def test_tasks_and_the_import_make_the_whole_and_go_on_in_a_longer_study(tmp_path):
    path, lab = study_file(tmp_path, replicates=3), tmp_path / "lab"
    labbook("run", path, "--lab", lab, "--backend", "toy")
    before = {one.name: one.stat().st_mtime_ns for one in (lab / "runs").iterdir()}
    path = study_file(tmp_path, replicates=5, orifices="[18, 21, 24]")
    text = script(path, lab, "--tasks", 2)
    for task in (1, 2):
        status, out = ended(begin(text, task))
        assert status == 0, out
    parts = [tmp_path / f"lab-parts/toy-study-{task}-of-2" for task in (1, 2)]
    made = [{one.name for one in (part / "runs").iterdir()} for part in parts]
    assert sum(map(len, made)) == 15 - 6, "runs that the lab has are not made again"
    kept = {one.name for one in (lab / "packings").iterdir()}
    taken = [one for part in parts for one in (part / "packings").iterdir() if one.name in kept]
    assert len(taken) == 3, "packings are taken from there"
    assert all(arrays(one) == arrays(lab / "packings" / one.name) for one in taken)
    status, out = ended(begin(text, 0))
    assert status == 0, out
    assert "15 done" in out
    assert {one.name: one.stat().st_mtime_ns for one in (lab / "runs").iterdir()}.items() >= before.items()
    labbook("run", path, "--lab", tmp_path / "whole", "--backend", "toy")
    assert files(lab) == files(tmp_path / "whole")


@pytest.mark.parametrize(
    ("words", "lacking", "said"),
    [
        (("slurm",), "labbook.cli.cluster.shutil.which", "sbatch is not installed here"),
        (("ssh", "here", "there"), "labbook.cli.cluster.find_spec", "pip install asyncssh"),
    ],
)
def test_a_cluster_says_what_is_not_installed(monkeypatch, words, lacking, said):
    monkeypatch.setattr(lacking, lambda _: None)
    ended = CliRunner().invoke(APP, ["cluster", *words])
    assert ended.exit_code == 1
    assert said in ended.output


@pytest.mark.ring
@pytest.mark.slow
def test_runs_that_the_lab_has_shorter_go_on_there(tmp_path):
    lab = tmp_path / "lab"
    short = study_file(tmp_path, "stop: {discharged: 65 %}", replicates=2)
    labbook("run", short, "--lab", lab, "--backend", "toy")
    path = study_file(tmp_path, "stop: {discharged: 90 %}", replicates=2)
    ended = labbook("run", path, "--lab", tmp_path / "part", "--backend", "toy", "--base", lab)
    assert "4 continued from a checkpoint" in ended.stdout
    assert "0 packings" in ended.stdout
    again = labbook("run", path, "--lab", tmp_path / "other", "--backend", "toy", "--base", tmp_path / "part")
    assert "unreadable" not in again.output.lower(), "runs that are in the base only are not of this lab"
    assert not Catalogue(LabFolder(tmp_path / "other")).counts()


@pytest.mark.ring
@pytest.mark.slow
def test_replicates_are_added_round_by_round(tmp_path):
    path, lab = study_file(tmp_path, "accuracy: {flow_rate: 2 %, max_replicates: 6}", replicates=2), tmp_path / "lab"
    for _ in range(6):
        parts = [tmp_path / name for name in ("one", "two")]
        for number, part in enumerate(parts, 1):
            words = ("--lab", part, "--backend", "toy", "--no-pilot", "--shard", f"{number}/2", "--base", lab)
            labbook("run", path, *words)
        labbook("import", *parts, "--lab", lab)
    labbook("run", path, "--lab", tmp_path / "whole", "--backend", "toy", "--no-pilot")
    assert files(lab) == files(tmp_path / "whole")
    assert len(list((lab / "runs").iterdir())) > 4


def test_a_task_refuses_another_study_or_version_than_the_script_was_written_for(tmp_path):
    path = study_file(tmp_path)
    text = script(path, tmp_path / "lab")
    (stated,) = re.findall(r"--expect (\S+)", text)
    words = ("run", path, "--lab", tmp_path / "part", "--backend", "toy", "--expect", stated)
    result = labbook(*words, check=False, LABBOOK_TOY_VERSION="2")
    assert "toy-1 is now toy-2 since the script was written: write the script again with labbook slurm" in result.output
    path.write_text(path.read_text().replace("0.5", "0.6"))
    result = labbook(*words, check=False)
    assert re.search(r"study-\w+ is now study-\w+ since", result.output)
    assert not (tmp_path / "part").exists()


@pytest.mark.ring
@pytest.mark.slow
@pytest.mark.parametrize("all_of_it", [False, True])
def test_a_task_that_is_asked_to_stop_saves_and_the_next_one_goes_on(all_of_it, tmp_path):
    """At the end of its time Slurm asks the batch shell alone; when a job is put back, each of its processes, so that
    labbook is asked twice."""
    path, lab = study_file(tmp_path, replicates=1, orifices="[18]"), tmp_path / "lab"
    text = script(path, lab, "--tasks", 1)
    process = begin(text, 1, LABBOOK_TOY_DELAY="0.1")
    end = time.monotonic() + 60
    while not list((tmp_path / "lab-parts").glob("*/packings/*/packing.npz")):
        assert time.monotonic() < end
        assert process.poll() is None, process.communicate()
        time.sleep(0.05)
    time.sleep(0.5)
    os.killpg(process.pid, signal.SIGTERM) if all_of_it else process.send_signal(signal.SIGTERM)
    status, out = ended(process)
    assert status == 130, out
    assert "everything is saved" in out
    status, out = ended(begin(text, 1))
    assert status == 0, out
    assert "1 continued from a checkpoint" in out


@pytest.mark.ring
@pytest.mark.slow
def test_a_task_whose_time_is_over_goes_back_into_the_queue_and_a_cancelled_one_does_not(tmp_path):
    """With a `scontrol` that writes down what it is asked."""
    asked = tmp_path / "asked"
    (tmp_path / "bin").mkdir()
    fake = tmp_path / "bin/scontrol"
    fake.write_text(f'#!/bin/bash\necho "$@" >> {asked}\n')
    fake.chmod(0o755)
    path = study_file(tmp_path, replicates=1, orifices="[18]")
    text = script(path, tmp_path / "lab", "--tasks", 1, "--time", "00:10:00").replace("sleep 60", "sleep 0")
    for begun, requeued in ((0, ""), (430, "requeue 7_1\n")):
        process = begin(
            f"SECONDS={begun}\n{text}", 1, LABBOOK_TOY_DELAY="0.3", PATH=f"{fake.parent}:{os.environ['PATH']}"
        )
        end = time.monotonic() + 60
        while not list((tmp_path / "lab-parts").glob("*/live/*.json")):
            assert time.monotonic() < end
            time.sleep(0.05)
        process.send_signal(signal.SIGTERM)
        status, out = ended(process)
        assert status == 130, out
        assert (asked.read_text() if asked.exists() else "") == requeued


CONFIGURATION = """
ClusterName=toy
SlurmctldHost={host}(127.0.0.1)
CommunicationParameters=NoCtldInAddrAny,NoInAddrAny
SlurmUser={user}
SlurmdUser={user}
AuthType=auth/munge
AuthInfo=socket={folder}/munge/socket
CredType=cred/munge
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool/%n
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/%n.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/%n.log
SlurmctldPort={port}
ProctrackType=proctrack/pgid
TaskPlugin=task/none
SwitchType=switch/none
MpiDefault=none
ReturnToService=2
SchedulerParameters=sched_interval=1,bf_interval=1,batch_sched_delay=0
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
SlurmdParameters=config_overrides
NodeName=n[1-2] NodeHostname={host} NodeAddr=127.0.0.1 Port=[{first}-{last}] CPUs=1 RealMemory=1000 State=UNKNOWN
PartitionName=all Nodes=n[1-2] Default=YES MaxTime=INFINITE State=UP
"""
"""Two nodes that are this machine, which listen to itself alone."""


@pytest.fixture
def slurm(monkeypatch):
    """A Slurm of its own; the environment leads to it."""
    missing = [name for name in ("munged", "slurmctld", "slurmd", "sbatch") if shutil.which(name, path=_path()) is None]
    if missing:
        pytest.skip(f"{', '.join(missing)} not installed (Debian: apt-get install slurm-wlm munge)")
    if os.geteuid() != 0:
        pytest.skip("slurmd has to be started as root")
    folder = Path(tempfile.mkdtemp(prefix="labbook-"))  # short: paths of sockets have at most 108 characters
    folder.chmod(0o755)
    for name in ("munge", "state", "spool"):
        (folder / name).mkdir(parents=True)
    (folder / "munge").chmod(0o711)
    ports = _ports(3)
    assert ports[2] == ports[1] + 1
    told = {"host": socket.gethostname().partition(".")[0], "folder": folder, "user": getpass.getuser()}
    (folder / "slurm.conf").write_text(CONFIGURATION.format(**told, port=ports[0], first=ports[1], last=ports[2]))
    key = folder / "munge/key"
    key.write_bytes(os.urandom(128))
    key.chmod(0o600)
    monkeypatch.setenv("SLURM_CONF", str(folder / "slurm.conf"))
    monkeypatch.setenv("PATH", _path())
    names = {"key-file": "key", "socket": "socket", "pid-file": "pid", "log-file": "log", "seed-file": "seed"}
    subprocess.run(
        ["munged", "--force", *(f"--{one}={folder}/munge/{name}" for one, name in names.items())], check=True
    )
    subprocess.run(["slurmctld", "-c"], check=True)
    for node in ("n1", "n2"):
        subprocess.run(["slurmd", "-N", node], check=True)
    yield folder
    subprocess.run(["scancel", "--user", getpass.getuser()], check=False)
    for name in ("n1.pid", "n2.pid", "slurmctld.pid", "munge/pid"):
        try:
            os.kill(int((folder / name).read_text()), signal.SIGTERM)
        except (FileNotFoundError, ProcessLookupError):
            continue
    time.sleep(1)
    shutil.rmtree(folder, ignore_errors=True)


def _path():
    return f"{os.environ['PATH']}{os.pathsep}/usr/sbin"


def _ports(many):
    """Free ports, one after another."""
    for first in range(27800 + os.getpid() % 1000, 32000, many):
        taken = []
        try:
            for port in range(first, first + many):
                taken.append(socket.create_server(("127.0.0.1", port)))
        except OSError:
            continue
        finally:
            for one in taken:
                one.close()
        return list(range(first, first + many))
    raise AssertionError("no free ports")


def _wait(there, seconds, what):
    end = time.monotonic() + seconds
    while not (found := there()):
        assert time.monotonic() < end, what()
        time.sleep(0.3)
    return found


@pytest.mark.ring
@pytest.mark.ring
@pytest.mark.slow
def test_a_real_slurm_runs_an_array_to_its_end_through_a_kill_and_a_requeue(tmp_path, slurm, monkeypatch):
    """Task 1 is killed without warning, as by a node that is lost, and put back; task 2 is put back while it works,
    as by somebody with more right to the node."""
    monkeypatch.setenv("PYTHONPATH", FOLDERS)
    monkeypatch.setenv("LABBOOK_TOY_DELAY", "0.05")
    path, lab = study_file(tmp_path, replicates=2), tmp_path / "lab"
    site = tmp_path / "site.sh"
    site.write_text("export LABBOOK_CHECKED=1\n")
    out = labbook(
        "slurm", path, "--lab", lab, "--backend", "toy", "--tasks", 2, "--site", site, "--submit", "--", "--nodes=1"
    ).stdout
    found = re.search(r"Job (\d+): 2 tasks; job (\d+) imports", out)
    assert found, out
    job, after = found.groups()
    parts = [tmp_path / f"lab-parts/toy-study-{task}-of-2" for task in (1, 2)]

    def told():
        logs = [one.read_text() for one in sorted(tmp_path.glob("lab-parts/*.log"))]
        queue = subprocess.run(["squeue", "-a"], capture_output=True, text=True, check=False).stdout
        return "\n".join([*logs, queue, (slurm / "slurmctld.log").read_text()[-3000:]])

    def at_work(part):
        return list(part.glob("live/*.json")) and list(part.glob("packings/*/packing.npz"))

    for part in parts:
        _wait(lambda part=part: at_work(part), 120, told)
    (live,) = parts[0].glob("live/*.json")
    os.kill(json.loads(live.read_text())["pid"], signal.SIGKILL)
    subprocess.run(["scontrol", "requeue", f"{job}_1"], check=False)
    subprocess.run(["scontrol", "requeue", f"{job}_2"], check=True)

    def over():
        left = subprocess.run(["squeue", "-h", "-j", f"{job},{after}"], capture_output=True, text=True, check=False)
        return left.returncode != 0 or not left.stdout.strip()

    _wait(over, 420, told)
    assert "4 done" in (tmp_path / "lab-parts/toy-study-0-of-2.log").read_text(), told()
    assert "continued from a checkpoint" in parts[1].with_suffix(".log").read_text(), "task 2 was asked, and saved"
    monkeypatch.setenv("LABBOOK_TOY_DELAY", "0")
    labbook("run", path, "--lab", tmp_path / "whole", "--backend", "toy")
    assert files(lab) == files(tmp_path / "whole")
    assert LabFolder(lab).working() == []
