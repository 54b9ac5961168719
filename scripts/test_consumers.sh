#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Uses ft as strangers do: installed, as a subdirectory, and as plain headers without CMake.
#   scripts/test_consumers.sh [BUILD_DIR]
# BUILD_DIR (default build) is a configured build of ft, which is installed from there into a temporary
# prefix. With nvcc each consumer is built as CUDA as well; without a GPU the CUDA programs use none.
# The example project of docs/new_camera_model.md is one of them; it needs GoogleTest.
set -euo pipefail
ft_root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
# shellcheck source=scripts/deps.sh
source "$ft_root/scripts/deps.sh"

build=$(cd "${1:-$ft_root/build}" && pwd)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
consumers=$ft_root/tests/consumers
cuda=OFF
if ft_find_nvcc; then cuda=ON; fi

heading() { printf -- '-- consumer: %s\n' "$*"; }

# run PROGRAM [ARGUMENT...]: the program, and that it says which version it was built with
run() { "$@" | tee "$work/out" && grep -q '^ft [0-9]' "$work/out"; }

cmake_consumer() {
  local name=$1 language=$2
  shift 2
  heading "$name, CONSUMER_CUDA=$language"
  local dir=$work/$name-$language
  cmake -S "$consumers/$name" -B "$dir" -DCMAKE_BUILD_TYPE=Release -DCONSUMER_CUDA="$language" \
    -DCMAKE_CUDA_ARCHITECTURES=90 "$@" >"$work/log" 2>&1 || { cat "$work/log"; return 1; }
  cmake --build "$dir" >"$work/log" 2>&1 || { cat "$work/log"; return 1; }
  run "$dir/consumer"
}

# example NAME CONFIGURE_OPTION...: examples/new_camera_model, with the contract on its model
example() {
  local name=$1
  shift
  heading "examples/new_camera_model, $name"
  local dir=$work/new_camera_model-$name
  cmake -S "$ft_root/examples/new_camera_model" -B "$dir" -DCMAKE_BUILD_TYPE=Release \
    -DCMAKE_CUDA_ARCHITECTURES=90 "$@" >"$work/log" 2>&1 || { cat "$work/log"; return 1; }
  cmake --build "$dir" >"$work/log" 2>&1 || { cat "$work/log"; return 1; }
  ctest --test-dir "$dir" --output-on-failure --no-tests=error >"$work/log" 2>&1 ||
    { cat "$work/log"; return 1; }
  grep -E '^[0-9]+% tests passed, ' "$work/log"
  run "$dir/stereo_depth"
}

heading install
prefix=$work/prefix
cmake --install "$build" --prefix "$prefix" >"$work/log" || { cat "$work/log"; exit 1; }

# OFF: C++ and ft::ft; LINKED: C++ and ft::cuda, the CUDA language not enabled; ON: CUDA and ft::cuda
modes=(OFF)
if [[ $cuda == ON ]]; then modes+=(LINKED ON); fi
for mode in "${modes[@]}"; do
  cmake_consumer find_package "$mode" -DCMAKE_PREFIX_PATH="$prefix"
  cmake_consumer add_subdirectory "$mode" -DFT_SOURCE_DIR="$ft_root"
done

example host -DCMAKE_PREFIX_PATH="$prefix"
if [[ $cuda == ON ]]; then example cuda -DFT_SOURCE_DIR="$ft_root" -DUSE_CUDA=ON; fi

heading "plain_include, ${CXX:-g++}"
make --no-print-directory -C "$consumers/plain_include" OUT="$work" FT_INCLUDE="$prefix/include" \
  CXX="${CXX:-g++}" "$work/consumer"
run "$work/consumer"
if [[ $cuda == ON ]]; then
  heading "plain_include, nvcc"
  make --no-print-directory -C "$consumers/plain_include" OUT="$work" FT_INCLUDE="$prefix/include" \
    "$work/consumer_cuda"
  run "$work/consumer_cuda"
fi

if command -v pkg-config >/dev/null; then
  heading pkg-config
  export PKG_CONFIG_PATH=$prefix/share/pkgconfig${PKG_CONFIG_PATH:+:$PKG_CONFIG_PATH}
  read -ra flags <<<"$(pkg-config --cflags --libs ft)"
  "${CXX:-g++}" -std=c++17 -O1 "$consumers/consumer.cpp" "${flags[@]}" -o "$work/consumer_pc"
  run "$work/consumer_pc"
fi
