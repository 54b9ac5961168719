#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Compiles a unit with all stages of a frame against another CUDA toolkit, with clang++ as the CUDA
# compiler: device code for each architecture, assembled by the toolkit's ptxas, and the host half.
# Nothing is run; no GPU is needed. What docs/support.md says was found with it.
#   tests/consumers/other_toolkit.sh VERSION|FOLDER [ARCHITECTURE...]
# VERSION, as 12.6, takes headers, libdevice and ptxas from NVIDIA's Python packages (pip); FOLDER is a
# toolkit. Architectures are sm_72 sm_87 if none is given. CLANG names the compiler (clang++-16).
set -euo pipefail
ft_root=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)
if (($# < 1)); then
  sed -n '3,9s/^# \{0,1\}//p' "$0" >&2
  exit 2
fi
toolkit=$1
shift
architectures=("$@")
if ((${#architectures[@]} == 0)); then architectures=(sm_72 sm_87); fi
clang=${CLANG:-clang++-16}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

# from_packages VERSION FOLDER: puts a toolkit together from the packages
from_packages() {
  local major=${1%%.*} package wheel
  for package in nvcc runtime cccl; do
    pip download -q --no-deps -d "$work/wheels" "nvidia-cuda-$package-cu$major==$1.*"
  done
  mkdir -p "$2/bin" "$2/include" "$2/nvvm/libdevice"
  for wheel in "$work"/wheels/*.whl; do python3 -m zipfile -e "$wheel" "$work/unpacked"; done
  for package in cccl nvcc runtime; do
    cp -r "$work/unpacked/nvidia/cuda_$package/include/." "$2/include"
  done
  cp "$work"/unpacked/nvidia/cuda_nvcc/nvvm/libdevice/* "$2/nvvm/libdevice"
  install -m 755 "$work/unpacked/nvidia/cuda_nvcc/bin/ptxas" "$2/bin"
}
if [[ ! -d $toolkit ]]; then
  from_packages "$toolkit" "$work/toolkit"
  toolkit=$work/toolkit
fi

# CCCL declares variadic functions for the device, which clang++ allows with an option. Packages before
# 12.4 lack the headers of CCCL that have no extension; there FOLDER must be a toolkit.
# clang++ 16 asks for a header of cuRAND, which ft does not use, and libstdc++ 12 uses a word that the
# toolkit defines.
mkdir -p "$work/in_front/bits"
[[ -f $toolkit/include/curand_mtgp32_kernel.h ]] || touch "$work/in_front/curand_mtgp32_kernel.h"
cat >"$work/in_front/bits/shared_ptr_base.h" <<'END'
#pragma push_macro("__noinline__")
#undef __noinline__
#include_next <bits/shared_ptr_base.h>
#pragma pop_macro("__noinline__")
END
cat >"$work/unit.cu" <<'END'
#include "ft/stages.hpp"
using fisheye = ft::kannala_brandt<float>;
using distorted = ft::radtan5<float>;
template class ft::frame_tracker<ft::cuda_exec, ft::rectified_rig>;
template class ft::frame_tracker<ft::cuda_exec, ft::stereo_rig<fisheye, distorted>>;
END

compile() {
  "$clang" -std=c++17 -O3 -Wall -Wextra -Werror -Wno-unknown-cuda-version -Wno-pass-failed -x cuda \
    -Xclang -fcuda-allow-variadic-functions --cuda-path="$toolkit" -isystem "$work/in_front" -isystem "$toolkit/include" \
    -I"$ft_root/include" "$@"
}
for architecture in "${architectures[@]}"; do
  compile --cuda-device-only --cuda-gpu-arch="$architecture" -c "$work/unit.cu" -o "$work/unit.cubin"
  echo "$architecture: device code compiled and assembled"
done
compile --cuda-host-only -c "$work/unit.cu" -o "$work/unit.o"
echo "host half compiled"
