#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Writes the tables of docs/ and bench/results/README.md from the measurements in bench/results/.

Each table stands between the lines <!-- NAME begins --> and <!-- NAME ends -->.
  update_results.py              rewrites them
  update_results.py --check      exits with 1 where a table is not what the results say
  update_results.py --self-test  tests the tables on made-up results
"""
import json
import pathlib
import statistics
import sys

ROOT = pathlib.Path(__file__).resolve().parent.parent
RESULTS = ROOT / "bench" / "results"


def load(name):
    """The first measurement of a file, its settings and tables beside each other."""
    record = json.loads((RESULTS / name).read_text())["records"][0]
    return {**record, "gpu": "", **record.get("machine", {}), **record.get("settings", {}), **record.get("tables", {})}


def tables_of(name, table):
    """All tables of a name in a file, the newest record last: (the record, its rows)."""
    records = json.loads((RESULTS / name).read_text())["records"]
    return [(r, r["tables"][table]) for r in records if table in r.get("tables", {})]


def frame_results():
    """Of ft_bench; measured once, of the first executor in the file."""
    bench = load("frame_h200.json")
    return {k: of_first_backend(v) if isinstance(v, list) else v for k, v in bench.items()}


def of_first_backend(rows):
    """Without the rows of other executors than the first one's."""
    dicts = [r for r in rows if isinstance(r, dict)]
    if not dicts:
        return rows
    return [r for r in dicts if r.get("backend") == dicts[0].get("backend")]


def about(bench):
    return f"{bench['gpu'] or bench.get('processor', 'host')}; {bench['date']}, commit {bench['commit']}"


NOT_YET = ["Not measured yet."]
BAR = 50


def bars(rows, unit, digits=0):
    """A chart of (name, value) in text, the longest bar as long as BAR."""
    if not rows:
        return NOT_YET
    most = max(value for _, value in rows) or 1
    width = max(len(name) for name, _ in rows)
    number = max(len(f"{value:.{digits}f}") for _, value in rows)
    lines = ["```text"]
    for name, value in rows:
        bar = "#" * max(round(BAR * value / most), 1 if value > 0 else 0)
        lines.append(f"{name:<{width}}  {value:>{number}.{digits}f} {unit}  {bar}".rstrip())
    return lines + ["```"]


def frames():
    bench = frame_results()
    lines = [
        f"{about(bench)}; "
        f"{bench['image'][0]}x{bench['image'][1]} stereo, 1200 features an image, "
        f"{bench['rows'][0]['map_points']} map points.",
        "",
    ]
    return lines + frame_rows(bench["rows"])


def frame_rows(rows):
    lines = ["| what | cameras | p50, us | p99, us | frames/s |", "|---|---:|---:|---:|---:|"]
    for r in rows:
        if not r["name"].startswith("stage: "):
            lines.append(f"| {r['name']} | {r['batch']} | {r['p50_us']:.0f} | {r['p99_us']:.0f} | {r['frames_per_s']:.0f} |")
    return lines


def recorded():
    bench = load("frame_h200_euroc.json")
    return [f"{about(bench)}; {bench['image'][0]}x{bench['image'][1]} stereo.", ""] + frame_rows(bench["rows"])


def stage_bars(bench):
    """What each stage adds to a frame of a rectified pair."""
    rows = [r for r in bench.get("stages", []) if r["rig"] == "rectified"]
    return bars([(r["name"].removeprefix("stage: "), r["p50_us"]) for r in of_first_backend(rows)], "us", 1)


def recorded_stages():
    return stage_bars(load("frame_h200_euroc.json"))


def fisheye():
    bench = frame_results()
    if not bench.get("fisheye"):
        return NOT_YET
    return [f"{about(bench)}.", ""] + frame_rows(bench["fisheye"])


