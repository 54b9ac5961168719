#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Tracks what goes wrong: generated sequences with faults of images and IMUs; says where a wrong pose was not told of.

    tools/evaluation/scenarios.py --seeds 1 2 3 --out scenarios.json
    tools/evaluation/scenarios.py --seeds 1 --only bonnet_40 clock --size 376x240

docs/scenarios.md says what the scenarios are and what the figures mean."""
import argparse
import concurrent.futures
import datetime
import json
import os
import pathlib
import platform
import shutil
import subprocess
import sys
import tempfile
import unittest

HERE = pathlib.Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))
from evaluation import motions, scenario_runs, scenarios  # noqa: E402  (its folder has to be found first)

ROOT = HERE.parent.parent


def size_of(text):
    width, height = (int(n) for n in text.split("x"))
    return width, height


def parse(arguments):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1], help="of the generated sequences (1)")
    parser.add_argument("--only", nargs="+", default=[], metavar="NAME", help="scenarios of this name, or whose name begins so (all)")
    parser.add_argument("--backend", choices=("host", "cuda"), default="host")
    parser.add_argument("--size", type=size_of, help="of the images of pinhole cameras, WxH (752x480; fisheye 512x512)")
    parser.add_argument("--frames", type=int, help="at most so many; at least 120, so that faults and what follows are in (each one's own)")
    parser.add_argument("--jobs", type=int, default=1, help="runs at the same time (1)")
    parser.add_argument("--bin", type=pathlib.Path, default=ROOT / "build" / "bin", help="folder of the programs (build/bin)")
    parser.add_argument("--work", type=pathlib.Path, help="folder for sequences and runs, kept (a temporary one)")
    parser.add_argument("--out", type=pathlib.Path, help="JSON file to write")
    parser.add_argument("--list", action="store_true", help="names of the scenarios; runs nothing")
    parser.add_argument("--self-test", action="store_true", help="tests of the figures and of the faults")
    options = parser.parse_args(arguments)
    options.command = " ".join(["tools/evaluation/scenarios.py", *arguments])
    if options.frames is not None and options.frames < 120:
        parser.error(f"--frames {options.frames}: must be at least 120")
    unknown = [n for n in options.only if not any(s.name.startswith(n) for s in scenarios.ALL)]
    if unknown:
        parser.error(f"--only {unknown[0]}: no scenario's name begins so; --list names them")
    return options


def selected(only):
    """Those named; a name that is not one of them stands for all that begin so."""
    names = {s.name for s in scenarios.ALL}
    return [
        s for s in scenarios.ALL
        if not only or any(s.name == n or (n not in names and s.name.startswith(n)) for n in only)
    ]


def commit():
    done = subprocess.run(["git", "rev-parse", "--short", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=False)
    return done.stdout.strip() or None


def processor():
    try:
        for line in open("/proc/cpuinfo", encoding="utf-8"):
            if line.startswith("model name"):
                return f"{line.split(':')[1].strip()}, {os.cpu_count()} cores"
    except OSError:
        pass
    return platform.machine()


def run_all(options, work):
    """Rows of all seeds, in order; sequences of a seed are removed after it."""
    rows = []
    for seed in options.seeds:
        shop = scenario_runs.Workshop(options.bin, work / f"seed_{seed}", options.backend, options.size, options.frames)
        with concurrent.futures.ThreadPoolExecutor(options.jobs) as pool:
            for row in pool.map(lambda s, shop=shop, seed=seed: shop.row(s, seed), selected(options.only)):
                rows.append(row)
                print(scenario_runs.line_of(row), flush=True)
                if options.out:
                    write(options, rows)
        if options.work is None:
            shutil.rmtree(work / f"seed_{seed}", ignore_errors=True)
    return rows


def record_of(options, rows):
    """As a file of bench/results has it."""
    machine = {"processor": processor()}
    devices = sorted({r["device"] for r in rows if r.get("device")})
    if options.backend == "cuda":
        machine["gpu"] = ", ".join(devices)
    return {
        "date": datetime.date.today().isoformat(),
        "commit": commit(),
        "command": [options.command],
        "machine": machine,
        "settings": {"silent_m": motions.LEAST_M, "silent_share_of_path": motions.SHARE_OF_PATH, "silent_deviations": motions.DEVIATIONS},
    }


def plain(row):
    """A row of a file: without what is not known; warnings with their numbers of frames."""
    out = {k: v for k, v in row.items() if v is not None and k != "device"}
    out["warnings"] = [f"{name} {count}" for name, count in (row["warnings"] or {}).items()]
    return out


def write(options, rows):
    lines = [json.dumps(plain(r)) for r in rows]
    record = json.dumps(record_of(options, rows), indent=1)[:-2].replace("\n", "\n  ")
    what = json.dumps("scenarios of tools/evaluation/scenarios.py; lengths in metres")
    table = '   "tables": {\n    "rows": [\n     ' + ",\n     ".join(lines) + "\n    ]\n   }"
    options.out.write_text(f'{{\n "what": {what},\n "records": [\n  {record},\n{table}\n  }}\n ]\n}}\n', encoding="utf-8")


def main(arguments):
    options = parse(arguments)
    if options.self_test:
        from evaluation import fault_test, scenario_test

        tests = [unittest.defaultTestLoader.loadTestsFromModule(m) for m in (fault_test, scenario_test)]
        done = unittest.TextTestRunner().run(unittest.TestSuite(tests))
        return 0 if done.wasSuccessful() else 1
    if options.list:
        for s in selected(options.only):
            print(f"{s.name:22} {s.what}")
        return 0
    for program in ("generate_sequence", "track_sequence"):
        if not (options.bin / program).is_file():
            sys.exit(f"scenarios.py: --bin {options.bin}: no {program} there")
    print(scenario_runs.HEAD, flush=True)
    with tempfile.TemporaryDirectory() as temporary:
        work = options.work or pathlib.Path(temporary)
        rows = run_all(options, work)
    missed = [r for r in rows if r["misses"]]
    silent = [r for r in rows if r["silent"]]
    print(f"\n{len(rows)} rows; {len(missed)} miss a figure, {len(silent)} are silently wrong somewhere")
    return 1 if any(r["error"] for r in rows) else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
