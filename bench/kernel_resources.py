#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Registers, shared and local memory, and the threads that fit on a multiprocessor, of each kernel of a
whole frame; no device needed.

By default the two units of the bench with the frames' kernels are compiled for one architecture and
ptxas is asked. With --binary the figures are read by cuobjdump from a program that is there (all its
kernels; cuobjdump does not tell spills from arrays: see the column "stack").
"""
import argparse
import math
import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parent.parent
UNITS = ["bench/cuda_rectified.cu", "bench/cuda_fisheye.cu"]
# Threads, blocks and bytes of shared memory per multiprocessor: CUDA C++ Programming Guide, "Compute
# Capabilities".
SM = {
    "sm_75": (1024, 16, 64),
    "sm_80": (2048, 32, 164),
    "sm_86": (1536, 16, 100),
    "sm_87": (1536, 16, 164),
    "sm_89": (1536, 24, 100),
    "sm_90": (2048, 32, 228),
}


def fail(message):
    print(f"kernel_resources.py: {message}", file=sys.stderr)
    sys.exit(1)


def find_tool(name):
    """On the PATH, else in the usual places of a toolkit."""
    found = shutil.which(name)
    for folder in (os.environ.get("CUDA_HOME"), os.environ.get("CUDA_PATH"), "/usr/local/cuda"):
        if not found and folder:
            found = shutil.which(name, path=os.path.join(folder, "bin"))
    return found


def split_arguments(text):
    """Of what follows '<' up to its '>': the arguments at the first depth."""
    parts, depth, part = [], 0, ""
    for c in text:
        if c in "<(":
            depth += 1
        elif c in ">)":
            if depth == 0:
                break
            depth -= 1
        if c == "," and depth == 0:
            parts.append(part.strip())
            part = ""
        else:
            part += c
    return parts + [part.strip()]


def short_name(demangled):
    """(functor, shape, threads a block) of a kernel of ft; anything else as it is."""
    found = re.search(r"(per_thread|per_warp|per_block)_kernel<", demangled)
    if not found:
        return demangled, "", 0
    arguments = split_arguments(demangled[found.end():])
    number = int(re.sub(r"\D", "", arguments[0]) or 0)
    threads = number * 32 if found[1] == "per_warp" else number
    op = arguments[1].replace("ft::v0_cuda::", "").replace("detail::", "")
    return op, found[1], threads


def threads_per_sm(arch, threads, registers, shared):
    """How many fit at a time: 65536 registers, given to warps in pieces of 256; 1 kB of shared memory per
    block is the system's from sm_80 on. None for an architecture that is not in the table."""
    if arch not in SM or threads == 0:
        return None
    most, most_blocks, kilobytes = SM[arch]
    warps = math.ceil(threads / 32)
    by_registers = 65536 // (math.ceil(max(registers, 1) * 32 / 256) * 256) // warps
    per_block = shared + (1024 if arch != "sm_75" else 0)
    by_shared = kilobytes * 1024 // per_block if per_block else most_blocks
    return min(most // threads, most_blocks, by_registers, by_shared) * threads


def parse_ptxas(text):
    """[(mangled, registers, shared, stack, spilled bytes)] of what `ptxas -v` says."""
    kernels, name, stack, spills = [], None, 0, 0
    for line in text.splitlines():
        m = re.search(r"Compiling entry function '(\S+)'", line)
        if m:
            name, stack, spills = m[1], 0, 0
        m = re.search(r"(\d+) bytes stack frame, (\d+) bytes spill stores", line)
        if m:
            stack, spills = int(m[1]), int(m[2])
        m = re.search(r"Used (\d+) registers", line)
        if m and name:
            shared = re.search(r"(\d+) bytes smem", line)
            kernels.append((name, int(m[1]), int(shared[1]) if shared else 0, stack, spills))
            name = None
    return kernels


def parse_cuobjdump(text, arch):
    kernels, current, name = [], None, None
    for line in text.splitlines():
        m = re.match(r"arch = (\S+)", line.strip())
        if m:
            current = m[1]
        m = re.match(r"\s*Function (\S+):", line)
        if m:
            name = m[1]
        m = re.search(r"REG:(\d+) STACK:(\d+) SHARED:(\d+)", line)
        if m and name and current in (arch, None):
            # For sm_90 cuobjdump counts the system's 1024 bytes with a kernel's own.
            shared = int(m[3]) - (1024 if arch == "sm_90" and int(m[3]) >= 1024 else 0)
            kernels.append((name, int(m[1]), shared, int(m[2]), None))
            name = None
    return kernels


def demangle(names):
    tool = find_tool("cu++filt") or find_tool("c++filt")
    if not tool:
        return names
    done = subprocess.run([tool], input="\n".join(names), capture_output=True, text=True, check=True)
    return done.stdout.splitlines()


def self_test():
    name = "void ft::v0_cuda::detail::per_block_kernel<(int)512, ft::v0_cuda::a<ft::v0_cuda::r, (bool)1>, int>(T2)"
    assert short_name(name) == ("a<r, (bool)1>", "per_block", 512), short_name(name)
    assert short_name("void ft::detail::per_warp_kernel<4, op, int>(int)") == ("op", "per_warp", 128)
    assert short_name("other(int)") == ("other(int)", "", 0)
    assert threads_per_sm("sm_90", 128, 32, 0) == 2048
    assert threads_per_sm("sm_90", 512, 128, 0) == 512
    assert threads_per_sm("sm_90", 128, 32, 100 * 1024) == 256
    assert threads_per_sm("sm_1", 128, 32, 0) is None
    text = """ptxas info    : Compiling entry function '_Zx' for 'sm_90'
    8 bytes stack frame, 4 bytes spill stores, 4 bytes spill loads
ptxas info    : Used 40 registers, used 1 barriers, 8 bytes stack frame, 1088 bytes smem, 5 bytes cmem[0]"""
    assert parse_ptxas(text) == [("_Zx", 40, 1088, 8, 4)]
    text = "Fatbin elf code:\narch = sm_90\n Function _Zy:\n  REG:24 STACK:16 SHARED:1036 LOCAL:0\n"
    assert parse_cuobjdump(text, "sm_90") == [("_Zy", 24, 12, 16, None)]
    assert parse_cuobjdump(text, "sm_75") == []
    print("kernel_resources.py: self-test passed")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--arch", default="sm_90", help="architecture (%(default)s)")
    parser.add_argument("--binary", help="read this program with cuobjdump instead of compiling")
    parser.add_argument("--unit", action="append", help="compile this .cu file instead, from the repository's folder")
    parser.add_argument("--json", help="write the figures to this file, too")
    parser.add_argument("--self-test", action="store_true", help="test this script and nothing else")
    args = parser.parse_args()
    if args.self_test:
        return self_test()
    kernels = []
    if args.binary:
        tool = find_tool("cuobjdump")
        if not tool:
            fail("cuobjdump is not on the PATH; without --binary it is not needed")
        done = subprocess.run([tool, "--dump-resource-usage", args.binary], capture_output=True, text=True)
        if done.returncode:
            fail(f"cuobjdump: {done.stderr.strip()}")
        kernels = parse_cuobjdump(done.stdout + done.stderr, args.arch)
    else:
        nvcc = find_tool("nvcc")
        if not nvcc:
            fail("nvcc is not on the PATH")
        with tempfile.TemporaryDirectory() as folder:
            for unit in args.unit or UNITS:
                done = subprocess.run(
                    [nvcc, "-std=c++17", "-O3", "-DNDEBUG", f"-arch={args.arch}", "-I", str(ROOT / "include"),
                     "-I", str(ROOT), "-Xptxas", "-v", "-cubin", "-o", os.path.join(folder, "unit.cubin"),
                     str(ROOT / unit)], capture_output=True, text=True)
                if done.returncode:
                    fail(f"nvcc {unit}:\n{done.stderr.strip()}")
                kernels += parse_ptxas(done.stderr)
    if not kernels:
        fail(f"no kernels for {args.arch}")
    rows = []
    for (_, registers, shared, stack, spills), name in zip(kernels, demangle([k[0] for k in kernels])):
        op, shape, threads = short_name(name)
        rows.append({"name": op, "shape": shape, "threads": threads, "registers": registers,
                     "shared_bytes": shared, "stack_bytes": stack, "spill_bytes": spills,
                     "threads_per_sm": threads_per_sm(args.arch, threads, registers, shared)})
    unique = {tuple(r.values()): r for r in rows}
    rows = sorted(unique.values(), key=lambda r: (r["name"], r["threads"]))
    print(f"{args.arch}, {SM.get(args.arch, ('?',))[0]} threads per multiprocessor at most; bytes")
    print(f"{'kernel':<72} {'shape':<10} {'threads':>7} {'regs':>5} {'shared':>7} {'stack':>6} {'spills':>6} {'thr./SM':>7}")
    for r in rows:
        show = lambda v: "-" if v is None else v
        print(f"{r['name'][:72]:<72} {r['shape']:<10} {r['threads']:>7} {r['registers']:>5} {r['shared_bytes']:>7} "
              f"{r['stack_bytes']:>6} {show(r['spill_bytes']):>6} {show(r['threads_per_sm']):>7}")
    if args.json:
        import json
        pathlib.Path(args.json).write_text(json.dumps({"arch": args.arch, "kernels": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
