# SPDX-License-Identifier: Apache-2.0
"""Finds the sequences under a folder, in the layouts that track_sequence reads, or generates some."""
import dataclasses
import hashlib
import os
import pathlib
import shutil
import subprocess


class UsageError(Exception):
    """What the caller has to change; shown without a traceback."""


@dataclasses.dataclass(frozen=True)
class Sequence:
    name: str  # unique among those of one evaluation, and a folder's name
    path: pathlib.Path
    fingerprint: str  # of time stamps, calibration and ground truth: not of where it lies


def is_sequence(folder):
    """EuRoC and TUM-VI: mav0/cam0 and mav0/cam1, or the folder mav0 itself; KITTI: image_0 and image_1."""
    pairs = (("mav0/cam0", "mav0/cam1"), ("cam0", "cam1"), ("image_0", "image_1"))
    return any((folder / left).is_dir() and (folder / right).is_dir() for left, right in pairs)


# Small files that say which sequence it is.
TELLING = (
    "mav0/cam0/data.csv",
    "mav0/cam0/sensor.yaml",
    "mav0/cam1/sensor.yaml",
    "mav0/state_groundtruth_estimate0/data.csv",
    "mav0/mocap0/data.csv",
    "groundtruth.txt",
    "times.txt",
    "calib.txt",
    "poses.txt",
)


def sha256_of(*parts):
    """Of bytes, texts and files, in 12 hexadecimal digits."""
    total = hashlib.sha256()
    for part in parts:
        if isinstance(part, pathlib.Path):
            part = part.read_bytes()
        elif isinstance(part, str):
            part = part.encode()
        total.update(hashlib.sha256(part).digest())
    return total.hexdigest()[:12]


def fingerprint(folder):
    bare = (folder / "cam0").is_dir()  # the folder is the mav0 of another one
    parts = []
    for name in TELLING:
        file = folder / name
        if bare:
            file = folder / name[len("mav0/") :] if name.startswith("mav0/") else folder.parent / name
        if file.is_file():
            parts += [name, file]
    return sha256_of(*parts)


def find_sequences(directory):
    """All sequences at or under the folder, by name; nothing inside one is looked at."""
    directory = pathlib.Path(directory)
    if not directory.is_dir():
        raise UsageError(f"no folder '{directory}'")
    found = []
    for parent, folders, _ in os.walk(directory.resolve(), followlinks=True):
        folder = pathlib.Path(parent)
        if is_sequence(folder):
            folders.clear()
            found.append(Sequence(name_of(folder, directory.resolve()), folder, fingerprint(folder)))
    if not found:
        raise UsageError(
            f"no sequence under '{directory}': neither mav0/cam0 with mav0/cam1 (EuRoC, TUM-VI) nor image_0 with image_1 (KITTI)"
        )
    return sorted(found, key=lambda s: s.name)


def name_of(folder, directory):
    if folder == directory:
        parts = [folder.parent.name if folder.name == "mav0" else folder.name]
    else:
        parts = folder.relative_to(directory).parts
        parts = parts[:-1] if parts[-1] == "mav0" and len(parts) > 1 else parts
    return "-".join(parts).replace(" ", "_")


GENERATED = (("pinhole", 1), ("pinhole", 2), ("fisheye", 1), ("fisheye", 2))


def generate_sequences(program, directory, frames, render=True, rigs_and_seeds=GENERATED):
    """Those that are not there yet, made by this very program, are rendered, or left out; says so."""
    program = pathlib.Path(program)
    folder = pathlib.Path(directory) / f"{sha256_of(program)}-{frames}"
    for rig, seed in rigs_and_seeds:
        out = folder / f"generated_{rig}_{seed}"
        if (out / ".complete").is_file():
            continue
        if not render:
            print(f"{out.name}, {frames} stereo pairs: not generated yet")
            continue
        print(f"generating {out.name}, {frames} stereo pairs", flush=True)
        shutil.rmtree(out, ignore_errors=True)
        command = [program, "--out", out, "--rig", rig, "--seed", seed, "--frames", frames]
        done = subprocess.run([str(c) for c in command], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, check=False)
        if done.returncode != 0:
            raise UsageError(f"{program} failed: {done.stderr.strip()}")
        (out / ".complete").touch()
    if not folder.is_dir():
        raise UsageError("no sequence is generated yet: run it without --list and --tables-only")
    return find_sequences(folder)
