#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Runs track_sequence over all sequences of a data set, several times, and makes the tables. README.md beside this file

tools/evaluation/evaluate.sh builds what this needs and calls it. Needs Python 3.8 or newer, and no packages."""
import argparse
import fcntl
import os
import pathlib
import shlex
import sys

from evaluation import runs, self_test, sequences, tables
from evaluation.sequences import UsageError

ROOT = pathlib.Path(__file__).resolve().parents[2]
BIN = ROOT / "build" / "bin"


def parse(arguments):
    parser = argparse.ArgumentParser(
        prog="tools/evaluation/evaluate.sh",
        description="Tracks every sequence under DIR (EuRoC, TUM-VI, KITTI layout) several times, on the host and, where there is "
        "one, on the GPU, and prints time per component, accuracy and frame loss in real time; as text, CSV and HTML "
        "in the folder OUT as well. Without DIR it generates sequences. Called again it goes on where it was cut "
        "off: a run that is finished is not repeated while sequence, options and program are the same.",
        epilog="What follows -- are options of track_sequence. The exit status is 1 where a run failed: the tables are of the others.",
    )
    parser.add_argument("directory", metavar="DIR", nargs="?", help="folder of a data set, or of one sequence")
    parser.add_argument("--runs", type=positive, default=3, metavar="N", help="of each sequence (3)")
    parser.add_argument("--backends", type=choice_of(runs.BACKENDS), metavar="LIST", help="host, cuda, or host,cuda (both, cuda where there is a GPU)")
    parser.add_argument("--modes", type=choice_of(runs.MODES), default=list(runs.MODES), metavar="LIST", help="offline: every frame; realtime: what a live camera would lose is dropped (offline,realtime)")
    parser.add_argument("--sequences", metavar="TEXT", default="", help="those alone with TEXT in their name")
    parser.add_argument("--frames", type=positive, metavar="N", help="of each sequence (all; 300 of a generated one)")
    parser.add_argument("--calibration", metavar="FILE", help="for all of them, such as ORB-SLAM3 settings (the sequence's own)")
    parser.add_argument("--out", type=pathlib.Path, default=ROOT / "build" / "evaluate", metavar="OUT", help="folder of the results (build/evaluate)")
    parser.add_argument("--mpi", metavar="COMMAND", help="run on the ranks that COMMAND starts: 'mpirun -n 4'")
    parser.add_argument("--tables-only", action="store_true", help="run nothing, make the tables of what is finished")
    parser.add_argument("--list", action="store_true", help="run nothing, say which runs there are")
    parser.add_argument("--bin", type=pathlib.Path, default=BIN, metavar="FOLDER", help="take track_sequence and the others from there: build and install nothing (build/bin, built first)")
    own, passed_on = split_at_dashes(arguments)
    args = parser.parse_args(own)
    args.passed_on = passed_on
    return args


def split_at_dashes(arguments):
    at = arguments.index("--") if "--" in arguments else len(arguments)
    return arguments[:at], arguments[at + 1 :]


def positive(text):
    if not text.isdigit() or int(text) == 0:
        raise argparse.ArgumentTypeError(f"'{text}' must be a number above 0")
    return int(text)


def choice_of(names):
    def choose(text):
        chosen = text.split(",")
        for name in chosen:
            if name not in names:
                raise argparse.ArgumentTypeError(f"'{name}' must be of {', '.join(names)}")
        return [n for n in names if n in chosen]

    return choose


def program(args, name):
    path = args.bin / name
    if not path.is_file():
        raise UsageError(f"no program '{path}': tools/evaluation/evaluate.sh without --bin builds it")
    if not os.access(path, os.X_OK):
        raise UsageError(f"'{path}' cannot be started: chmod +x, or another folder for --bin")
    return path.resolve()


def options_of(args):
    options = list(args.passed_on)
    if args.frames:
        options += ["--frames", str(args.frames)]
    if args.calibration:
        if not pathlib.Path(args.calibration).exists():
            raise UsageError(f"no calibration '{args.calibration}'")
        options += ["--calibration", str(pathlib.Path(args.calibration).resolve())]
    return options


def sequences_of(args):
    if args.directory:
        found = sequences.find_sequences(args.directory)
    else:
        render = not (args.list or args.tables_only)
        found = sequences.generate_sequences(program(args, "generate_sequence"), args.out / "sequences", args.frames or 300, render)
    chosen = [s for s in found if args.sequences in s.name]
    if not chosen:
        raise UsageError(f"no sequence has '{args.sequences}' in its name; there are {', '.join(s.name for s in found)}")
    return chosen


def plan(args):
    tracker = program(args, "track_sequence")
    chosen = sequences_of(args)
    backends = args.backends
    if backends is None:
        backends = [b for b in runs.BACKENDS if b == "host" or runs.has_cuda(tracker, chosen)]
        if "cuda" not in backends:
            print("no GPU here, or track_sequence was built without CUDA: host alone")
    return runs.plan_runs(tracker, chosen, backends, args.modes, args.runs, options_of(args), args.out)


def do(args, todo):
    if args.mpi:
        return runs.do_with_mpi(shlex.split(args.mpi), program(args, "evaluate_mpi"), args.out / "plan.json", todo)
    return runs.do_all(todo, lambda line: print(line, flush=True))


def hold_lock(out):
    """One evaluation at a time in a folder. Returns the file that holds it while it is open."""
    file = open(out / ".lock", "w", encoding="utf-8")
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as e:
        raise UsageError(f"another evaluation is at work in '{out}'") from e
    except OSError:
        pass  # a file system without locks
    return file


def evaluate(args):
    args.out = args.out.resolve()
    try:
        args.out.mkdir(parents=True, exist_ok=True)
    except OSError as e:
        raise UsageError(f"cannot make the folder '{args.out}': {e.strerror}") from e
    with hold_lock(args.out):
        everything = plan(args)
        todo = [r for r in everything if not r.finished]
        print(f"{len(everything)} runs, {len(everything) - len(todo)} of them finished before")
        if args.list:
            print("\n".join(f"{'finished' if r.finished else 'to do':8}  {r.name}" for r in everything))
            return 0
        failed = [] if args.tables_only or not todo else do(args, todo)
        results = [tables.load(r) for r in everything if r.finished]
        if results:
            title = f"Evaluation of {args.directory or 'generated sequences'}"
            print("\n" + tables.write_tables(results, title, args.out))
            print(f"{args.out}: tables.txt, tables.html, *.csv; each run's report in runs/")
        for run, why in failed:
            print(f"FAILED: {run.name}: {why}", file=sys.stderr)
        if not results:
            raise UsageError("no run is finished: no tables")
        return 1 if failed else 0


def do_job(path, index):
    """One run of a plan, for evaluate_mpi."""
    run = runs.run_of_plan(path, int(index))
    why = runs.do_run(run)
    if why:
        print(f"{run.name}: {why}", file=sys.stderr)
    return 1 if why else 0


def main(arguments):
    if arguments[:1] == ["--self-test"]:
        return self_test.main()
    if arguments[:1] == ["--job"]:
        return do_job(*arguments[1:])
    try:
        return evaluate(parse(arguments))
    except UsageError as e:
        print(f"evaluate: {e}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("\nstopped; called again it goes on from here", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
