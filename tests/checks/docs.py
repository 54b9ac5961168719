#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Checks the Markdown pages: what they link to inside the repository exists, headings included, and every C++ snippet of
README.md, CONTRIBUTING.md and docs/ stands, line by line, in a source file that is compiled."""

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


def main():
    problems = []
    compiled = sources()
    quoting = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
    if compiled:  # not in an archive without git
        for page in quoting:
            for first in unknown_snippets(page, compiled):
                problems.append(f"{page.relative_to(ROOT)}: the snippet that begins with '{first}' is in no source file")
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
