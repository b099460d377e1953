"""A study as a job array of Slurm: a script in which every task runs a part of it in a lab of its own, and task 0 puts
the parts together.

Nothing is shared but the file system: no database, no lock, no server. A task is asked to stop before its time is over,
saves what is going on, and is put back into the queue; one whose node is lost goes on from its last checkpoint.
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

WARNED = 120
"""Seconds before the end of its time at which a task is asked to stop."""
MOST_TASKS = 10_000
_RESOLUTION = 60  # s that Slurm may be early
_RESTARTS = 100
"""Times that a task is put back into the queue when its time is over."""
_TIME = re.compile(r"(?:(\d+)-)?(\d+)(?::(\d+))?(?::(\d+))?")


class SlurmFailed(Exception):
    """Slurm refuses what it was asked; the message has its words."""


@dataclass(frozen=True)
class Array:
    """What a script asks of Slurm and of labbook. `time`: as Slurm writes it; `labs`: folder of the labs of the parts;
    `base`: the lab into which they are imported; `site`: lines of the site, `#SBATCH` and others; `options`: further
    options of sbatch."""

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
    warned: int = WARNED

    def script(self) -> str:
        """The text of the script. Raises ValueError."""
        if not 1 <= self.tasks <= MOST_TASKS:
            raise ValueError(f"--tasks: {self.tasks} is not between 1 and {MOST_TASKS}")
        limit = seconds(self.time)
        if limit <= self.warned + _RESOLUTION:
            raise ValueError(f"--time: {self.time} is too short: a task saves its runs {self.warned} s before the end")
        name, parts = self.study.name, self.labs.absolute()
        if broken := next((one for one in self.options if "\n" in one or "\r" in one), None):
            raise ValueError(f"the option {broken!r} of sbatch has a line break; give each option by itself")
        stated = [
            f"--job-name={name}",
            f"--array=1-{self.tasks}",
            f"--time={self.time}",
            f"--signal=B:TERM@{self.warned}",
            "--requeue",
            "--open-mode=append",
            f"--output={_logs(parts, f'{name}-%a-of-{self.tasks}.log')}",
            *([f"--gpus={self.gpus}"] if self.gpus else []),
            *([f"--cpus-per-task={self.cpus}"] if self.cpus else []),
            *self.options,
        ]
        site = self.site.splitlines()
        headers = [*(f"#SBATCH {one}" for one in stated), *(line for line in site if line.startswith("#SBATCH"))]
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
            late=limit - self.warned - _RESOLUTION,
            restarts=_RESTARTS,
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


_ESCAPED = re.compile(r"([\"'#])")


def _logs(folder: Path, pattern: str) -> str:
    """Names of files in a folder, as a line of sbatch has them.

    sbatch splits such a line at blanks outside of quotation marks, ends it at #, and takes %a and the like as patterns;
    a backslash in a name switches patterns off (sbatch(1), "filename pattern"). Raises ValueError for a folder that
    cannot be written so.
    """
    text = str(folder)
    for character, what in (("\n", "a line break"), ("\r", "a line break"), ("\\", "a backslash")):
        if character in text:
            raise ValueError(f"{text!r} has {what}, which sbatch cannot read; give another folder with --labs")
    escaped = _ESCAPED.sub(r"\\\1", text.replace("%", "%%"))
    return f'"{escaped}/{pattern}"'


def stamp(array: Array) -> str:
    """What a task must find as it was when the script was written: labbook, the backend, and the study."""
    return expected(array.study, array.backend)


def expected(study: Study, backend: Capabilities) -> str:
    """The versions of labbook and of a backend, and a hash of what a study says, of its calibration and its files."""
    beside = study.calibration_file.read_bytes() if study.calibration_file else b""
    files = "".join(sorted(study.beside.files.values())).encode()
    digest = hashlib.sha256(study.text.encode() + beside + files).hexdigest()[:12]
    return f"labbook-{__version__}/{backend.name}-{backend.cache_version}/study-{digest}"


def differs(wanted: str, study: Study, backend: Capabilities) -> str | None:
    """In what a task differs from its script, in words; None if in nothing."""
    there = expected(study, backend)
    if there == wanted:
        return None
    changed = [
        f"{one} is now {now}" for one, now in zip(wanted.split("/"), there.split("/"), strict=False) if one != now
    ]
    return "; ".join(changed) or f"{wanted!r} is not written by labbook slurm"


def seconds(time: str) -> int:
    """A time as Slurm writes it (minutes, MM:SS, HH:MM:SS, D-HH, D-HH:MM, D-HH:MM:SS) in seconds. Raises ValueError."""
    found = _TIME.fullmatch(time.strip())
    if found is None:
        raise ValueError(f"--time: {time!r} is not a time; write HH:MM:SS or D-HH:MM:SS, such as 04:00:00")
    days, *parts = found.groups()
    given = [int(part) for part in parts if part is not None]
    if days is not None:
        hours, minutes, rest = [*given, 0, 0][:3]
    elif len(given) == 3:
        hours, minutes, rest = given
    else:
        hours, (minutes, rest) = 0, [*given, 0][:2]
    return ((int(days or 0) * 24 + hours) * 60 + minutes) * 60 + rest


def submit(array: Array) -> tuple[str, str]:
    """Hand the script to Slurm, and the import that waits for all tasks; the numbers of both jobs. Raises ValueError,
    SlurmFailed."""
    text = array.script()
    array.labs.mkdir(parents=True, exist_ok=True)
    job = _sbatch(text)
    return job, _sbatch(text, f"--dependency=afterany:{job}", "--array=0", "--gpus=0" if array.gpus else "")


def _sbatch(text: str, *options: str) -> str:
    command = ["sbatch", "--parsable", *filter(None, options)]
    try:
        done = subprocess.run(
            command, input=text, capture_output=True, encoding="utf-8", errors="surrogateescape", timeout=120
        )
    except FileNotFoundError as error:
        raise SlurmFailed(
            "sbatch is not installed here; leave out --submit, and submit the printed script where sbatch is"
        ) from error
    except subprocess.TimeoutExpired as error:
        raise SlurmFailed("sbatch did not answer within 2 minutes; try again later") from error
    if done.returncode:
        raise SlurmFailed(done.stderr.strip() or f"sbatch ended with exit status {done.returncode}")
    return done.stdout.strip().partition(";")[0]
