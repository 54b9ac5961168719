#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Checks that the recipes of cmake/packaging/ agree with the sources: versions, fields, files, syntax."""

import ast
import json
import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def header_version():
    text = (ROOT / "include/ft/version.hpp").read_text(encoding="utf-8")
    return ".".join(
        re.search(rf"^#define FT_VERSION_{part} (\d+)$", text, re.MULTILINE).group(1)
        for part in ("MAJOR", "MINOR", "PATCH")
    )


def check_vcpkg(problems):
    port = ROOT / "cmake/packaging/vcpkg/ft"
    manifest = json.loads((port / "vcpkg.json").read_text(encoding="utf-8"))
    if manifest["version"] != header_version():
        problems.append(f"vcpkg.json has version {manifest['version']}, the headers {header_version()}")
    if manifest["name"] != port.name:
        problems.append(f"vcpkg.json names {manifest['name']}, its folder is {port.name}")
    for field in ("description", "license", "dependencies"):
        if not manifest.get(field):
            problems.append(f"vcpkg.json has no {field}")
    helpers = {d["name"] for d in manifest["dependencies"] if isinstance(d, dict) and d.get("host")}
    portfile = (port / "portfile.cmake").read_text(encoding="utf-8")
    for function, helper in (("vcpkg_cmake_configure", "vcpkg-cmake"),
                             ("vcpkg_cmake_config_fixup", "vcpkg-cmake-config")):
        if function in portfile and helper not in helpers:
            problems.append(f"portfile.cmake calls {function}, vcpkg.json does not depend on {helper}")
    if not (port / "usage").is_file():
        problems.append("the vcpkg port has no usage text")


def check_conan(problems):
    for name in ("conanfile.py", "test_package/conanfile.py"):
        path = ROOT / "cmake/packaging/conan" / name
        try:
            ast.parse(path.read_text(encoding="utf-8"), str(path))
        except SyntaxError as error:
            problems.append(f"{name}: {error}")


def main():
    problems = []
    check_vcpkg(problems)
    check_conan(problems)
    for problem in problems:
        print(f"packaging: {problem}", file=sys.stderr)
    print(f"packaging: version {header_version()}, {len(problems)} problems")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
