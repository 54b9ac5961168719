#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""The one shape of the files in bench/results, a check of it, and the way into it.

    {"what": what was measured,
     "records": [a measurement at one commit on one machine: {
        "name": which part of the file, where there are several,
        "date": "YYYY-MM-DD", "commit": of what was measured,
        "machine": {"gpu": ..., "processor": ..., "threads": ..., ...},
        "command": text or list, "note": text,
        "settings": {name: value},
        "tables": {name: [row, ...]}}]}

A row is {name: value}; a value is a number, a text, true or false, or a list of those. What belongs together has a
dotted name: ft.p50_us.

  results.py --check [FILE...]      exits with 1 where a file has another shape; all of bench/results by default
  results.py FILE NAME.json --what TEXT [--date DATE] [--commit COMMIT]
                                    writes what a program wrote as bench/results/NAME.json, no number lost
  results.py --self-test
"""
import argparse
import collections
import json
import math
import pathlib
import re
import sys

RESULTS = pathlib.Path(__file__).resolve().parent / "results"
MACHINE = ("gpu", "device", "processor", "driver", "cuda", "python", "opencv", "threads")
TEXTS = ("what", "date", "commit", "note")
RECORD = {"name", "what", "date", "commit", "machine", "command", "note", "settings", "tables"}


# ---- the check ------------------------------------------------------------------------------------


def is_value(v):
    if isinstance(v, list):
        return all(is_value(x) and not isinstance(x, list) for x in v)
    return isinstance(v, (bool, int, str)) or (isinstance(v, float) and math.isfinite(v))


def faults_of_values(where, values):
    if not isinstance(values, dict) or not values:
        yield f"{where}: not an object with a value"
        return
    for name, v in values.items():
        if not is_value(v):
            yield f"{where}: {name!r} is no number, text or list of those"


def faults_of_record(where, record):
    if not isinstance(record, dict):
        yield f"{where}: not an object"
        return
    for name in sorted(record.keys() - RECORD):
        yield f"{where}: {name!r} is no part of a record; a figure belongs in settings or tables"
    if not re.fullmatch(r"\d{4}-\d\d-\d\d", str(record.get("date"))):
        yield f"{where}: date {record.get('date')!r} is not YYYY-MM-DD"
    if not re.fullmatch(r"[0-9a-f]{7,40}", str(record.get("commit"))):
        yield f"{where}: commit {record.get('commit')!r} is not 7 to 40 hexadecimal digits"
    for name in record.keys() & {"name", "what", "note"}:
        if not isinstance(record[name], str) or not record[name]:
            yield f"{where}: {name!r} is not a text"
    if "command" in record and not is_value(record["command"]):
        yield f"{where}: 'command' is neither a text nor a list of texts"
    for name in record.keys() & {"machine", "settings"}:
        yield from faults_of_values(f"{where}: {name}", record[name])
    tables = record.get("tables", {})
    if not isinstance(tables, dict):
        yield f"{where}: 'tables' is not an object"
        return
    for name, rows in tables.items():
        if not isinstance(rows, list) or not rows:
            yield f"{where}: table {name!r} is not a list with a row"
            continue
        for i, row in enumerate(rows):
            yield from faults_of_values(f"{where}: table {name!r}, row {i}", row)


def faults_of(name, data):
    if not isinstance(data, dict) or data.keys() != {"what", "records"}:
        yield f"{name}: not an object of 'what' and 'records'"
        return
    if not isinstance(data["what"], str) or not data["what"]:
        yield f"{name}: 'what' is not a text"
    if not isinstance(data["records"], list) or not data["records"]:
        yield f"{name}: 'records' is not a list with a record"
        return
    for i, record in enumerate(data["records"]):
        yield from faults_of_record(f"{name}: record {i}", record)


def check(paths):
    faults = []
    for path in paths:
        try:
            faults += faults_of(path.name, json.loads(path.read_text(encoding="utf-8")))
        except ValueError as error:
            faults.append(f"{path.name}: {error}")
    return faults


# ---- the way into it ------------------------------------------------------------------------------


def rows_in(v):
    return isinstance(v, list) and v and all(isinstance(x, dict) for x in v)


def is_record(v):
    """Whether an object holds tables, and so is a measurement of its own."""
    nested = any(rows_in(x) for x in v.values())
    return nested or (("what" in v or "date" in v) and any(isinstance(x, dict) for x in v.values()))


def flat(row, before=""):
    out = {}
    for name, v in row.items():
        if isinstance(v, dict):
            out.update(flat(v, f"{before}{name}."))
        elif v is not None:
            out[before + name] = v
    return out


def take_commit(record, text):
    """A commit, and what else was said of it."""
    found = re.findall(r"[0-9a-f]{7,40}", text)
    if found:
        record["commit"] = found[0]
    if [text] != found:
        record["note"] = f"commit: {text}. {record.get('note', '')}".strip()


def records_of(raw, name, known):
    record = {"name": name} if name else {}
    machine = dict(known.get("machine", {}))
    settings, tables, inner = {}, {}, []
    for key in TEXTS:
        if key in raw and key != "commit" and raw[key] != "":
            record[key] = raw[key]
    if raw.get("commit"):
        take_commit(record, raw["commit"])
    for key, v in raw.items():
        if key in TEXTS or v in ("", [], {}):
            continue
        if key in ("command", "commands"):
            record["command"] = v
        elif key == "machine" and isinstance(v, dict):
            machine.update({k: x for k, x in v.items() if k != "date"})
            record.setdefault("date", v.get("date", known.get("date")))
        elif key in MACHINE and not isinstance(v, (dict, list)):
            machine[key] = v
        elif is_value(v):
            settings[key] = v
        elif rows_in(v) and not any(is_record(x) for x in v):
            tables[key] = [flat(x) for x in v]
        elif rows_in(v):
            inner += [(f"{key} {i + 1}", x) for i, x in enumerate(v)]
        elif isinstance(v, dict) and is_record(v) and not all(rows_in(x) for x in v.values()):
            inner.append((key, v))
        elif isinstance(v, dict) and all(rows_in(x) for x in v.values()):
            tables[key] = [{"name": k, **flat(x)} for k, rows in v.items() for x in rows]
        elif isinstance(v, dict) and all(isinstance(x, dict) for x in v.values()):
            tables[key] = [{"name": k, **flat(x)} for k, x in v.items()]
        elif isinstance(v, dict):
            tables[key] = [flat(v)]
        else:
            raise SystemExit(f"results.py: {key!r} is neither a value nor a table: {v!r}"[:200])
    for key in ("date", "commit"):
        if key not in record and key in known:
            record[key] = known[key]
    if machine:
        record["machine"] = machine
    if settings:
        record["settings"] = settings
    if tables:
        record["tables"] = tables
    own = {k: record[k] for k in ("date", "commit", "machine") if k in record}
    out = [record] if settings or tables or "note" in record or not inner else []
    for key, v in inner:
        out += records_of(v, f"{name}, {key}" if name else key, own)
    return out


def shaped(raw, what=None, date=None, commit=None):
    raw = dict(raw)
    sentence = what or raw.pop("what", None)
    raw.pop("what", None)
    if not sentence:
        raise SystemExit("results.py: --what says what was measured")
    known = {k: v for k, v in (("date", date), ("commit", commit)) if v}
    return {"what": sentence, "records": records_of(raw, "", known)}


def numbers(v):
    if isinstance(v, bool):
        return collections.Counter()
    if isinstance(v, (int, float)):
        return collections.Counter([v])
    parts = v.values() if isinstance(v, dict) else v if isinstance(v, list) else ()
    return sum((numbers(x) for x in parts), collections.Counter())


def self_test():
    raw = {
        "what": "a", "date": "2000-01-01", "commit": "0123456 (most)", "gpu": "", "processor": "b", "threads": 2, "image": [1, 2],
        "rows": [{"name": "c", "p50_us": 1.5, "p99_us": None, "counts": {"inliers": 7}}],
        "stages": {"blur": {"items": 3}}, "runs": [{"which": "old", "generated": [{"p50_us": 4}]}],
        "later": {"date": "2000-01-02", "commit": "abcdef0", "rows": [{"p50_us": 5}]}, "totals": {"x": 8, "y": {"z": 9}},
        "by": {"1234567": [{"p50_us": 6}]},
    }
    got = shaped(raw)
    assert not list(faults_of("x", got)), list(faults_of("x", got))
    assert not numbers(raw) - numbers(got), numbers(raw) - numbers(got)
    first, run, later = got["records"]
    assert first["tables"]["rows"] == [{"name": "c", "p50_us": 1.5, "counts.inliers": 7}]
    assert first["tables"]["stages"] == [{"name": "blur", "items": 3}]
    assert first["tables"]["by"] == [{"name": "1234567", "p50_us": 6}]
    assert first["commit"] == "0123456" and "(most)" in first["note"] and first["settings"] == {"image": [1, 2]}
    assert run["name"] == "runs 1" and run["settings"] == {"which": "old"} and run["date"] == "2000-01-01"
    assert later["commit"] == "abcdef0" and later["machine"] == {"processor": "b", "threads": 2}
    for harm in (
        lambda d: d.update(more=1), lambda d: d.update(records=[]), lambda d: d.update(what=""),
        lambda d: d["records"][0].update(date="1.1.2000"), lambda d: d["records"][0].update(commit="head"),
        lambda d: d["records"][0].update(p50_us=1), lambda d: d["records"][0].pop("commit"),
        lambda d: d["records"][0]["tables"].update(empty=[]), lambda d: d["records"][0]["tables"]["rows"].append({}),
        lambda d: d["records"][0]["tables"]["rows"][0].update(counts={"inliers": 7}),
        lambda d: d["records"][0]["tables"]["rows"][0].update(p50_us=float("nan")),
        lambda d: d["records"][0]["tables"]["rows"][0].update(p50_us=None), lambda d: d["records"][0].update(machine="b"),
    ):
        bad = json.loads(json.dumps(got))
        harm(bad)
        assert len(list(faults_of("x", bad))) == 1, list(faults_of("x", bad))
    print("results.py: self-test passed")
    return 0


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="*")
    parser.add_argument("--check", action="store_true")
    parser.add_argument("--self-test", action="store_true")
    parser.add_argument("--what")
    parser.add_argument("--date")
    parser.add_argument("--commit")
    how = parser.parse_args()
    if how.self_test:
        return self_test()
    if how.check:
        paths = [pathlib.Path(f) for f in how.files] or sorted(RESULTS.glob("*.json"))
        faults = check(paths)
        for fault in faults:
            print(fault)
        print(f"results: {len(paths)} files, {len(faults)} faults")
        return 1 if faults else 0
    if len(how.files) != 2:
        parser.error("FILE and NAME.json, or --check")
    raw = json.loads(pathlib.Path(how.files[0]).read_text(encoding="utf-8"))
    made = shaped(raw, how.what, how.date, how.commit)
    lost = numbers(raw) - numbers(made)
    faults = [f"lost: {dict(lost)}"] if lost else list(faults_of(how.files[1], made))
    for fault in faults:
        print(fault, file=sys.stderr)
    if not faults:
        (RESULTS / pathlib.Path(how.files[1]).name).write_text(json.dumps(made, indent=1) + "\n", encoding="utf-8")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
