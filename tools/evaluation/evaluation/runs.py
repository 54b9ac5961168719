# SPDX-License-Identifier: Apache-2.0
"""Runs of track_sequence: which there are, which are still to be done, doing one."""
import ctypes
import dataclasses
import json
import os
import pathlib
import platform
import shutil
import signal
import subprocess
import sys
import tempfile
import time

from .sequences import UsageError, sha256_of

MODES = ("offline", "realtime")
BACKENDS = ("host", "cuda")
NO_DEVICE = "no CUDA device"  # of track_sequence's message
ASK_FOR_HELP = "Run with --help for more information."  # the last line of its complaint about an option


@dataclasses.dataclass(frozen=True)
class Run:
    sequence: str
    backend: str
    mode: str
    number: int  # from 1
    folder: str  # of its results: a finished run is a folder of this name
    command: tuple  # without --out

    @property
    def name(self):
        return f"{self.sequence} {self.backend} {self.mode} {self.number}"

    @property
    def finished(self):
        return (pathlib.Path(self.folder) / "run.json").is_file()


def has_cuda(program, sequences):
    """Whether the program can run on a GPU of this machine. The first sequence that can be read tells."""
    for sequence in sequences:
        with tempfile.TemporaryDirectory() as out:
            command = [program, "--sequence", sequence.path, "--backend", "cuda", "--frames", "1", "--quiet", "--out", out]
            done = subprocess.run([str(c) for c in command], capture_output=True, text=True, check=False)
            if (pathlib.Path(out) / "summary.json").is_file():
                return True
        if NO_DEVICE in done.stderr:
            return False
    return False


def plan_runs(program, sequences, backends, modes, times, options, out):
    """Every run of the evaluation, first of all sequences run 1, then run 2, ...

    A result belongs to the sequence, the options, and the program by its bytes."""
    program = pathlib.Path(program)
    binary = sha256_of(program)
    files = [pathlib.Path(o) for o in options if pathlib.Path(o).is_file()]  # a calibration
    runs = []
    for number in range(1, times + 1):
        for sequence in sequences:
            for backend in backends:
                for mode in modes:
                    key = sha256_of(binary, sequence.fingerprint, backend, mode, json.dumps(options), *files)
                    command = [program, "--sequence", sequence.path, "--backend", backend, "--quiet", *options]
                    command.append("--realtime" if mode == "realtime" else "--timing")
                    folder = out / "runs" / f"{sequence.name}-{backend}-{mode}-{key}-{number}"
                    runs.append(Run(sequence.name, backend, mode, number, str(folder), tuple(str(c) for c in command)))
    return runs


def write_plan(path, runs):
    """For evaluate_mpi: a name and a command for each; the command is this program's, for one run."""
    script = pathlib.Path(__file__).resolve().parent.parent / "evaluate.py"
    jobs = [
        {"name": r.name, "command": [sys.executable, str(script), "--job", str(path), str(i)], "run": dataclasses.asdict(r)}
        for i, r in enumerate(runs)
    ]
    path.write_text(json.dumps(jobs, indent=1))


def run_of_plan(path, index):
    return Run(**json.loads(pathlib.Path(path).read_text())[index]["run"])


def do_run(run):
    """Returns nothing where the run succeeded, else why not. What a run that was cut off left is removed first."""
    folder = pathlib.Path(run.folder)
    partial, failed = folder.with_name(folder.name + ".partial"), folder.with_name(folder.name + ".failed")
    if run.finished:
        return None
    for old in (folder, partial, failed):
        shutil.rmtree(old, ignore_errors=True)
    partial.mkdir(parents=True)
    begin = time.monotonic()
    with open(partial / "log.txt", "wb") as log:
        try:
            command = [*run.command, "--out", str(partial)]
            status = subprocess.run(command, stdout=log, stderr=log, preexec_fn=end_with_parent, check=False).returncode
        except OSError as e:
            log.write(str(e).encode())
            status = 127
    why = failure_of(partial, status)
    if why is None:
        about = {
            "sequence": run.sequence,
            "backend": run.backend,
            "mode": run.mode,
            "number": run.number,
            "host": platform.node(),
            "wall_s": time.monotonic() - begin,
            "at_the_same_time": int(os.environ.get("FT_RANKS_ON_HOST", "1")),
        }
        (partial / "run.json").write_text(json.dumps(about, indent=1))
        partial.rename(folder)  # all of it is there, or nothing
        return None
    partial.rename(failed)
    return f"{why} (all of it: {failed / 'log.txt'})"


def end_with_parent():
    """In a child of this program: it is killed when this program ends, so that no run goes on unseen (Linux)."""
    set_death_signal = 1
    ctypes.CDLL(None).prctl(set_death_signal, signal.SIGKILL)


def failure_of(folder, status):
    if status != 0:
        lines = [line for line in (folder / "log.txt").read_text(errors="replace").splitlines() if line and line != ASK_FOR_HELP]
        ended = f"ended with {status}" if status > 0 else f"ended by signal {-status}"
        return f"{ended}: {lines[-1]}" if lines else ended
    for name in ("summary.json", "times.csv"):
        if not (folder / name).is_file():
            return f"wrote no {name}"
    return None


def do_all(runs, report=print):
    """One after the other, with progress. Returns what failed: (run, why)."""
    failed = []
    begin = time.monotonic()
    for done, run in enumerate(runs, 1):
        report(f"[{done}/{len(runs)}] {run.name} ...")
        why = do_run(run)
        elapsed = time.monotonic() - begin
        if why:
            failed.append((run, why))
            report(f"  FAILED: {why}")
        report(f"  {elapsed:.0f} s in all, about {duration(elapsed / done * (len(runs) - done))} left")
    return failed


def duration(seconds):
    if seconds < 100:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.1f} h"


def do_with_mpi(launcher, program, plan, runs):
    """evaluate_mpi hands the runs out to its ranks. Returns what did not succeed: (run, why)."""
    write_plan(plan, runs)
    try:
        status = subprocess.run([*launcher, str(program), str(plan)], check=False).returncode
    except OSError as e:
        raise UsageError(f"cannot start '{launcher[0]}': {e.strerror}") from e
    missing = [r for r in runs if not r.finished]
    return [(r, reason_in(r) or f"not done; '{launcher[0]}' ended with {status}") for r in missing]


def reason_in(run):
    folder = pathlib.Path(run.folder + ".failed")
    return f"see {folder / 'log.txt'}" if folder.is_dir() else None
