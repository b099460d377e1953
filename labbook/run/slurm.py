"""A study as a job array of Slurm: each task runs a part in a lab of its own, and task 0 imports the parts.

Tasks share only the file system: no database, no lock, no server. A task is asked to stop before its time limit, saves
its jobs, and is requeued. A task whose node is lost continues from its last checkpoint.
"""

import hashlib
import re
import shlex
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from labbook.backend import Capabilities
from labbook.study import Study
from labbook.version import __version__

WARNING_TIME = 120
"""Time before the limit at which a task is asked to stop [s]."""
MAX_TASKS = 10_000
_SIGNAL_RESOLUTION = 60  # s that Slurm may be early
_MAX_REQUEUES = 100
"""Maximum number of times that a task is requeued at its time limit."""
_TIME_FORMAT = re.compile(r"(?:(\d+)-)?(\d+)(?::(\d+))?(?::(\d+))?")


class SlurmFailed(Exception):
    """Slurm rejects a submission; the message has its words."""


@dataclass(frozen=True)
class JobArray:
    """A job array: the study and the resources of its tasks.

    Args:
        study: Study to run.
        backend: Capabilities of its backend.
        base: Lab into which the parts are imported.
        labs: Folder of the labs of the parts.
        tasks: Number of tasks.
        time: Time limit of a task, in Slurm's notation.
        device: Device of each task.
        gpus: Number of GPUs of each task.
        cpus: Number of CPUs of each task; None: the site's default.
        site: Lines for the site, `#SBATCH` and others.
        options: Further options of sbatch.
        warned: Time before the limit at which a task is asked to stop [s].
    """

    study: Study
    backend: Capabilities
    base: Path
    labs: Path
    tasks: int
    time: str
    device: str = "cpu"
    gpus: int = 0
    cpus: int | None = None
    site: str = ""
    options: Sequence[str] = ()
    warned: int = WARNING_TIME

    def script(self) -> str:
        """Return the text of the script. Raises ValueError for invalid settings."""
        if not 1 <= self.tasks <= MAX_TASKS:
            raise ValueError(f"--tasks: {self.tasks} is not between 1 and {MAX_TASKS}")
        limit = seconds(self.time)
        if limit <= self.warned + _SIGNAL_RESOLUTION:
            raise ValueError(f"--time: {self.time} is too short: a task saves its runs {self.warned} s before the end")
        name, parts = self.study.name, self.labs.absolute()
        if invalid := next((option for option in self.options if "\n" in option or "\r" in option), None):
            raise ValueError(f"the option {invalid!r} of sbatch has a line break; give each option by itself")
        options = [
            f"--job-name={name}",
            f"--array=1-{self.tasks}",
            f"--time={self.time}",
            f"--signal=B:TERM@{self.warned}",
            "--requeue",
            "--open-mode=append",
            f"--output={_log_pattern(parts, f'{name}-%a-of-{self.tasks}.log')}",
            *([f"--gpus={self.gpus}"] if self.gpus else []),
            *([f"--cpus-per-task={self.cpus}"] if self.cpus else []),
            *self.options,
        ]
        site = self.site.splitlines()
        headers = [*(f"#SBATCH {option}" for option in options), *(line for line in site if line.startswith("#SBATCH"))]
        shell = "\n".join(line for line in site if not line.startswith(("#SBATCH", "#!")))
        words = (self.study.path.absolute(), "--backend", self.backend.name)
        command, lab = shlex.join([sys.executable, "-m", "labbook"]), shlex.quote(str(self.base.absolute()))
        run = shlex.join([*map(str, words), "--device", self.device, "--no-pilot", "--expect", stamp(self)])
        place = shlex.quote(f"{parts}/{name}-")
        return _SCRIPT.format(
            headers="\n".join(headers),
            about=f"{name}: {self.tasks} parts on {self.backend.name}, written by labbook {__version__}",
            parts=shlex.quote(str(parts)),
            site=f"{shell}\n" if shell.strip() else "",
            labbook=command,
            run=run,
            plan=shlex.join(map(str, words)),
            lab=lab,
            place=place,
            tasks=self.tasks,
            late=limit - self.warned - _SIGNAL_RESOLUTION,
            restarts=_MAX_REQUEUES,
        )


