#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
set -euo pipefail
ft_root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
# shellcheck source=scripts/deps.sh
source "$ft_root/scripts/deps.sh"

usage() {
  cat <<EOF
usage: scripts/demo.sh [SEQUENCE_DIR] [options of track_sequence]

Builds ft and tracks a stereo sequence. The first time it installs what is missing (apt-get).
SEQUENCE_DIR is a folder in EuRoC (ASL) or KITTI odometry layout; without it, a sequence is generated, with ground truth.
The GPU is used where there are one and a CUDA toolkit, else the CPU; '--backend host' asks for the CPU.
The programs are built in build-demo/bin, for the CPU alone without a GPU, else for the GPU that is there. The
report is written to build-demo/report, those of later runs to report-2, report-3 ... Ctrl-C ends the tracking with the report of what was tracked.

  scripts/demo.sh
  scripts/demo.sh ~/data/MH_01_easy/mav0
  scripts/demo.sh --backend host
EOF
}

sequence=
case ${1:-} in
  -h | --help) usage; exit 0 ;;
  '' | -*) ;;
  *)
    sequence=$1
    shift
    if [[ ! -d $sequence ]]; then
      echo "ft: no folder '$sequence'" >&2
      exit 2
    fi
    ;;
esac

build=$ft_root/build-demo
report=$build/report
for ((run = 2; ; ++run)); do
  if [[ ! -e $report ]]; then break; fi
  report=$build/report-$run
done

ft_install_missing build
# -O1 takes a quarter off the compiler's time and adds 2 to 5 % to that of a frame on the host.
options=(-DFT_ENABLE_CUDA=OFF -DFT_FAST_COMPILE=ON)
if ! ft_find_nvcc; then
  echo "ft: no CUDA toolkit found, building for the CPU"
else
  gpus=$(ft_gpu_architectures)
  case $gpus in
    '') echo "ft: no GPU found, building for the CPU" ;;
    default) options=(-DFT_ENABLE_CUDA=ON -DFT_FAST_COMPILE=OFF -UFT_CUDA_ARCHITECTURES) ;;
    *) options=(-DFT_ENABLE_CUDA=ON -DFT_FAST_COMPILE=OFF "-DFT_CUDA_ARCHITECTURES=${gpus//$'\n'/;}") ;;
  esac
fi
if [[ ! -x $build/bin/track_sequence ]]; then
  echo "ft: building the programs, $(ft_jobs) compilers at a time, a few minutes, the first time only"
fi
ft_configure "$build" "${options[@]}" -DFT_BUILD_EXAMPLES=ON -DFT_BUILD_TESTS=OFF -DFT_BUILD_BENCH=OFF \
  -DFT_LIBRARY_DESCRIPTORS=OFF
ft_start_pulse building
trap ft_stop_pulse EXIT
cmake --build "$build" --parallel "$(ft_jobs)" --target track_sequence generate_sequence
ft_stop_pulse

if [[ -z $sequence ]]; then
  sequence=$build/sequence
  if [[ ! -f $sequence/.complete ]]; then
    rm -rf "$sequence"
    "$build/bin/generate_sequence" --out "$sequence"
    touch "$sequence/.complete"
  fi
fi

# What the caller says goes before what the demo would say.
given=" $* "
defaults=()
if [[ $given != *" --backend"* ]]; then defaults+=(--backend auto); fi
if [[ $given != *" --out"* ]]; then defaults+=(--out "$report"); fi
# Status 3: stopped early, and the report is there. Ctrl-C reaches this shell, too: it waits for the program.
status=0
trap : INT
"$build/bin/track_sequence" "$sequence" "${defaults[@]}" "$@" || status=$?
trap - INT
if [[ $status != 0 && $status != 3 ]]; then exit "$status"; fi

if [[ $given != *" --out"* ]]; then
  printf '\nThe report is in %s\n' "$report"
  ls -1 "$report" | sed 's/^/  /'
fi
exit "$status"
