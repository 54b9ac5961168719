#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Builds track_sequence and what goes with it, then runs tools/evaluation/evaluate.py, which says what it does: --help.
# With --bin FOLDER it takes the programs there, and neither builds nor installs.
set -euo pipefail
ft_root=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)
# shellcheck source=scripts/deps.sh
source "$ft_root/scripts/deps.sh"

if ! command -v python3 >/dev/null; then
  echo "ft: tools/evaluation/evaluate.sh needs python3" >&2
  exit 1
fi
evaluate=("$ft_root/tools/evaluation/evaluate.py")
given=" $* "
case $given in
  *" -h "* | *" --help "* | *" --self-test "* | *" --bin"*) exec python3 "${evaluate[@]}" "$@" ;;
esac

build=$ft_root/build
targets=(track_sequence generate_sequence)
ft_install_missing build
if [[ $given == *" --mpi"* ]]; then
  targets+=(evaluate_mpi)
  if ! command -v mpicxx >/dev/null; then
    ft_as_root apt-get install -y -qq --no-install-recommends openmpi-bin libopenmpi-dev >/dev/null ||
      { echo "ft: --mpi needs Open MPI: sudo apt-get install openmpi-bin libopenmpi-dev" >&2; exit 1; }
  fi
fi
ft_find_nvcc || echo "ft: no CUDA toolkit found, building for the CPU"

options=(-DFT_BUILD_EXAMPLES=ON)
if [[ ! -f $build/CMakeCache.txt ]]; then options+=(-DFT_BUILD_TESTS=OFF -DFT_BUILD_BENCH=OFF); fi
ft_configure "$build" "${options[@]}" >/dev/null
cmake --build "$build" --parallel "$(ft_jobs)" --target "${targets[@]}"

exec python3 "${evaluate[@]}" "$@"
