#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Checks which part of ft includes which, and where kernels are launched.

    types <- core <- math, cameras, descriptors <- containers <- kernels <- pipelines <- everything outside include/ft
    types, core, descriptors, containers <- interop
    types <- any_odometry.hpp <- pipelines

Headers of types/ include core/config.hpp besides: what they hold has one name in every compiler.

A folder detail/ belongs to its room; the one of core is open to all of include/ft. The room math is internal as a
whole. Outside include/ft only tests include what is internal. Violations are printed
as file:line; the exit status is 1 if there are any. --self-test checks the checker.
"""

import argparse
import re
import sys
import tempfile
from pathlib import Path

# What the headers of a room may include, besides the version.
ALLOWED_ROOMS = {
    "types": {"types"},
    "core": {"types", "core"},
    "math": {"types", "core", "math"},
    "cameras": {"types", "core", "cameras"},
    "descriptors": {"types", "core", "descriptors"},
    "containers": {"types", "core", "descriptors", "containers"},
    "kernels": {"types", "core", "math", "cameras", "descriptors", "containers", "kernels"},
    "seam": {"types"},
    "pipelines": {"types", "core", "math", "cameras", "descriptors", "containers", "kernels", "seam", "pipelines"},
    "interop": {"types", "core", "descriptors", "containers", "interop"},
}
CONFIG = "ft/core/config.hpp"  # macros, open to all
SEAM = "ft/any_odometry.hpp"
UMBRELLA = "ft/stages.hpp"
START = "ft/ft.hpp"  # what most programs need; the rest of the umbrella is the stages
START_ROOMS = {"types", "seam", "cameras", "pipelines"}
VERSION = "ft/version.hpp"

# Third parties that one header alone may include.
GUARDED = {
    "OpenCV": (re.compile(r"opencv2?/"), "ft/interop/opencv.hpp"),
    "Thrust": (re.compile(r"thrust/"), "ft/interop/thrust.hpp"),
    "Eigen": (re.compile(r"(Eigen|unsupported/Eigen|eigen3)/"), "ft/interop/eigen.hpp"),
    "vector instructions": (re.compile(r"(?!emm)\w+intrin\.h|arm_\w+\.h"), "ft/core/detail/host_simd.hpp"),
    "SSE2": (re.compile(r"emmintrin\.h"), "ft/core/arithmetic.hpp"),  # one rounding; cheap to include
}
FORBIDDEN = {
    "CUB": re.compile(r"cub/"),  # with libcu++ six seconds of nvcc's time a unit
    "libcu++": re.compile(r"cuda/"),
    "the support library": re.compile(r"examples/sequence/"),
    "an example": re.compile(r"examples/(?!sequence/)"),
    "a test": re.compile(r"(tests|bench|gtest|gmock|benchmark)/"),
}
OUTSIDE = ("examples", "tests", "bench", "integration")
SUFFIXES = {".hpp", ".h", ".cpp", ".cu", ".cuh", ".inl", ".inc"}

INCLUDE = re.compile(r'^\s*#\s*include\s*([<"])([^>"]+)[>"]')
COMMENT_OR_STRING = re.compile(
    r'//[^\n]*|/\*.*?\*/|"(?:\\.|[^"\\\n])*"|\'(?:\\.|[^\'\\\n])\'', re.DOTALL
)


def blank(match):
    """Keeps strings, which includes need, and the line count of comments."""
    text = match.group(0)
    return text if text[0] in "\"'" else "\n" * text.count("\n")


def code_lines(path):
    text = path.read_text(encoding="utf-8", errors="replace")
    return COMMENT_OR_STRING.sub(blank, text).split("\n")


def room_of(header):
    """'ft/core/detail/x.hpp' -> 'core'; None for the umbrellas and the version."""
    if header == SEAM:
        return "seam"
    parts = header.split("/")
    return parts[1] if len(parts) > 2 else None


class Checker:
    def __init__(self, root):
        self.root = root
        self.include_dir = root / "include"
        self.violations = []
        self.launches = {}  # header -> first line with <<<
        self.includes = {}  # header -> the headers of ft that it includes

    def report(self, path, line, message):
        self.violations.append(f"{path.relative_to(self.root)}:{line}: {message}")

    def check(self):
        headers = sorted(p for p in self.include_dir.rglob("*") if p.suffix in SUFFIXES)
        for path in headers:
            self.check_header(path)
        for folder in OUTSIDE:
            for path in sorted((self.root / folder).rglob("*")):
                if path.suffix in SUFFIXES:
                    self.check_outside(path)
        for path, line in sorted(self.launches.items())[1:]:
            first = sorted(self.launches)[0].relative_to(self.root)
            self.report(path, line, f"launches a kernel; {first} is where that is done")
        self.check_umbrella(headers)
        return self.violations

    def check_header(self, path):
        name = path.relative_to(self.include_dir).as_posix()
        room = room_of(name)
        if room is not None and room not in ALLOWED_ROOMS:
            self.report(path, 1, f"'{room}' is not a room of ft")
            return
        for number, line in enumerate(code_lines(path), 1):
            if "<<<" in line:
                self.launches.setdefault(path, number)
            match = INCLUDE.match(line)
            if match:
                self.check_include(path, number, name, room, *match.groups())

    def check_include(self, path, number, name, room, bracket, target):
        for party, (pattern, home) in GUARDED.items():
            if pattern.match(target):
                if name != home:
                    self.report(path, number, f"includes {party}, which only {home} may")
                return
        for party, pattern in FORBIDDEN.items():
            if pattern.match(target):
                self.report(path, number, f"includes {party} ({target})")
                return
        if bracket == '"' and not target.startswith("ft/"):
            self.report(path, number, f'"{target}" does not start with "ft/"')
        if not target.startswith("ft/"):
            return
        if not (self.include_dir / target).is_file():
            self.report(path, number, f"there is no {target}")
        self.includes.setdefault(name, set()).add(target)
        if name == START:
            if room_of(target) not in START_ROOMS and target not in (VERSION, "ft/core/execution.hpp"):
                self.report(path, number, f"{target} belongs in {UMBRELLA}")
            elif "/detail/" in target:
                self.report(path, number, f"{target} is internal")
        elif name == UMBRELLA:
            if "/detail/" in target or target.startswith(("ft/interop/", "ft/math/")):
                self.report(path, number, f"{target} does not belong in the umbrella")
        elif target in (UMBRELLA, START):
            self.report(path, number, "includes the umbrella")
        elif target not in (VERSION, CONFIG):
            self.check_direction(path, number, room, target)

    def check_direction(self, path, number, room, target):
        to = room_of(target)
        if room is None or to is None:
            self.report(path, number, f"includes {target}")
        elif to not in ALLOWED_ROOMS[room]:
            self.report(path, number, f"{room} may not include {to} ({target})")
        elif "/detail/" in target and to not in (room, "core"):
            self.report(path, number, f"{target} belongs to {to} alone")

    def check_outside(self, path):
        parts = path.relative_to(self.root).parts
        support = parts[:2] == ("examples", "sequence")
        support_tests = parts[:2] == ("tests", "examples")
        for number, line in enumerate(code_lines(path), 1):
            match = INCLUDE.match(line)
            if not match:
                continue
            target = match.group(2)
            if parts[0] != "tests" and re.match(r"ft/(math/|.*/detail/)", target):
                self.report(path, number, f"{target} is not API")
            elif target.startswith("examples/sequence/detail/") and not (support or support_tests):
                self.report(path, number, f"{target} is not API")
            elif support and re.match(r"(examples/(?!sequence/)|tests/|bench/)", target):
                self.report(path, number, f"the support library may not include {target}")

    def check_umbrella(self, headers):
        umbrella = self.include_dir / UMBRELLA
        if not umbrella.is_file():
            return
        reached, waiting = set(), [UMBRELLA]
        while waiting:
            name = waiting.pop()
            if name not in reached:
                reached.add(name)
                waiting.extend(self.includes.get(name, ()))
        for path in headers:
            name = path.relative_to(self.include_dir).as_posix()
            room = room_of(name)
            public = name == VERSION or room in ALLOWED_ROOMS.keys() - {"interop", "math"}
            if public and "/detail/" not in name and name not in reached:
                self.report(umbrella, 1, f"does not reach {name}")


# --- self-test -------------------------------------------------------------------------------------

CLEAN = {
    "include/ft/ft.hpp": "\n".join(
        f'#include "ft/{name}"'
        for name in ("version.hpp", "types/pose.hpp", "cameras/pinhole.hpp", "pipelines/tracker.hpp")
    ),
    "include/ft/stages.hpp": "\n".join(
        f'#include "ft/{name}"' for name in ("ft.hpp", "core/launch.hpp", "containers/soa.hpp")
    ),
    "include/ft/version.hpp": "#pragma once",
    "include/ft/core/config.hpp": "#pragma once",
    "include/ft/types/pose.hpp": '#include "ft/core/config.hpp"',
    "include/ft/core/math.hpp": "#include \"ft/types/pose.hpp\"\n#include <cmath>\n// kernel<<<1, 1>>>(); in a comment is no launch",
    "include/ft/core/detail/bits.hpp": '#include "ft/core/math.hpp"',
    "include/ft/math/so3.hpp": '#include "ft/core/math.hpp"',
    "include/ft/core/launch.hpp": '#include "ft/core/detail/bits.hpp"\nvoid f() { k<<<1, 1>>>(); }',
    "include/ft/cameras/pinhole.hpp": '#include "ft/core/math.hpp"',
    "include/ft/containers/soa.hpp": '#include "ft/core/detail/bits.hpp"',
    "include/ft/kernels/blur.hpp": '#include "ft/kernels/detail/row.hpp"',
    "include/ft/kernels/detail/row.hpp": '#include "ft/cameras/pinhole.hpp"',
    "include/ft/pipelines/tracker.hpp": '#include "ft/kernels/blur.hpp"\n#include "ft/version.hpp"',
    "include/ft/interop/opencv.hpp": '#include <opencv2/core.hpp>\n#include "ft/containers/soa.hpp"',
    "include/ft/interop/thrust.hpp": "#include <thrust/sort.h>",
    "include/ft/interop/eigen.hpp": "#include <Eigen/Geometry>",
    "examples/sequence/reader.cpp": '#include "examples/sequence/detail/text.hpp"\n#include <Eigen/Core>',
    "tests/kernels/blur_test.cpp": '#include "ft/math/so3.hpp"\n#include "ft/kernels/detail/row.hpp"\n#include "ft/ft.hpp"\n#include "ft/kernels/blur.hpp"',
    "tests/examples/text_test.cpp": '#include "examples/sequence/detail/text.hpp"',
}

# file, a line added to it, what the checker must say and where
VIOLATIONS = [
    ("include/ft/types/pose.hpp", '#include "ft/core/math.hpp"', "types may not include core"),
    ("include/ft/types/pose.hpp", '#include "ft/core/detail/bits.hpp"', "types may not include core"),
    ("include/ft/core/math.hpp", '#include "ft/cameras/pinhole.hpp"', "core may not include cameras"),
    ("include/ft/core/math.hpp", '  #  include "ft/kernels/blur.hpp"', "core may not include kernels"),
    ("include/ft/core/math.hpp", "#include <ft/pipelines/tracker.hpp>", "core may not include pipe"),
    ("include/ft/core/math.hpp", '#include "ft/ft.hpp"', "includes the umbrella"),
    ("include/ft/core/math.hpp", '#include "ft/stages.hpp"', "includes the umbrella"),
    ("include/ft/ft.hpp", '#include "ft/kernels/blur.hpp"', "belongs in ft/stages.hpp"),
    ("include/ft/core/math.hpp", '#include "detail/bits.hpp"', "does not start with"),
    ("include/ft/core/math.hpp", '#include "ft/core/nowhere.hpp"', "there is no"),
    ("include/ft/core/math.hpp", "#include <Eigen/Core>", "includes Eigen"),
    ("include/ft/core/math.hpp", "void g() { k<<<2, 2>>>(); }", "launches a kernel"),
    ("include/ft/math/so3.hpp", '#include "ft/kernels/blur.hpp"', "math may not include kernels"),
    ("include/ft/math/so3.hpp", '#include "ft/cameras/pinhole.hpp"', "math may not include cameras"),
    ("include/ft/core/math.hpp", '#include "ft/math/so3.hpp"', "core may not include math"),
    ("include/ft/cameras/pinhole.hpp", '#include "ft/math/so3.hpp"', "cameras may not include math"),
    ("include/ft/version.hpp", '#include "ft/core/math.hpp"', "includes ft/core/math.hpp"),
    ("include/ft/cameras/pinhole.hpp", '#include "ft/containers/soa.hpp"', "cameras may not include"),
    ("include/ft/containers/soa.hpp", '#include "ft/cameras/pinhole.hpp"', "containers may not"),
    ("include/ft/containers/soa.hpp", "#include <thrust/sort.h>", "includes Thrust"),
    ("include/ft/kernels/blur.hpp", "#include <cub/warp/warp_scan.cuh>", "includes CUB"),
    ("include/ft/core/math.hpp", "#include <cuda/atomic>", "includes libcu++"),
    ("include/ft/kernels/blur.hpp", "#include <immintrin.h>", "includes vector instructions"),
    ("include/ft/kernels/blur.hpp", "#include <emmintrin.h>", "includes SSE2"),
    ("include/ft/kernels/blur.hpp", '#include "ft/pipelines/tracker.hpp"', "kernels may not include"),
    ("include/ft/kernels/blur.hpp", "#include <opencv2/core.hpp>", "includes OpenCV"),
    ("include/ft/kernels/detail/row.hpp", '#include "examples/sequence/reader.hpp"', "the support library"),
    ("include/ft/pipelines/tracker.hpp", '#include "ft/kernels/detail/row.hpp"', "belongs to kernels"),
    ("include/ft/pipelines/tracker.hpp", '#include "ft/interop/opencv.hpp"', "may not include interop"),
    ("include/ft/interop/thrust.hpp", '#include "ft/kernels/blur.hpp"', "interop may not include"),
    ("include/ft/interop/thrust.hpp", "#include <opencv2/core.hpp>", "includes OpenCV"),
    ("include/ft/stages.hpp", '#include "ft/interop/opencv.hpp"', "does not belong in the umbrella"),
    ("include/ft/stages.hpp", '#include "ft/core/detail/bits.hpp"', "does not belong in the umbrella"),
    ("include/ft/stages.hpp", '#include "ft/math/so3.hpp"', "does not belong in the umbrella"),
    ("bench/blur.cu", '#include "ft/math/so3.hpp"', "is not API"),
    ("include/ft/tools/extra.hpp", "", "is not a room"),
    ("include/ft/core/forgotten.hpp", "", "does not reach ft/core/forgotten.hpp"),
    ("examples/track/main.cpp", '#include "ft/core/detail/bits.hpp"', "is not API"),
    ("integration/orbslam3/shim.hpp", "#include <ft/kernels/detail/row.hpp>", "is not API"),
    ("bench/blur.cu", '#include "examples/sequence/detail/text.hpp"', "is not API"),
    ("examples/sequence/reader.cpp", '#include "tests/support/data.hpp"', "may not include tests/"),
]


def run_on(files):
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        for name, text in files.items():
            path = root / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text + "\n", encoding="utf-8")
        return Checker(root).check()


def self_test():
    failures = []
    found = run_on(CLEAN)
    if found:
        failures.append("reported in a clean tree:\n  " + "\n  ".join(found))
    for name, added, expected in VIOLATIONS:
        text = CLEAN.get(name, "// new")
        line = text.count("\n") + 2 if added else 1
        found = run_on({**CLEAN, name: f"{text}\n{added}" if added else text})
        where = "include/ft/stages.hpp:1" if "forgotten" in name else f"{name}:{line}"
        if not any(v.startswith(where + ":") and expected in v for v in found):
            failures.append(f"missed in {where}: {added or '(the file)'}; found: {found}")
        if len(found) != 1:
            failures.append(f"expected one violation for {added or name}, found: {found}")
    for failure in failures:
        print(failure, file=sys.stderr)
    print(f"self-test: {len(VIOLATIONS)} violations planted, {len(failures)} failures")
    return 1 if failures else 0


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--self-test", action="store_true", help="check the checker")
    parser.add_argument("--root", type=Path, default=Path(__file__).resolve().parents[2])
    arguments = parser.parse_args()
    if arguments.self_test:
        return self_test()
    violations = Checker(arguments.root.resolve()).check()
    for violation in violations:
        print(violation)
    print(f"include directions: {len(violations)} violations")
    return 1 if violations else 0


if __name__ == "__main__":
    sys.exit(main())