_SCRIPT = """#!/bin/bash
{headers}

# {about}
# Submit: mkdir -p {parts}; sbatch FILE
# Import of all parts when they have ended: sbatch --dependency=afterany:JOB --array=0 FILE
# Submit the same script again to go on.
{site}
labbook=({labbook})
base={lab}
place={place}

if [ "$SLURM_ARRAY_TASK_ID" = 0 ]; then  # imports the parts
    "${{labbook[@]}}" import "$place"*-of-{tasks}/ --lab "$base"
    imported=$?
    "${{labbook[@]}}" plan {plan} --lab "$base"
    exit $imported
fi

# bash passes signals on to labbook; a task whose time is over goes back into the queue
trap 'asked=x$asked; kill -TERM $work 2>/dev/null' TERM
trap 'asked=x$asked; kill -INT $work 2>/dev/null' INT
"${{labbook[@]}}" run {run} --base "$base" \\
    --lab "$place$SLURM_ARRAY_TASK_ID-of-{tasks}" --shard "$SLURM_ARRAY_TASK_ID/{tasks}" &
work=$!
while wait $work; status=$?; [ "$asked" != "$seen" ]; do  # a signal ends waiting
    seen=$asked
done
if [ -n "$asked" ] && [ $status = 130 ] && [ $SECONDS -ge {late} ] && [ "${{SLURM_RESTART_COUNT:-0}}" -lt {restarts} ]
then
    echo "Time is over: the task goes back into the queue, then on from its checkpoints"
    scontrol requeue "${{SLURM_ARRAY_JOB_ID}}_$SLURM_ARRAY_TASK_ID"
    sleep 60  # Slurm ends this
fi
exit $status
"""


_SPECIAL = re.compile(r"([\"'#])")


def _log_pattern(folder: Path, pattern: str) -> str:
    """Names of log files in a folder, quoted for a line of sbatch.

    sbatch splits such a line at blanks outside of quotation marks, ends it at #, and expands %a and similar patterns; a
    backslash in a name switches patterns off (sbatch(1), "filename pattern"). Raises ValueError for a folder that
    cannot be quoted.
    """
    text = str(folder)
    for character, description in (("\n", "a line break"), ("\r", "a line break"), ("\\", "a backslash")):
        if character in text:
            raise ValueError(f"{text!r} has {description}, which sbatch cannot read; give another folder with --labs")
    escaped = _SPECIAL.sub(r"\\\1", text.replace("%", "%%"))
    return f'"{escaped}/{pattern}"'


def stamp(array: JobArray) -> str:
    """Return the versions and hashes that a task must find unchanged."""
    return expected(array.study, array.backend)


def expected(study: Study, backend: Capabilities) -> str:
    """Return the versions of labbook and of a backend, and a hash of a study with its calibration and files."""
    beside = study.calibration_file.read_bytes() if study.calibration_file else b""
    files = "".join(sorted(study.beside.files.values())).encode()
    digest = hashlib.sha256(study.text.encode() + beside + files).hexdigest()[:12]
    return f"labbook-{__version__}/{backend.name}-{backend.cache_version}/study-{digest}"


def differs(recorded: str, study: Study, backend: Capabilities) -> str | None:
    """Describe what differs from the stamp `recorded` in the script; None if nothing does."""
    current = expected(study, backend)
    if current == recorded:
        return None
    changed = [
        f"{was} is now {now}" for was, now in zip(recorded.split("/"), current.split("/"), strict=False) if was != now
    ]
    return "; ".join(changed) or f"{recorded!r} is not written by labbook slurm"


def seconds(time: str) -> int:
    """Parse a time in Slurm's notation (minutes, MM:SS, HH:MM:SS, D-HH, D-HH:MM, D-HH:MM:SS) [s]. Raises ValueError."""
    match = _TIME_FORMAT.fullmatch(time.strip())
    if match is None:
        raise ValueError(f"--time: {time!r} is not a time; write HH:MM:SS or D-HH:MM:SS, such as 04:00:00")
    days, *parts = match.groups()
    numbers = [int(part) for part in parts if part is not None]
    if days is not None:
        hours, minutes, remainder = [*numbers, 0, 0][:3]
    elif len(numbers) == 3:
        hours, minutes, remainder = numbers
    else:
        hours, (minutes, remainder) = 0, [*numbers, 0][:2]
    return ((int(days or 0) * 24 + hours) * 60 + minutes) * 60 + remainder


def submit(array: JobArray) -> tuple[str, str]:
    """Submit the script, and the import that waits for all tasks. Returns both job numbers.

    Raises:
        ValueError: Settings are invalid.
        SlurmFailed: Slurm rejects the script, or is not installed.
    """
    text = array.script()
    array.labs.mkdir(parents=True, exist_ok=True)
    job = _sbatch(text)
    return job, _sbatch(text, f"--dependency=afterany:{job}", "--array=0", "--gpus=0" if array.gpus else "")


def _sbatch(text: str, *options: str) -> str:
    command = ["sbatch", "--parsable", *filter(None, options)]
    try:
        process = subprocess.run(
            command, input=text, capture_output=True, encoding="utf-8", errors="surrogateescape", timeout=120
        )
    except FileNotFoundError as error:
        raise SlurmFailed(
            "sbatch is not installed here; leave out --submit, and submit the printed script where sbatch is"
        ) from error
    except subprocess.TimeoutExpired as error:
        raise SlurmFailed("sbatch did not answer within 2 minutes; try again later") from error
    if process.returncode:
        raise SlurmFailed(process.stderr.strip() or f"sbatch ended with exit status {process.returncode}")
    return process.stdout.strip().partition(";")[0]
