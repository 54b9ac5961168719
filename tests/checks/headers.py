#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Has clang++ compile each header alone, twice, so that a missing include or guard shows:

    tests/checks/headers.py [--jobs N]     those of include/ft but interop and core/detail, and the two with which
                                           ORB-SLAM3's files take the rest of integration/orbslam3
    tests/checks/headers.py --self-test

Then those with a constant before those that may have a local variable of the same name, which must not shadow it.

What a header includes is not read again for each: the largest of the headers that it includes unconditionally is
taken precompiled, and that one's was made the same way. So a header still sees nothing but its own includes. One
that fails is compiled again without, and that decides.
"""
import argparse
import re
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

FLAGS = "-std=c++17 -Wall -Wextra -Wpedantic -Wshadow -Wconversion -Werror".split()
ROOT = Path(__file__).resolve().parents[2]
SHIM = ("integration/orbslam3/front_end.hpp", "integration/orbslam3/make_tracker.hpp")
EIGEN = "/usr/include/eigen3"


def plain_includes(path):
    """Headers of ft that `path` includes outside of any #if."""
    depth = 0
    for line in path.read_text(encoding="utf-8").splitlines():
        if re.match(r"\s*#\s*if", line):
            depth += 1
        elif re.match(r"\s*#\s*endif", line):
            depth -= 1
        found = re.match(r'\s*#\s*include "(ft/[^"]+)"', line)
        if found and depth == 0:
            yield found[1]


class checker:
    def __init__(self, include, work):
        self.include, self.work = include, work
        names = [str(p.relative_to(include)) for p in sorted(include.glob("ft/**/*.hpp"))]
        self.headers = [n for n in names if "/core/detail/" not in n and "/interop/" not in n]
        shim = [n for n in SHIM if (include.parent / n).exists()]
        self.includes = {n: [] for n in shim} | {n: [i for i in plain_includes(include / n) if i in names] for n in names}
        self.headers += shim
        self.closure = {}
        self.base = {}
        for name in self.headers:
            candidates = [i for i in self.includes[name] if i in self.headers]
            self.base[name] = max(candidates, key=lambda i: len(self.closure_of(i)), default=None)
        self.is_base = set(self.base.values())
        self.futures = {}
        self.failed = []
        self.said = []

    def closure_of(self, name):
        if name not in self.closure:
            self.closure[name] = {name}
            for other in self.includes[name]:
                self.closure[name] |= self.closure_of(other)
        return self.closure[name]

    def path(self, name, suffix):
        return self.work / (name.replace("/", "+") + suffix)

    def compile(self, name, base):
        unit = self.path(name, ".unit.hpp")
        unit.write_text(f'#include "{name}"\n#include "{name}"\n', encoding="utf-8")
        paths = [f"-I{self.include}", f"-I{self.include.parent}", "-isystem", EIGEN]
        command = ["clang++", *FLAGS, *paths, "-x", "c++-header", str(unit)]
        if base:
            command += ["-include-pch", str(self.path(base, ".pch"))]
        command += ["-o", str(self.path(name, ".pch"))] if name in self.is_base else ["-fsyntax-only"]
        return subprocess.run(command, capture_output=True, text=True, errors="replace")

    def check(self, name):
        base = self.base[name]
        if base and not self.futures[base].result():
            base = None
        result = self.compile(name, base)
        if result.returncode != 0 and base:
            result = self.compile(name, None)
        if result.returncode != 0:
            self.failed.append(name)
            self.said.append(result.stderr)
        return result.returncode == 0

    def namesakes(self):
        """Headers with constants, each with those that may have a variable of the same name."""
        texts = {n: (self.include / n).read_text(encoding="utf-8") for n in self.headers if n not in SHIM}
        codes = {n: re.sub(r"//.*", "", text) for n, text in texts.items()}
        for name, text in texts.items():
            constants = re.findall(r"^inline constexpr [^=({;]*\b(\w+)(?:\[[^]]*\])? *[={]", text, re.M)
            names = "|".join(constants)
            variable = re.compile(rf"(?<!\breturn)(?<=[\w>&*])\s+[&*]*(?:{names})\b\s*(?:=[^=]|[,;){{\[])|,\s*(?:{names})\s*=[^=]")
            others = [n for n in codes if n != name and variable.search(codes[n])] if constants else []
            if others:
                yield name, others

    def check_namesakes(self, pair):
        """A local variable must not shadow a constant of a header that is included before."""
        name, others = pair
        unit = self.path(name, ".before.cpp")
        unit.write_text("".join(f'#include "{n}"\n' for n in [name, *others]), encoding="utf-8")
        command = ["clang++", *FLAGS, f"-I{self.include}", "-isystem", EIGEN, "-fsyntax-only", str(unit)]
        result = subprocess.run(command, capture_output=True, text=True, errors="replace")
        if result.returncode != 0:
            self.failed.append(name)
            self.said.append(result.stderr)

    def run(self, jobs):
        """True where all compile. A header comes after those that it can be based on."""
        done, last = 0, time.monotonic()
        with ThreadPoolExecutor(jobs) as pool:
            for name in sorted(self.headers, key=lambda n: len(self.closure_of(n))):
                self.futures[name] = pool.submit(self.check, name)
            for future in self.futures.values():
                future.result()
                done += 1
                if time.monotonic() - last > 10:
                    last = time.monotonic()
                    print(f"  {done} of {len(self.headers)} headers", flush=True)
            if not self.failed:
                list(pool.map(self.check_namesakes, self.namesakes()))
        return not self.failed