def counts():
    bench = frame_results()
    lines = [
        "| rig | frame | left keypoints | with depth | last frame: matches | inliers | local map: matches | inliers | off by, mm |",
        "|---|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    found = False
    for rig, array in (("rectified", "rows"), ("fisheye", "fisheye")):
        for r in bench.get(array, []):
            c = {k.removeprefix("counts."): v for k, v in r.items() if k.startswith("counts.")}
            if not c or r["batch"] != 1 or r["name"] not in ("frame", "frame, with pose optimisation"):
                continue
            found = True
            what = "with pose optimisation" if "optimisation" in r["name"] else "without"
            lines.append(
                f"| {rig} | {what} | {c['keypoints']:.0f} | {c['stereo_matches']:.0f} | {c['last_matches']:.0f} | "
                f"{c['last_inliers']:.0f} | {c['local_matches']:.0f} | {c['inliers']:.0f} | {1000 * c['position_error_m']:.1f} |"
            )
    return lines if found else NOT_YET


def stage_chart():
    return stage_bars(frame_results())


def throughput_chart():
    bench = frame_results()
    rows = [(f"batch of {r['batch']}", r["frames_per_s"]) for r in bench["rows"] if r["name"].startswith("batch of")]
    for r in bench.get("streams", []):
        if r["name"].startswith("images at the same time"):
            rows.append((f"{r['streams']} tracker{'s' if r['streams'] != 1 else ''}, a stream each", r["frames_per_s"]))
    return bars(rows, "frames/s")


def streams():
    bench = frame_results()
    if not bench.get("streams"):
        return NOT_YET
    lines = ["| what | trackers | threads | p50, us | p99, us | frames/s |", "|---|---:|---:|---:|---:|---:|"]
    for r in bench["streams"]:
        lines.append(
            f"| {r['name']} | {r['streams']} | {r['threads']} | {r['p50_us']:.0f} | {r['p99_us']:.0f} | {r['frames_per_s']:.0f} |"
        )
    return lines


def ablation():
    rows = load("frame_h200.json").get("ablation", [])
    if not rows:
        return NOT_YET
    lines = ["| choice | on | p50, us | p99, us | times the first |", "|---|---|---:|---:|---:|"]
    for r in rows:
        lines.append(f"| {r['name']} | {r['backend']} | {r['p50_us']:.0f} | {r['p99_us']:.0f} | {r['times_reference']:.2f} |")
    device = [(r["name"], r["p50_us"]) for r in rows if r["backend"] == rows[0]["backend"]]
    return lines + [""] + bars(device, "us")


def cameras():
    rows = load("cameras_h200.json").get("cameras", [])
    if not rows:
        return NOT_YET
    # One column per executor and number of threads, in the order of the file.
    columns = list(dict.fromkeys((r["backend"], r["threads"]) for r in rows))
    head = [f"host, {t} thread{'s' if t != 1 else ''}" if b == "host" else b for b, t in columns]
    lines = [
        "| model | scalar | " + " | ".join(f"{h}: project | Jacobian | unproject" for h in head) + " |",
        "|---|---|" + "---:|---:|---:|" * len(columns),
    ]
    value = {(r["model"], r["scalar"], r["backend"], r["threads"], r["function"]): r["ns_per_point"] for r in rows}
    for model, scalar in dict.fromkeys((r["model"], r["scalar"]) for r in rows):
        cells = []
        for backend, threads in columns:
            for function in ("project", "project_with_jacobian", "unproject"):
                key = (model, scalar, backend, threads, function)
                # Recorded under this name while the Jacobian was computed without the pixel.
                v = value.get(key, value.get((*key[:4], "project_jacobian")) if "jacobian" in function else None)
                cells.append("" if v is None else f"{v:.4f}" if backend == "cuda" else f"{v:.1f}")
        lines.append(f"| {model} | {scalar} | " + " | ".join(cells) + " |")
    return lines


def graph():
    rows = load("frame_h200.json").get("graph", [])
    if not rows:
        return NOT_YET
    lines = [
        "| rig | cameras | kernels | copies | fills | kB up | kB down by copy | kB of result, written by kernels |",
        "|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for r in rows:
        lines.append(
            f"| {r['rig']} | {r['batch']} | {r['kernels']} | {r['copies']} | {r['fills']} | {r['bytes_up'] / 1e3:.0f} | "
            f"{r['bytes_down'] / 1e3:.0f} | {r['result_bytes'] / 1e3:.0f} |"
        )
    return lines


def kernels():
    rows = load("frame_h200.json").get("kernels", [])
    if not rows:
        return NOT_YET
    lines = [
        "| kernel | rig | calls | threads | blocks | registers | shared, bytes | local, bytes | threads an SM |",
        "|---|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for r in rows:
        lines.append(
            f"| `{r['name']}` | {r['rig']} | {r['launches']} | {r['threads']} | {r['blocks']} | {r['registers']} | "
            f"{r['shared_bytes']} | {r['local_bytes']} | {r['threads_per_sm']} of {r['most_threads_per_sm']} |"
        )
    return lines


def host_stages():
    """ft_bench --only host_stages of a build with the compiler's usual flags, and of one for the processor."""
    usual, native = load("host_opencv.json"), load("host_opencv_native.json")
    lines = [
        f"{usual['processor']}, one thread; {usual['date']}, commit {usual['commit']}; "
        f"{usual['host_stages'][0].get('opencv_version', 'no OpenCV')}; "
        f"{usual['image'][0]}x{usual['image'][1]} pairs, both images, medians of {usual['host_stages'][0]['calls']} calls.",
        "",
        "| stage | ft, us | OpenCV, us | times as fast | ft for the processor, us | times as fast | OpenCV's call | what differs |",
        "|---|---:|---:|---:|---:|---:|---|---|",
    ]
    of_native = {r["name"]: r for r in native["host_stages"]}
    for r in usual["host_stages"]:
        n = of_native.get(r["name"], {})
        cells = [r["name"], f"{r['ft.p50_us']:.0f}"]
        cells += [f"{r['opencv.p50_us']:.0f}", f"{r['times_as_fast']:.2f}"] if "opencv.p50_us" in r else ["", ""]
        cells.append(f"{n['ft.p50_us']:.0f}" if n else "")
        cells.append(f"{n['times_as_fast']:.2f}" if "opencv.p50_us" in n else "")
        cells += [r.get("counterpart", ""), r.get("difference", "")]
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def conformance():
    host, cuda = load("conformance_host.json"), load("conformance_cuda.json")
    lines = [
        "| stage | items | identical, host | identical, CUDA | worst difference, host | worst difference, CUDA |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    on_cuda = {c["name"]: c for c in cuda["stages"]}
    for h in host["stages"]:
        name, c = h["name"], on_cuda[h["name"]]
        lines.append(
            f"| {name} | {h['items']} | {h['identical']} | {c['identical']} | {h['max_abs_diff']:.2g} | {c['max_abs_diff']:.2g} |"
        )
    lines.append(f"| total | {host['items']} | {host['identical']} | {cuda['identical']} | | |")
    return lines


# What the table of odometries shows: record, row among those of a rig, and what to call it.
ODOMETRIES = (
    ("on_2026_11_28, EuRoC", "rectified", 0, "EuRoC pair"),
    ("on_2026_11_28, EuRoC", "rectified", 1, "64 EuRoC pairs, each with its map"),
    ("on_2026_11_28", "rectified", 0, "generated pair"),
    ("on_2026_11_27", "rectified", 2, "64 generated pairs, each with its map"),
    ("on_2026_11_25, runs 3", "rectified", 0, "200 generated pairs"),
    ("on_2026_11_28", "four cameras", 0, "two generated pairs in one rig"),
    ("on_2026_11_25, runs 3", "four cameras", 0, "the same, 200 of them"),
    ("on_2026_11_28", "with IMU", 1, "with an IMU"),
    ("on_2026_11_28", "with IMU", 0, "the same, 5 ms apart"),
    ("on_2026_11_28", "prefetched", 0, "generated pair, prefetched"),
)


def odometries():
    records = {r.get("name"): r for r in json.loads((RESULTS / "odometry_h200.json").read_text())["records"]}
    lines = ["| | commit | keyframes | p50, us | p99, us | frames/s |", "|---|---|---:|---:|---:|---:|"]
    for record, rig, number, name in ODOMETRIES:
        of_rig = [r for r in records[record]["tables"]["odometry"] if r["rig"] == rig]
        r = of_rig[number]
        waited = r["frames_per_s"] * r["p99_us"] < 0.5e6  # for the next frame, so the rate says nothing
        lines.append(
            f"| {name} | {records[record]['commit']} | {100 * r['keyframes']:.0f} % | {r['p50_us']:.0f} | {r['p99_us']:.0f} | "
            f"{'' if waited else format(r['frames_per_s'], '.0f')} |"
        )
        if number == 0 and record == "on_2026_11_28, EuRoC":
            mps = records["runs 4"]
            lines.append(
                f"| the same on 12 % of the multiprocessors (CUDA MPS) | {mps['commit']} | | "
                f"{mps['tables']['p50_us'][0]['rectified']:.0f} | {mps['tables']['p99_us'][0]['rectified']:.0f} | |"
            )
    return lines


def range_of(values):
    """Medians of several runs: the least and the largest."""
    low, high = f"{min(values):.0f}", f"{max(values):.0f}"
    return low if low == high else f"{low} to {high}"


def speed_asked():
    """What is wanted of speed: at the commit where it was asked for, and in the newest measurement."""
    record, rows = tables_of("speed_asked_h200.json", "asked")[-1]
    lines = [f"{measured_on(record)} {rows[0]['old']} beside it.", "", f"| | images | {rows[0]['old']} | {rows[0]['new']} | wanted |",
             "|---|---|---:|---:|---:|"]
    for r in rows:
        figures = []
        for commit in ("old", "new"):
            rate = r.get(f"{commit}_frames_per_s")
            figures.append(f"{rate[0]} frames/s" if rate else f"{range_of(r[f'{commit}_p50_us'])} ({range_of(r[f'{commit}_p99_us'])})")
        lines.append(f"| {r['what']} | {r['images']} | {figures[0]} | {figures[1]} | {r['wanted']} |")
    return lines


def odometry_kernels(least_us=7):
    """Kernels that take so long at least: how full the busiest scheduler is, and what warps wait for."""
    record, rows = tables_of("odometry_kernels_h200.json", "rows")[-1]
    lines = [measured_on(record), "", "| kernel | us alone | blocks | issue slots, % | L2, % | a warp waits for |", "|---|---:|---:|---:|---:|---|"]
    for r in sorted(rows, key=lambda r: -r["us"]):
        if r["us"] >= least_us:
            waits = ", ".join(f"{what} ({100 * share:.0f} %)" for what, share in zip(r["waits_for"], r["waits_share"]))
            lines.append(f"| `{r['kernel']}` | {r['us']:.1f} | {r['blocks']} | {100 * r['issue_share_of_busiest']:.0f} | {r['l2_pct']:.0f} | {waits} |")
    return lines


def descriptors():
    """Matches of all with all: without and with tensor cores on one machine, and of the newest commit on another."""
    first, old = tables_of("match_descriptors_h100.json", "match_descriptors")[-1]
    newest, new = tables_of("match_descriptors_h200.json", "by_commit")[-1]
    one_way = {(r["model"], r["rows"]): r for r in old if r["tests"] == "one way"}
    now = {(r["model"], r["rows"]): statistics.median(r["new_p50_us"]) for r in new if r["tests"] == "one way"}
    heads = [f"plain, {first['commit']}", f"tensor cores, {first['commit']}", f"tensor cores, {newest['commit']}"]
    lines = ["| | " + " | ".join(f"{n}: {h}" for n in ("1,000", "8,000") for h in heads) + " |", "|---" + "|---:" * 6 + "|"]
    for model in dict.fromkeys(m for m, _ in one_way):
        figures = []
        for n in (1000, 8000):
            r = one_way[model, n]
            figures += [f"{v:.1f}" if n == 1000 else f"{v:.0f}" for v in (r["plain_p50_us"], r["tensor_cores_p50_us"], now[model, n])]
        lines.append(f"| {model} | " + " | ".join(figures) + " |")
    return lines


def places():
    rows = load("words_h200.json")["words"]
    lines = ["| | H200 | one core |", "|---|---:|---:|"]
    for name, count in dict.fromkeys((r["name"], r["count"]) for r in rows):
        of = {r["backend"]: r["p50_us"] for r in rows if (r["name"], r["count"]) == (name, count)}
        lines.append(f"| {name}{f', {count}' if count != 1 else ''} | {of['cuda']:.0f} | {of['host']:.0f} |")
    return lines


LOOPS = "loops_cases.json"


def measured_on(record):
    """Where it was measured, and before which change, if it was."""
    machine = record["machine"]
    line = f"{machine.get('gpu') or machine['processor']}, commit {record['commit']}"
    before = record.get("settings", {}).get("before")
    return line + (f": before {before}." if before else ".")


def walk(name):
    return {"walk_1000": "walk, 50 loops anywhere"}.get(name, "walk in laps" if name.startswith("walk_") else name)


def loop_trials():
    lines = []
    for record, rows in tables_of(LOOPS, "trials"):
        lines += [measured_on(record), "", "| walls | trials | loops | wrong | revisits found |", "|---|---:|---:|---:|---:|"]
        lines += [f"| {r['what']} | {r['trials']} | {r['loops']} | {r['wrong_loops']} | {r['revisits_found']} |" for r in rows] + [""]
    for record, (row,) in tables_of(LOOPS, "starts"):
        lines += [f"{measured_on(record)[:-1]}: of {row['starts']} starts in a loaded map {row['found_in_3']} were found in three frames, "
                  f"{row['within_2cm_1deg']} within 2 cm and 1 degree of the truth, {row['wrong']} wrong.", ""]
    return lines[:-1]


def beside_keyframes():
    record, rows = tables_of(LOOPS, "flat")[-1]
    lines = [measured_on(record), "", "| keyframes for loops | p50, us | p99, us | most, us | most while a loop is closed | device, MB |",
             "|---:|---:|---:|---:|---:|---:|"]
    for r in rows:
        numbers = [r["p50_us"], r["p99_us"], r["max_us"], r["closing_max_us"] or None, r["device_mb"]]
        lines.append(f"| {r['keyframes'] or 'without loops'} | " + " | ".join("" if n is None else f"{n:.0f}" for n in numbers) + " |")
    return lines


def beside_ceres():
    lines = ["| problem | commit | H100, ms | Ceres, ms | times as fast |", "|---|---|---:|---:|---:|"]
    for record, rows in tables_of(LOOPS, "graphs")[-1:]:
        for r in rows:
            theirs = r.get("ceres_within_1e-6_ms")
            limit = r.get("ceres_not_within_ms")
            end = f"{theirs:.0f} | {theirs / r['median_ms']:.0f}" if theirs else f"> {limit / 1000:.0f} s | " if limit else "not run | "
            lines.append(f"| pose graph {walk(r['graph'])}, {r['poses']} poses | {record['commit']} | {r['median_ms']:.1f} | {end} |")
    for record, rows in tables_of(LOOPS, "maps")[-1:]:
        for r in rows:
            what = f"map, {r['views']} views, {r['points']} points" + (f", {100 * r['outliers']:.0f} % outliers" if r["outliers"] else "")
            lines.append(f"| {what} | {record['commit']} | {r['median_ms']:.1f} | {r['ceres_ms']:.0f} | {r['ceres_ms'] / r['median_ms']:.0f} |")
    return lines


def mixed_rigs():
    """Medians over the seeds."""
    record, rows = tables_of("mixed_rigs_h200.json", "rows")[-1]
    lines = [measured_on(record), "", "| cameras | ATE, mm | with IMU | p50, ms | with IMU | p99, ms | with IMU |", "|---|---:|---:|---:|---:|---:|---:|"]
    for name in dict.fromkeys(r["cameras"] for r in rows):
        cells = []
        for figure, digits in (("ate_mm", 1), ("p50_ms", 2), ("p99_ms", 2)):
            for imu in (False, True):
                cells.append(f"{statistics.median(r[figure] for r in rows if r['cameras'] == name and r['imu'] == imu):.{digits}f}")
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return lines


def energy():
    record, rows = tables_of("energy_h200.json", "rows")[-1]
    lines = [measured_on(record), "", "| | rate, Hz | GPU at rest, W | mJ of a frame beyond it, each run | p50, ms | p99, ms |", "|---|---:|---:|---|---:|---:|"]
    for name, hz in dict.fromkeys((r["name"], r["hz"]) for r in rows):
        runs = [r for r in rows if (r["name"], r["hz"]) == (name, hz)]
        rest = [r[k] for r in runs for k in ("watts_before", "watts_after")]
        p50, p99 = (statistics.median(r[k] for r in runs) for k in ("ms_p50", "ms_p99"))
        told = ", ".join(f"{r['millijoules']:.0f}" for r in runs)
        lines.append(f"| {name} | {hz:g} | {min(rest):.0f} to {max(rest):.0f} | {told} | {p50:.2f} | {p99:.2f} |")
    return lines


def scenario_rows(file="scenarios_h200.json", missing_alone=False):
    """Of tools/evaluation/scenarios.py: medians over the seeds, sums of what is counted; all, or those that miss a figure."""
    try:
        result = load(file)
    except FileNotFoundError:
        return NOT_YET
    by_name = {}
    for r in result["rows"]:
        by_name.setdefault(r["scenario"], []).append(r)
    seeds = sorted({r["seed"] for r in result["rows"]})
    lines = [
        f"{result['gpu'] or result['processor']}; {result['date']}, commit {result['commit']}; seeds {', '.join(map(str, seeds))}.",
        "",
        "| scenario | seeds | ATE, mm | without IMU, mm | largest, mm | lost | most maps | silent | warned, right | of frames | misses (seeds) |",
        "|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---|",
    ]
    for name, rows in by_name.items():
        if missing_alone and not any(r["misses"] for r in rows):
            continue
        lengths = [median_mm(r.get(k) for r in rows) for k in ("ate_m", "ate_without_imu_m", "max_error_m")]
        totals = {k: sum(r.get(k) or 0 for r in rows) for k in ("lost", "silent", "frames")}
        maps = max(r.get("maps") or 0 for r in rows)
        missed = sorted({m for r in rows for m in r["misses"]})
        said = ", ".join(f"{m} ({sum(m in r['misses'] for r in rows)})" for m in missed)
        told = sum(r["warned_right"] for r in rows)
        cells = [name, len(rows), *lengths, totals["lost"], maps, totals["silent"], told, totals["frames"], said]
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    return lines


def beside_cuvslam():
    """Of bench/peers/beside_cuvslam.py."""
    records = json.loads((RESULTS / "beside_cuvslam_h200.json").read_text())["records"]
    commits = ("commits " if len(records) > 1 else "commit ") + " and ".join(r["commit"] for r in records)
    lines = [
        f"{records[0]['machine']['gpu']}; {records[-1]['date']}, {commits}.",
        "",
        "| frames | of them every | ATE, mm: ft | cuVSLAM, 3 runs | adjusting within frames | RPE of a frame, mm: ft, cuVSLAM | ms: ft p50, p99 | cuVSLAM |",
        "|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for r in [row for record in records for row in record["tables"]["rows"]]:
        name = r["recording"] + (f", seed {r['seed']}" if "seed" in r else "")
        runs = [1000 * v for v in r["cuvslam.ate_m"]]
        least, most = f"{runs[0]:.1f}", f"{runs[-1]:.1f}"
        found = f"{1000 * r['ft.ate_m']:.1f}" + (f" ({r['ft.lost']} lost)" if r["ft.lost"] else "")
        times = [f"{r[f'{who}.p50_ms']:.2f}, {r[f'{who}.p99_ms']:.2f}" for who in ("ft", "cuvslam")]
        cells = [
            name, r["every"], found, least if least == most else f"{least} to {most}",
            f"{1000 * r['cuvslam.ate_synchronous_m']:.1f}",
            ", ".join(f"{1000 * r[name]:.2f}" for name in ("ft.rpe_frame_m", "cuvslam.rpe_frame_m") if r.get(name)), *times,
        ]
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    return lines


def wanted(file="wanted.json", before="at 5c02885", commits=False):
    """Of such a file: each case as it was, as it is wanted, and as another file says it is. A row is as wanted where all its
    conditions hold. Of a case with a `table` the newest one counts; `of` has names and values that pick its rows."""
    lines = [f"| case | {before} | wanted | today | rows as wanted |" + (" commit |" if commits else ""),
             "|---|---|---|---:|---:|" + ("---|" if commits else "")]
    section = ""
    for case in load(file)["rows"]:
        if case["section"] != section:
            section = case["section"]
            lines.append(f"| **{section}** | | | | |" + (" |" if commits else ""))
        if "table" in case:
            record, rows = tables_of(case["from"], case["table"])[-1]
        else:
            records = json.loads((RESULTS / case["from"]).read_text())["records"]
            record, rows = records[0], [row for r in records for row in r["tables"].get("rows", [])]
        keys = {**{k: case[k] for k in ("scenario", "recording", "every") if k in case}, **dict(zip(case.get("of", [])[::2], case.get("of", [])[1::2]))}
        rows = [r for r in rows if all(r.get(k) == v for k, v in keys.items())]
        values = [figure_of(r, case["figure"]) for r in rows]
        good = sum(all(holds(r, *limit) for limit in limits_of(case)) for r in rows)
        known = [v for v in values if v is not None]
        cells = [case["case"], case["before"], case["wanted"], said_of(known, case["figure"]), f"{good} of {len(rows)}"]
        lines.append("| " + " | ".join(cells + [record["commit"]] * commits) + " |")
    return lines


def limits_of(case):
    """What a row has to keep: figure, "most" or "least", and the number."""
    of_figure = [(case["figure"], way, case[way]) for way in ("most", "least") if way in case]
    others = [(figure, way, limit) for (way, _, figure), limit in ((k.partition("."), v) for k, v in case.items()) if figure]
    return of_figure + others


def holds(row, figure, way, limit):
    """A figure that was not measured is not as wanted."""
    value = figure_of(row, figure)
    return value is not None and (value <= limit if way == "most" else value >= limit)


def figure_of(row, name):
    if name in PARTS:
        part, whole = (row.get(k) for k in PARTS[name])
        return part / whole if part is not None and whole else None
    return row.get(name)


# Figures that are one of a row by another one.
PARTS = {
    "ft.keyframe_share": ("ft.keyframes", "ft.frames"),
    "revisits_share": ("revisits_found", "trials"), "times_ceres": ("ceres_ms", "median_ms"),
    "times_ceres_within": ("ceres_within_1e-6_ms", "median_ms"),
}


def said_of(values, figure):
    """The median, and where there are several, the least and the largest."""
    if not values:
        return "not measured"
    length = figure.endswith("_m")
    scale, unit = (1000, " mm") if length else (100, " %") if "share" in figure or figure in SHARES else (1, "")
    unit = unit or next((f" {u}" for u in ("mm", "ms") if figure.endswith(f"_{u}")), "")
    digits = 0 if figure in COUNTS else 1 if unit or figure in PARTS else 2
    if figure == "cost_above_ceres":
        return f"{statistics.median(values):.1e}"
    text = [f"{scale * v:.{digits}f}" for v in (statistics.median(values), min(values), max(values))]
    return f"{text[0]}{unit}" + (f" ({text[1]} to {text[2]})" if text[1] != text[2] else "")


SHARES = ("contained", "imu_used", "jumps_right")
COUNTS = ("silent", "ft.keyframes", "wrong_loops", "found_in_3", "within_2cm_1deg", "wrong")


def median_mm(lengths):
    known = [v for v in lengths if v is not None]
    return f"{1000 * statistics.median(known):.1f}" if known else ""


TABLES = {
    "docs/scenarios.md": {
        "scenarios": scenario_rows,
        "new seeds": lambda: scenario_rows("scenarios_new_seeds_h200.json", missing_alone=True),
        "wanted": wanted,
        "beside cuVSLAM": beside_cuvslam,
    },
    "docs/performance.md": {
        "recorded frames": recorded, "recorded stages": recorded_stages, "odometries": odometries, "places": places,
        "speed asked": speed_asked, "descriptors": descriptors, "mixed rigs": mixed_rigs, "energy": energy, "odometry kernels": odometry_kernels,
        "loops wanted": lambda: wanted("wanted_loops.json", "before, or elsewhere", True), "loop trials": loop_trials, "beside keyframes": beside_keyframes, "beside Ceres": beside_ceres,
    },
    "bench/results/README.md": {
        "frames": frames,
        "counts": counts,
        "stage chart": stage_chart,
        "fisheye": fisheye,
        "throughput chart": throughput_chart,
        "streams": streams,
        "ablation": ablation,
        "cameras": cameras,
        "graph": graph,
        "kernels": kernels,
        "host against OpenCV": host_stages,
        "conformance": conformance,
    },
}


# What the words in the column `wanted` are judged by.
WORDS = {"lost": "lost", "map": "maps", "told": "warned"}


def self_test():
    global load
    for case in load("wanted.json")["rows"]:
        judged = {figure.removeprefix("ft.") for figure, _, _ in limits_of(case)}
        for word, figure in WORDS.items():
            assert (word in case["wanted"]) == (figure in judged), case
    case = {"figure": "ate_share", "most": 0.02, "least.warned": 1, "most.silent": 0, "most.ft.lost": 2}
    row = {"ate_share": 0.02, "warned": 1, "silent": 0, "ft.lost": 2}
    assert len(limits_of(case)) == 4 and all(holds(row, *limit) for limit in limits_of(case))
    for name, wrong in (("ate_share", 0.03), ("warned", 0), ("silent", 1), ("ft.lost", 3), ("silent", None)):
        assert not all(holds({**row, name: wrong}, *limit) for limit in limits_of(case)), name
    row = {"name": "frame", "backend": "cuda", "batch": 1, "p50_us": 100.0, "p99_us": 120.0, "frames_per_s": 10000.0, "map_points": 3000}
    results = {
        "gpu": "a GPU", "date": "2000-01-01", "commit": "0", "image": [752, 480],
        "rows": [row, dict(row, name="stage: blur", p50_us=5.0), dict(row, name="frame", backend="host", p50_us=7.0)],
    }
    load = lambda _: results
    assert bars([("a", 10), ("bcd", 5), ("e", 0)], "us") == [
        "```text", "a    10 us  " + "#" * 50, "bcd   5 us  " + "#" * 25, "e     0 us", "```"]
    assert bars([("a", 1000), ("b", 0.001)], "us")[2].endswith("#")  # what is there is seen
    assert bars([], "us") == NOT_YET
    text = "\n".join(frames())
    assert "| frame | 1 | 100 | 120 | 10000 |" in text and "| 7 |" not in text and "stage" not in text, text
    for empty in (fisheye, counts, stage_chart, recorded_stages, streams, ablation, cameras, graph, kernels):
        assert empty() == NOT_YET, empty
    blur = dict(row, name="stage: blur", rig="rectified", p50_us=5.0)
    results["stages"] = [blur, dict(blur, rig="fisheye", p50_us=9.0), dict(blur, backend="host", p50_us=7.0)]
    for chart in (stage_chart, recorded_stages):
        assert chart() == ["```text", "blur  5.0 us  " + "#" * 50, "```"], chart()
    results["cameras"] = [
        {"model": "m", "scalar": "float", "function": "project", "backend": "host", "threads": 1, "ns_per_point": 2.5},
        {"model": "m", "scalar": "float", "function": "unproject", "backend": "cuda", "threads": 0, "ns_per_point": 0.0051}]
    assert cameras()[-1] == "| m | float | 2.5 |  |  |  |  | 0.0051 |", cameras()
    results.update(processor="a processor", host_stages=[
        {"name": "blur", "calls": 9, "ft.p50_us": 50.0, "opencv.p50_us": 100.0, "times_as_fast": 2.0,
         "opencv_version": "OpenCV 0", "counterpart": "GaussianBlur", "difference": "none"},
        {"name": "distribution", "calls": 9, "ft.p50_us": 7.0}])
    assert host_stages()[-2:] == ["| blur | 50 | 100 | 2.00 | 50 | 2.00 | GaussianBlur | none |",
                                  "| distribution | 7 |  |  | 7 |  |  |  |"], host_stages()
    results["ablation"] = [dict(row, times_reference=1.0), dict(row, name="other", backend="host", times_reference=2.5)]
    assert "| other | host | 100 | 120 | 2.50 |" in ablation() and not ablation()[-2].startswith("other")
    one = dict(scenario="x", seed=1, frames=9, ate_m=0.01, ate_without_imu_m=None, max_error_m=0.5, lost=1, maps=2, silent=3, misses=["maps"])
    results["rows"] = [one, dict(one, seed=2, ate_m=0.03, misses=[]), dict(one, seed=3, ate_m=None)]
    results["rows"] = [dict(r, warned_right=4) for r in results["rows"]] + [dict(one, scenario="y", warned_right=0, misses=[])]
    x = "| x | 3 | 20.0 |  | 500.0 | 3 | 2 | 9 | 12 | 27 | maps (2) |"
    assert scenario_rows()[-2] == x and scenario_rows(missing_alone=True)[-1] == x, scenario_rows()[-2]
    assert range_of([1.2, 3.7]) == "1 to 4" and range_of([1.1, 1.2]) == "1"
    print("update_results.py: self-test passed")


def main():
    if sys.argv[1:] not in ([], ["--check"], ["--self-test"]):
        print(__doc__.strip(), file=sys.stderr)
        return 0 if sys.argv[1] in ("-h", "--help") else 2
    if sys.argv[1:] == ["--self-test"]:
        return self_test()
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
