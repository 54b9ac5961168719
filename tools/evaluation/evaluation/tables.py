# SPDX-License-Identifier: Apache-2.0
"""The tables of an evaluation, from the files that its runs wrote, as text, CSV and HTML."""
import csv
import dataclasses
import html
import io
import json
import math
import pathlib
import statistics

# The tracking components of the paper, and the stages of track_sequence that each one is made of.
COMPONENTS = (
    ("ORB extraction", ("upload", "pyramid", "corners", "distribution", "blur", "order", "descriptors")),
    ("stereo matching", ("stereo",)),
    ("tracking from the last frame", ("search last frame", "pose last frame")),
    ("tracking in the local map", ("update local map", "search local map", "pose local map")),
    ("result", ("result",)),
    ("keyframe", ("keyframe",)),
)
TOTAL = "total"


@dataclasses.dataclass
class Result:
    """A finished run: what it said of itself, and milliseconds of each stage in each frame."""

    about: dict
    summary: dict
    stages: dict

    @property
    def group(self):
        """Runs whose times may be averaged."""
        options = self.summary["options"]
        size = f"{self.summary['image_width']}x{self.summary['image_height']}"
        return f"{options['layout']}, {options['rig']}, {size}"


def load(run):
    folder = pathlib.Path(run.folder)
    about = json.loads((folder / "run.json").read_text())
    return Result(about, json.loads((folder / "summary.json").read_text()), read_times(folder / "times.csv"))


