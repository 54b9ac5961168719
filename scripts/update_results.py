#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Writes the tables of README.md and docs/ from the measurements in bench/results/.

Each table stands between the lines <!-- NAME begins --> and <!-- NAME ends -->.
  update_results.py          rewrites them
  update_results.py --check  exits with 1 where a table is not what the results say
"""
import json
import pathlib
import sys

ROOT = pathlib.Path(__file__).resolve().parent.parent
RESULTS = ROOT / "bench" / "results"


def load(name):
    return json.loads((RESULTS / name).read_text())


def frames():
    bench = load("frame_h200.json")
    lines = [
        f"{bench['gpu']}; {bench['date']}, commit {bench['commit']}; "
        f"{bench['image'][0]}x{bench['image'][1]} stereo, 1200 features an image, "
        f"{bench['rows'][0]['map_points']} map points.",
        "",
        "| what | cameras | p50, us | p99, us | frames/s |",
        "|---|---:|---:|---:|---:|",
    ]
    for r in bench["rows"]:
        if not r["name"].startswith("stage: "):
            lines.append(f"| {r['name']} | {r['batch']} | {r['p50_us']:.0f} | {r['p99_us']:.0f} | {r['frames_per_s']:.0f} |")
    return lines


def stages():
    bench = load("frame_h200.json")
    lines = ["| stage | p50, us | p99, us |", "|---|---:|---:|"]
    for r in bench["rows"]:
        if r["name"].startswith("stage: "):
            lines.append(f"| {r['name'][7:]} | {r['p50_us']:.1f} | {r['p99_us']:.1f} |")
    return lines


def conformance():
    host, cuda = load("conformance_host.json"), load("conformance_cuda.json")
    lines = [
        "| stage | items | identical, host | identical, CUDA | worst difference, host | worst difference, CUDA |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    for name, h in host["stages"].items():
        c = cuda["stages"][name]
        lines.append(
            f"| {name} | {h['items']} | {h['identical']} | {c['identical']} | {h['max_abs_diff']:.2g} | {c['max_abs_diff']:.2g} |"
        )
    lines.append(f"| total | {host['items']} | {host['identical']} | {cuda['identical']} | | |")
    return lines


TABLES = {
    "README.md": {"frames": frames},
    "docs/performance.md": {"frames": frames, "stages": stages},
    "docs/conformance.md": {"conformance": conformance},
}


def main():
    check = sys.argv[1:] == ["--check"]
    stale = []
    for file, tables in TABLES.items():
        path = ROOT / file
        text = old = path.read_text()
        for name, make in tables.items():
            begin, end = f"<!-- {name} begins -->\n", f"<!-- {name} ends -->"
            head, rest = text.split(begin, 1)
            tail = rest.split(end, 1)[1]
            text = head + begin + "\n".join(make()) + "\n" + end + tail
        if text != old:
            stale.append(file)
            if not check:
                path.write_text(text)
    for file in stale:
        print(("not up to date: " if check else "written: ") + file)
    return 1 if check and stale else 0


if __name__ == "__main__":
    sys.exit(main())
