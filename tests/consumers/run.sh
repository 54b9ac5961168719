#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Uses ft as strangers do: installed, as a subdirectory, fetched, as plain headers without CMake, by
# pkg-config, by the recipes of cmake/packaging/; in C++17 and C++20, in several units and shared libraries.
#   tests/consumers/run.sh [BUILD_DIR]
# BUILD_DIR (default build) is a configured build of ft, which is installed from there into a temporary
# prefix. With nvcc each consumer is built as CUDA as well; without a GPU the CUDA programs use none.
# The example project of docs/extending.md is one of them; it needs GoogleTest. As many at a time as
# FT_JOBS says.
set -euo pipefail
ft_root=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)
# shellcheck source=scripts/deps.sh
source "$ft_root/scripts/deps.sh"

build=$(cd "${1:-$ft_root/build}" && pwd)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
consumers=$ft_root/tests/consumers
cuda=OFF
if ft_find_nvcc; then cuda=ON; fi
# What is asked here is whether it builds, links and runs: the host's half is not optimised, and without a GPU device
# code is only compiled, to PTX. CUDA 12.9 and newer have --Ofast-compile.
fast=
host_flags="-O0 -DNDEBUG"
if grep -q '^FT_FAST_COMPILE:BOOL=ON' "$build/CMakeCache.txt" && grep -q '^FT_HAS_WIDE_VECTORS:.*=1' "$build/CMakeCache.txt"; then
  host_flags+=" -mavx2 -mpopcnt -DEIGEN_MAX_ALIGN_BYTES=16"  # as the library: stages once, for this processor
fi
architecture=90
if [[ $cuda == ON ]] && ! nvidia-smi -L 2>/dev/null | grep -q '^GPU'; then
  architecture=90-virtual
  if nvcc --help | grep -q -- --Ofast-compile; then fast=--Ofast-compile=max; fi
fi

heading() { printf -- '-- consumer: %s\n' "$*"; }

# run PROGRAM [ARGUMENT...]: the program, and that it says which version it was built with
run() { "$@" | tee "$work/out" && grep -q '^ft [0-9]' "$work/out"; }

# quietly COMMAND...: its output is shown where it fails
quietly() { "$@" >"$work/log" 2>&1 || { cat "$work/log"; return 1; }; }

# build_project SOURCE DIR CONFIGURE_OPTION...
build_project() {
  quietly cmake -S "$1" -B "$2" -DCMAKE_BUILD_TYPE=Release -DCMAKE_CUDA_ARCHITECTURES=$architecture \
    -DCMAKE_CXX_FLAGS_RELEASE="$host_flags" -DCMAKE_CUDA_FLAGS_RELEASE="-O0 -DNDEBUG" "${@:3}"
  quietly cmake --build "$2"
}

# tests_of DIR: runs them, and says how many there were
tests_of() {
  quietly ctest --test-dir "$1" --output-on-failure --no-tests=error
  grep -E '^[0-9]+% tests passed, ' "$work/log"
}

# cmake_consumer NAME OFF|LINKED|ON STANDARD CONFIGURE_OPTION...
# CMake 3.25 does not know nvcc's option for C++20, so it is given as a flag.
cmake_consumer() {
  local name=$1 language=$2 standard=$3 dir
  heading "$name, CONSUMER_CUDA=$language, C++$standard"
  dir=$(mktemp -d "$work/$name-XXXX")
  build_project "$consumers/$name" "$dir" -DCONSUMER_CUDA="$language" \
    -DCMAKE_CXX_STANDARD="$standard" -DCMAKE_CUDA_FLAGS="-std=c++$standard $fast" "${@:4}"
  run "$dir/consumer"
  local -A year=([17]=201703 [20]=202002)
  grep -q "C++ ${year[$standard]}" "$work/out"
}

# several_units CONFIGURE_OPTION...: two units in a program, two shared libraries in a process
several_units() {
  heading "several_units, CONSUMER_CUDA=$cuda"
  build_project "$consumers/several_units" "$work/several_units" -DCONSUMER_CUDA="$cuda" -DCMAKE_CUDA_FLAGS="$fast" "$@"
  tests_of "$work/several_units"
}

# example NAME CONFIGURE_OPTION...: examples/new_camera_model, with the contract on its model
example() {
  local dir=$work/new_camera_model-$1
  heading "examples/new_camera_model, $1"
  build_project "$ft_root/examples/new_camera_model" "$dir" "${@:2}"
  tests_of "$dir"
  run "$dir/stereo_depth"
}

plain_include() {
  heading "plain_include, ${CXX:-g++}"
  make --no-print-directory -C "$consumers/plain_include" OUT="$work" FT_INCLUDE="$prefix/include" \
    CXX="${CXX:-g++}" "$work/consumer"
  run "$work/consumer"
}
plain_include_nvcc() {
  heading "plain_include, nvcc"
  make --no-print-directory -C "$consumers/plain_include" OUT="$work" FT_INCLUDE="$prefix/include" \
    "$work/consumer_cuda"
  run "$work/consumer_cuda"
}

by_pkg_config() {
  heading pkg-config
  export PKG_CONFIG_PATH=$prefix/share/pkgconfig${PKG_CONFIG_PATH:+:$PKG_CONFIG_PATH}
  local flags
  read -ra flags <<<"$(pkg-config --cflags --libs ft)"
  "${CXX:-g++}" -std=c++17 -O1 "$consumers/consumer.cpp" "${flags[@]}" -o "$work/consumer_pc"
  run "$work/consumer_pc"
}