def read_times(path):
    with open(path, newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    names = [n for n in (rows[0] if rows else {}) if n.endswith("_ms") and n != "images_to_pose_ms"]
    return {n.removesuffix("_ms"): [float(r[n]) if r[n] else 0.0 for r in rows] for n in names}


@dataclasses.dataclass
class Column:
    head: str
    digits: int = -1  # after the point; -1: text

    def text(self, value):
        if value is None:
            return "n/a"
        return str(value) if self.digits < 0 else f"{value:.{self.digits}f}"


@dataclasses.dataclass
class Table:
    name: str  # of its CSV file
    title: str
    note: str
    columns: list
    rows: list  # of values as they are: None where there is none


def mean(values):
    values = [v for v in values if v is not None]
    return statistics.fmean(values) if values else None


def median(values):
    values = [v for v in values if v is not None]
    return statistics.median(values) if values else None


def spread(values):
    """The standard deviation of the values themselves, not of a population that they are drawn from."""
    return statistics.pstdev(values) if values else None


def of_frames(results, stages):
    """Milliseconds a frame of these stages together, of all frames of all runs."""
    times = []
    for r in results:
        columns = [r.stages[s] for s in stages if s in r.stages]
        times += [math.fsum(frame) for frame in zip(*columns)]
    return times


def by(results, key):
    """Dictionary of lists, in the order of their first."""
    groups = {}
    for r in results:
        groups.setdefault(key(r), []).append(r)
    return groups


def time_columns(backends):
    columns = []
    for b in backends:
        columns += [Column(f"{b} mean, ms", 3), Column(f"{b} std, ms", 3)]
    return columns + ([Column("speed-up", 2)] if len(backends) == 2 else [])


def time_cells(results, backends, stages):
    """Mean and standard deviation for each backend; how many times as fast the second is."""
    cells, means = [], []
    for b in backends:
        times = of_frames([r for r in results if r.about["backend"] == b], stages)
        means.append(mean(times))
        cells += [means[-1], spread(times)]
    if len(backends) == 2:
        cells.append(means[0] / means[1] if means[0] and means[1] else None)
    return cells


def component_rows(results, backends):
    stages = [s for s in results[0].stages if s != TOTAL]
    rows = []
    for name, parts in COMPONENTS:
        parts = [s for s in parts if s in stages]
        if not parts:
            continue
        rows.append([name, *time_cells(results, backends, parts)])
        if len(parts) > 1:
            rows += [[f"- {s}", *time_cells(results, backends, [s])] for s in parts]
    known = {s for _, parts in COMPONENTS for s in parts}
    rows += [[s, *time_cells(results, backends, [s])] for s in stages if s not in known]
    return rows + [[TOTAL, *time_cells(results, backends, [TOTAL])]]


def component_table(results, backends):
    rows = []
    for group, members in by(results, lambda r: r.group).items():
        rows += [[group, *row] for row in component_rows(members, backends)]
    note = "Milliseconds a frame, over all frames of all runs that were not in real time. A component is the sum of its stages (-); what a frame does not do takes it 0."
    return Table("components", "Time per component", note, [Column("sequences"), Column("component"), *time_columns(backends)], rows)


def total_table(results, backends):
    rows = []
    for sequence, members in by(results, lambda r: r.about["sequence"]).items():
        frames = members[0].summary["frames"]
        rows.append([sequence, members[0].group, frames, *time_cells(members, backends, [TOTAL])])
    columns = [Column("sequence"), Column("kind"), Column("frames", 0), *time_columns(backends)]
    return Table("totals", "Time per frame and sequence", "The whole of a frame, of the same runs.", columns, rows)


def percent(part, whole):
    return 100.0 * part / whole if whole else None


def accuracy_table(results):
    rows = []
    for (sequence, mode, backend), members in by_run_kind(results).items():
        ate = [r.summary["ate_rmse_m"] for r in members]
        rpe = [r.summary["rpe_rmse_m"] for r in members]
        tracked = mean([percent(r.summary["tracked"], r.summary["frames"]) for r in members])
        length = mean([r.summary["truth_path_m"] for r in members])
        rows.append([sequence, mode, backend, len(members), length, mean(ate), median(ate), mean(rpe), median(rpe), tracked])
    columns = [Column("sequence"), Column("mode"), Column("backend"), Column("runs", 0), Column("path, m", 2)]
    columns += [Column(f"{e} {m}, m", 4) for e in ("ATE", "RPE") for m in ("mean", "median")] + [Column("tracked, %", 1)]
    note = "RMSE over the runs' frames: ATE after rigid alignment without scale; RPE of translations over a second. n/a: no ground truth, or shorter than that."
    return Table("accuracy", "Accuracy", note, columns, rows)


def by_run_kind(results):
    return by(results, lambda r: (r.about["sequence"], r.about["mode"], r.about["backend"]))


def realtime_table(results):
    rows = []
    for (sequence, _, backend), members in by_run_kind(results).items():
        came = [r.summary["frames"] + r.summary["dropped"] for r in members]
        dropped = [percent(r.summary["dropped"], c) for r, c in zip(members, came)]
        lost = [percent(r.summary["lost"], r.summary["frames"]) for r in members]
        rows.append([sequence, backend, len(members), mean(came), mean(dropped), max(dropped), mean(lost)])
    columns = [Column("sequence"), Column("backend"), Column("runs", 0), Column("frames that came", 0)]
    columns += [Column("dropped, %", 1), Column("most in a run, %", 1), Column("processed but not tracked, %", 1)]
    note = "Frames come by their time stamps; of those that come while one is processed all but the newest are dropped."
    return Table("realtime", "Frame loss in real time", note, columns, rows)


def run_table(results):
    keys = ("sequence", "mode", "backend", "number", "host", "at_the_same_time", "wall_s")
    numbers = ("frames", "tracked", "lost", "dropped", "keyframes", "ate_rmse_m", "rpe_rmse_m")
    rows = []
    for r in results:
        times = of_frames([r], [TOTAL])
        rows.append([*(r.about[k] for k in keys), r.summary["device"], *(r.summary[k] for k in numbers), mean(times), spread(times)])
    digits = {"number": 0, "at_the_same_time": 0, "wall_s": 1, "ate_rmse_m": 4, "rpe_rmse_m": 4}
    columns = [Column(k, digits.get(k, -1)) for k in keys] + [Column("device")]
    columns += [Column(k, digits.get(k, 0)) for k in numbers] + [Column("total mean, ms", 3), Column("total std, ms", 3)]
    return Table("runs", "Runs", "Every run that the tables are made of.", columns, rows)


def tables_of(results):
    """All of them; those alone for which there are runs."""
    offline = [r for r in results if r.about["mode"] == "offline"]
    realtime = [r for r in results if r.about["mode"] == "realtime"]
    tables = []
    if offline:
        backends = list(dict.fromkeys(r.about["backend"] for r in offline))
        backends.sort(key=lambda b: b != "host")
        tables += [component_table(offline, backends), total_table(offline, backends)]
    if results:
        tables.append(accuracy_table(results))
    if realtime:
        tables.append(realtime_table(realtime))
    return tables


def remarks(results):
    """What a reader of the times has to know."""
    said = []
    for backend, members in sorted(by(results, lambda r: r.about["backend"]).items(), reverse=True):
        devices = sorted({r.summary["device"] for r in members})
        said.append(f"{backend}: {'; '.join(devices)}")
        if len(devices) > 1:
            said.append(f"The times on {backend} are of different devices.")
    shared = sum(r.about["at_the_same_time"] > 1 for r in results)
    if shared:
        said.append(f"{shared} of {len(results)} runs shared their machine with other ranks: their times are longer than of a run alone.")
    return said


def as_text(table):
    cells = [[c.head for c in table.columns]]
    cells += [[c.text(v) for c, v in zip(table.columns, row)] for row in table.rows]
    widths = [max(len(row[i]) for row in cells) for i in range(len(table.columns))]
    lines = [table.title, table.note, ""]
    for number, row in enumerate(cells):
        padded = [t.ljust(w) if c.digits < 0 else t.rjust(w) for t, w, c in zip(row, widths, table.columns)]
        lines.append("  ".join(padded).rstrip())
        if number == 0:
            lines.append("  ".join("-" * w for w in widths))
    return "\n".join(lines) + "\n"


def as_csv(table):
    """With all digits, and an empty field where there is no value."""
    out = io.StringIO()
    writer = csv.writer(out)
    writer.writerow([c.head for c in table.columns])
    writer.writerows([["" if v is None else v for v in row] for row in table.rows])
    return out.getvalue()


STYLE = """body { font: 15px sans-serif; margin: 2em; } table { border-collapse: collapse; margin: 1em 0 2em; }
th, td { padding: .25em .7em; border-bottom: 1px solid #ccc; text-align: left; } .number { text-align: right;
font-variant-numeric: tabular-nums; } tr:hover { background: #f3f3f3; }"""


def as_html(title, said, tables):
    """One file without references to others."""
    parts = [f'<!DOCTYPE html><html lang="en"><head><meta charset="utf-8"><title>{html.escape(title)}</title>']
    parts += [f"<style>{STYLE}</style></head><body><h1>{html.escape(title)}</h1>"]
    parts += [f"<p>{html.escape(s)}</p>" for s in said]
    for table in tables:
        parts.append(f"<h2>{html.escape(table.title)}</h2><p>{html.escape(table.note)}</p><table>")
        for number, row in enumerate([[c.head for c in table.columns], *table.rows]):
            tag = "td" if number else "th"
            texts = [c.text(v) if number else v for c, v in zip(table.columns, row)]
            kinds = [' class="number"' if c.digits >= 0 else "" for c in table.columns]
            parts.append("<tr>" + "".join(f"<{tag}{k}>{html.escape(t)}</{tag}>" for k, t in zip(kinds, texts)) + "</tr>")
        parts.append("</table>")
    return "\n".join(parts) + "</body></html>\n"


def write_tables(results, title, out):
    """tables.txt, tables.html and a CSV file for each table. Returns the text."""
    said, tables = remarks(results), tables_of(results)
    text = "\n".join([title, *said, ""] + [as_text(t) for t in tables])
    (out / "tables.txt").write_text(text, encoding="utf-8")
    everything = [*tables, run_table(results)]
    (out / "tables.html").write_text(as_html(title, said, everything), encoding="utf-8")
    for table in everything:
        with open(out / f"{table.name}.csv", "w", encoding="utf-8", newline="") as file:
            file.write(as_csv(table))
    return text
