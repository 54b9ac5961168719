#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Checks the Markdown pages: what they link to inside the repository exists, headings included, every C++ snippet of
README.md, CONTRIBUTING.md and docs/ stands, line by line, in a source file that is compiled, and docs/when_it_fails.md has
every warning of include/ft by its name, and no other."""

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")
SNIPPET = re.compile(r"```cpp\n(.*?)```", re.DOTALL)
CODE = re.compile(r"```.*?```|`[^`\n]*`", re.DOTALL)


def anchors(page):
    """The headings of a page as links name them."""
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    names = set()
    for heading in re.findall(r"^#+ (.*)$", text, re.MULTILINE):
        words = re.sub(r"[^\w\- ]", "", heading.strip().lower())
        names.add(words.replace(" ", "-"))
    return names


def pages():
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", "*.md"],
        cwd=ROOT, capture_output=True, text=True, check=False,
    ).stdout.split("\n")
    found = [ROOT / name for name in listed if name]
    return found or [p for p in ROOT.rglob("*.md") if "build" not in p.relative_to(ROOT).parts[0]]


def squeezed(text):
    return [" ".join(line.split()) for line in text.splitlines() if line.strip()]


def sources():
    """The lines of every source file, without white space that does not matter."""
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", "*.cpp", "*.hpp", "*.cu"],
        cwd=ROOT, capture_output=True, text=True, check=False,
    ).stdout.split("\n")
    return ["\n".join(squeezed((ROOT / name).read_text(encoding="utf-8"))) for name in listed if name and (ROOT / name).is_file()]


def unknown_snippets(page, compiled):
    for snippet in SNIPPET.findall(page.read_text(encoding="utf-8")):
        lines = squeezed(snippet)
        if lines and not any("\n".join(lines) in source for source in compiled):
            yield lines[0]


def texts(code):
    """The string literals of code, those in a row as one."""
    return ["".join(re.findall(r'"((?:[^"\\]|\\.)*)"', run)) for run in re.findall(r'(?:"(?:[^"\\]|\\.)*"\s*)+', code)]


def warnings_of(headers):
    """By type, the names that name_of() and explain_imu() give, where not all is well; and the sentences of imu_warnings(),
    each as its texts."""
    well = {"none", "initialized", "at_rest", "integrated", "repeated"}
    names = {}
    for header in headers:
        for kind, body in re.findall(r"name_of\((\w+_(?:reason|warning|status)) \w+\) \{(.*?)\n\}", header, re.DOTALL):
            listed = re.search(r"names\[\] = \{(.*?)\};", body, re.DOTALL)
            names[kind] = [text for text in re.findall(r'"(\w+)"', listed.group(1)) if text not in well]
        for body in re.findall(r"imu_explanation explain_imu\(.*?\n\}", header, re.DOTALL):
            names["imu_explanation"] = re.findall(r'return \{state, "(\w+)"', body)
    sentences = []
    for header in headers:
        function = re.search(r"imu_warnings\(imu_tracking.*?\n\}", header, re.DOTALL)
        for said in re.findall(r"(?:out\.push_back|tell)\(.*?;", function.group(0), re.DOTALL) if function else []:
            if "count" not in said:  # not that of `tell` itself
                sentences.append(texts(said))
    return names, sentences


def texts_of_recordings():
    """What the readers of recordings and the reports of runs say."""
    files = [file for pattern in ("examples/sequence/*.cpp", "python/ft/*.py") for file in ROOT.glob(pattern)]
    return [text for file in files for text in texts(file.read_text(encoding="utf-8"))]


def problems_of_warnings(page, headers, others):
    """What the page lacks, and what it has that is in no header and not in `others`: in the first column of its tables."""
    names, sentences = warnings_of(headers)
    quoted = [name for row in re.findall(r"^\| (`.*?) \|", page, re.MULTILINE) for name in re.findall(r"`([^`]+)`", row)]
    known = {name for kind in names.values() for name in kind}
    for name in sorted(known):
        kinds = [kind for kind, listed in names.items() if name in listed]
        if quoted.count(name) < len(kinds):
            yield f"'{name}' of {', '.join(kinds)} is in {quoted.count(name)} rows"
    for parts in sentences:
        if not any(len(q.split()) > 3 and q in part for q in quoted for part in parts):
            yield f"the sentence '{' ... '.join(parts)}' of imu_warnings() is missing"
    for name in quoted:
        if re.fullmatch(r"\w+", name) and name not in known and not any(name in part for parts in sentences for part in parts):
            yield f"'{name}' is no warning"
        if len(name.split()) > 3 and not any(name in part for parts in [*sentences, others] for part in parts):
            yield f"'{name}' is in no sentence of imu_warnings(), nor of the readers of recordings"


def main():
    problems = []
    compiled = sources()
    quoting = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
    if compiled:  # not in an archive without git
        for page in quoting:
            for first in unknown_snippets(page, compiled):
                problems.append(f"{page.relative_to(ROOT)}: the snippet that begins with '{first}' is in no source file")
    failing = ROOT / "docs" / "when_it_fails.md"
    headers = [header.read_text(encoding="utf-8") for header in sorted((ROOT / "include" / "ft").rglob("*.hpp"))]
    for problem in problems_of_warnings(failing.read_text(encoding="utf-8"), headers, texts_of_recordings()):
        problems.append(f"{failing.relative_to(ROOT)}: {problem}")
    names, _ = warnings_of(headers)
    guide = (ROOT / "docs" / "guide.md").read_text(encoding="utf-8")
    for name in [*names["tracking_warning"], *names["tracking_reason"]]:
        if f"`{name}`" not in guide:
            problems.append(f"docs/guide.md: the warning or reason '{name}' is missing")
    checked = 0
    for page in pages():
        if not page.is_file():
            continue
        text = CODE.sub("", page.read_text(encoding="utf-8"))
        for target in LINK.findall(text):
            if re.match(r"[a-z]+:", target):
                continue
            checked += 1
            name, _, anchor = target.partition("#")
            path = (page.parent / name).resolve() if name else page
            if not path.exists():
                problems.append(f"{page.relative_to(ROOT)}: {target} does not exist")
            elif anchor and path.suffix == ".md" and anchor not in anchors(path):
                problems.append(f"{page.relative_to(ROOT)}: {target} names no heading")
    for problem in problems:
        print(problem, file=sys.stderr)
    print(f"links: {checked} checked, {len(problems)} broken")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