SELF_TEST = {
    "base": "#pragma once\n#include <vector>\ninline std::vector<int> some() { return {}; }\n",
    "good": '#pragma once\n#include "ft/base.hpp"\ninline auto more() { return some(); }\n',
}
BAD = {
    "lacks": '#pragma once\n#include "ft/base.hpp"\ninline std::map<int, int> of() { return {}; }\n',
    "other": '#pragma once\n#if defined(NOWHERE)\n#include "ft/base.hpp"\n#endif\ninline auto a() { return some(); }\n',
    "unguarded": '#include "ft/base.hpp"\nstruct again {};\n',
    "warns": '#pragma once\n#include "ft/good.hpp"\ninline char narrow(int i) { return i; }\n',
    "last": '#pragma once\n#include "ft/warns.hpp"\ninline auto last() { return narrow(int(more().size())); }\n',
}
LOCALS = (
    "inline int local() {\n  int name = 1;\n  return name;\n}\n",
    "inline int local() {\n  int a = 0, name = 1;\n  return a + name;\n}\n",
    "struct some_type {\n  int v;\n};\ninline int local() {\n  some_type name{1};\n  return name.v;\n}\n",
    "inline int local(int name) { return 2 * name; }\n",
)
SHADOWED = "#pragma once\ninline constexpr int name = 2;\n"


def found_in(files):
    with tempfile.TemporaryDirectory() as folder:
        include, work = Path(folder, "include"), Path(folder, "work")
        (include / "ft").mkdir(parents=True)
        work.mkdir()
        for name, text in files.items():
            (include / "ft" / f"{name}.hpp").write_text(text, encoding="utf-8")
        tested = checker(include, work)
        tested.run(2)
        return sorted(Path(n).stem for n in tested.failed)


def self_test():
    good = True
    for files, expected in (
        (SELF_TEST, []),
        (SELF_TEST | BAD, sorted(BAD)),
        *((SELF_TEST | {"a": "#pragma once\n" + local, "b": SHADOWED}, ["b"]) for local in LOCALS),
        *((SELF_TEST | {"a": SHADOWED, "b": "#pragma once\n" + local}, ["a"]) for local in LOCALS),
    ):
        found = found_in(files)
        if found != expected:
            print(f"headers.py finds {found}, not {expected}")
            good = False
    return good


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--self-test", action="store_true")
    arguments = parser.parse_args()
    if arguments.self_test:
        return 0 if self_test() else 1
    with tempfile.TemporaryDirectory() as work:
        all_headers = checker(ROOT / "include", Path(work))
        good = all_headers.run(arguments.jobs)
    print("".join(all_headers.said), end="")
    print(f"{len(all_headers.headers)} headers, {len(all_headers.failed)} failed")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
