#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Runs ctest with a counter, for scripts/test.sh:

    scripts/run_ctest.py NAME BUILD_DIR SUMMARY OPTION...

Options are ctest's. One of its tests can be a part of a program of many (FT_TEST_SHARDS). Says every few seconds how
many have ended, and at the end which failed by their own names, with what their program said. The whole output is in
BUILD_DIR/ctest-NAME.log; a closing line is appended to the file SUMMARY.
"""
import re
import subprocess
import sys
import time

seconds_between_counts = 10


class program:
    """One of ctest's tests while it runs."""

    def __init__(self):
        self.lines = []  # what it says, less those of tests that have passed
        self.tests = 0
        self.failed = 0
        self.running = None  # the GoogleTest test, and its first line
        self.first = 0


class counter:
    """Of ctest's verbose output: lines `NUMBER: what the program says`, and one for each that ends."""

    said = re.compile(r"^ *(\d+): (.*)$")
    ended = re.compile(r"^ *(\d+/\d+) Test +#(\d+): (\S+) \.*(.*)$")
    own_start = re.compile(r"^\[ RUN +\] (\S+)")
    own_end = re.compile(r"^\[ +(OK|FAILED|SKIPPED) +\] (\S+\.[^\s,]+).* \(\d+ ms\)$")

    def __init__(self):
        self.programs_ended = "0"  # of all
        self.tests = 0
        self.skipped = 0
        self.failed = []
        self.running = {}

    def program_says(self, number, text):
        it = self.running.setdefault(number, program())
        start = self.own_start.match(text)
        if start:
            it.running, it.first = start[1], len(it.lines)
        it.lines.append(text)
        end = self.own_end.match(text)
        if not end:
            return
        it.running = None
        it.tests += 1
        self.tests += 1
        self.skipped += end[1] == "SKIPPED"
        if end[1] == "FAILED":
            it.failed += 1
            self.failed.append(end[2])
        else:
            del it.lines[it.first :]

    def program_ends(self, which, number, name, how):
        self.programs_ended = which
        it = self.running.pop(number, program())
        passed = "Passed" in how or "Skipped" in how
        if it.tests == 0 and it.running is None:
            self.tests += 1
            self.skipped += "Skipped" in how
        if passed:
            return
        print("\n".join(it.lines))
        print(f"{which} {name}: {how.strip()}", flush=True)
        if it.running is not None:
            self.failed.append(f"{it.running} (did not end)")
        elif it.failed == 0:
            self.failed.append(name)

    def read(self, line):
        said = self.said.match(line)
        ended = self.ended.match(line)
        if said:
            self.program_says(said[1], said[2])
        elif ended:
            self.program_ends(ended[1], ended[2], ended[3], ended[4])

    def __str__(self):
        return f"{self.tests} tests, {self.programs_ended} programs"


def main():
    name, folder, summary, *options = sys.argv[1:]
    command = ["ctest", "--test-dir", folder, "--verbose", "--no-tests=error", *options]
    count = counter()
    last = time.monotonic()
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace")
    with open(f"{folder}/ctest-{name}.log", "w", encoding="utf-8") as log:
        for line in process.stdout:
            log.write(line)
            count.read(line.rstrip("\n"))
            if time.monotonic() - last > seconds_between_counts:
                last = time.monotonic()
                print(f"  {count}", flush=True)
    status = process.wait()
    print(f"  {count}")
    if status != 0 and not count.failed:
        count.failed.append(f"ctest ended with {status}, see {folder}/ctest-{name}.log")
    for test in count.failed:
        print(f"failed: {test}")
    with open(summary, "a", encoding="utf-8") as file:
        failed = len(count.failed)
        passed = max(count.tests - failed - count.skipped, 0)
        file.write(f"{name}: {passed} passed, {failed} failed, {count.skipped} skipped\n")
    return status


if __name__ == "__main__":
    sys.exit(main())