compiled_library() {
  heading "library, find_package(ft COMPONENTS odometry)"
  build_project "$consumers/library" "$work/library" -DCMAKE_PREFIX_PATH="$prefix"
  tests_of "$work/library"
  if command -v pkg-config >/dev/null; then
    local flags folder
    folder=$(dirname "$(find "$prefix" -name ft-odometry.pc)")
    read -ra flags <<<"$(PKG_CONFIG_PATH=$folder${PKG_CONFIG_PATH:+:$PKG_CONFIG_PATH} \
      pkg-config --cflags --libs ft-odometry)"
    "${CXX:-g++}" -std=c++17 -O1 "$ft_root/examples/compiled_pose/main.cpp" "${flags[@]}" -o "$work/compiled_pose"
    LD_LIBRARY_PATH=$prefix/lib "$work/compiled_pose"
  fi
}

sequence_library() {
  heading "sequence, find_package(ft COMPONENTS odometry sequence)"
  build_project "$consumers/sequence" "$work/sequence" -DCMAKE_PREFIX_PATH="$prefix"
  tests_of "$work/sequence"
}

components() {
  heading "find_package with components that there are not"
  quietly cmake -DCMAKE_PREFIX_PATH="$prefix" -DOUT="$work/components" -P "$consumers/components.cmake"
}

vcpkg_port() {
  heading "cmake/packaging/vcpkg, its port run by CMake with stand-ins for vcpkg's functions"
  quietly cmake -DPORT="$ft_root/cmake/packaging/vcpkg/ft" -DOUT="$work/vcpkg" \
    -P "$consumers/vcpkg/run_port.cmake"
  cmake_consumer find_package OFF 17 -DCMAKE_PREFIX_PATH="$work/vcpkg/packages"
}

# The dependency is a stand-in for oneTBB's package, so that no package server is needed.
conan_recipe() {
  heading cmake/packaging/conan
  export CONAN_HOME=$work/conan
  quietly conan profile detect
  quietly conan create "$consumers/conan" --no-remote
  quietly conan create "$ft_root/cmake/packaging/conan" --no-remote -s compiler.cppstd=17 \
    -c tools.cmake.cmake_layout:test_folder="$work/conan_test"
  grep '^ft [0-9]' "$work/log"
}

ros2_node() {
  heading "examples/ros2, ROS 2 ${ROS_DISTRO:-}"
  build_project "$ft_root/examples/ros2" "$work/ros2" -DFT_SOURCE_DIR= "-DCMAKE_PREFIX_PATH=$prefix"
  [[ -x $work/ros2/stereo_node ]]
}

# in_own_folder FUNCTION ARGUMENT...: beside others, so with a folder of its own for what it writes
in_own_folder() {
  work=$(mktemp -d "$work/XXXX")
  "$@"
}
consume() { ft_start in_own_folder "$@"; }

heading install
prefix=$work/prefix
quietly cmake --install "$build" --prefix "$prefix"

if [[ $cuda == ON ]]; then
  consume example cuda -DFT_SOURCE_DIR="$ft_root" -DUSE_CUDA=ON -DCMAKE_CUDA_FLAGS="$fast"  # the longest first
fi
consume example host -DCMAKE_PREFIX_PATH="$prefix"
consume several_units -DCMAKE_PREFIX_PATH="$prefix"
# OFF: C++ and ft::ft; LINKED: C++ and ft::cuda, the CUDA language not enabled; ON: CUDA and ft::cuda. An installed ft
# in all modes, with C++20 where C++17 is another consumer's; one in the tree with and without CUDA.
consume cmake_consumer find_package OFF 20 -DCMAKE_PREFIX_PATH="$prefix"
if [[ $cuda == ON ]]; then
  consume cmake_consumer find_package LINKED 17 -DCMAKE_PREFIX_PATH="$prefix"
  consume cmake_consumer find_package ON 20 -DCMAKE_PREFIX_PATH="$prefix"
fi
consume cmake_consumer add_subdirectory "$cuda" 17 -DFT_SOURCE_DIR="$ft_root"
consume cmake_consumer fetch_content OFF 17 -DFT_SOURCE_DIR="$ft_root"
consume cmake_consumer orbslam3 "$cuda" 17 -DCMAKE_PREFIX_PATH="$prefix"
consume plain_include
if [[ $cuda == ON ]]; then consume plain_include_nvcc; fi
if command -v pkg-config >/dev/null; then consume by_pkg_config; fi
if [[ -n $(find "$prefix" -name ftOdometryConfig.cmake) ]]; then
  consume compiled_library
else
  echo "the library ft::odometry is not installed: configure with -DFT_BUILD_LIBRARY=ON"
fi
if [[ -n $(find "$prefix" -name ftSequenceConfig.cmake) && -n $(find "$prefix" -name ftOdometryConfig.cmake) ]]; then
  consume sequence_library
else
  echo "the library ft::sequence is not installed: configure with -DFT_BUILD_SEQUENCE=ON -DFT_BUILD_LIBRARY=ON"
fi
consume components
consume vcpkg_port
if command -v conan >/dev/null; then
  consume conan_recipe
else
  echo "Conan is not installed (pip install conan): cmake/packaging/conan not created here"
fi
# ROS 2 is there where its setup.bash was sourced, or lies where its packages put it.
for setup in /opt/ros/*/setup.bash; do
  if [[ -z ${ROS_VERSION:-} && -f $setup ]]; then
    set +u
    # shellcheck source=/dev/null
    source "$setup"
    set -u
  fi
done
if [[ ${ROS_VERSION:-} == 2 ]]; then
  consume ros2_node
else
  echo "ROS 2 is not installed: the node of examples/ros2 is not compiled; examples_tests has its other half"
fi
ft_wait

heading "packaging: recipes say the version of the headers"
python3 "$ft_root/cmake/packaging/check.py"
