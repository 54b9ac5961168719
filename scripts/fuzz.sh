#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Builds the fuzzers of tests/fuzz/ with AddressSanitizer and UndefinedBehaviorSanitizer and lets them run, as many
# at a time as FT_JOBS says:
#   scripts/fuzz.sh [SECONDS]     the sum over all of them; 60 without the argument. The images get two shares of
#                                 six: an execution there takes a thousand times as long as elsewhere
# Each begins with tests/fuzz/corpus/NAME and what earlier runs found (build-fuzz/corpus/NAME). It ends with
# an error where a fuzzer finds one; the input is then in build-fuzz/NAME.
# Without a clang++ that has libFuzzer it says so and ends with 77.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
# shellcheck source=scripts/deps.sh
source scripts/deps.sh

seconds=${1:-60}
if ! [[ $seconds =~ ^[1-9][0-9]*$ ]]; then
  echo "usage: scripts/fuzz.sh [SECONDS]" >&2
  exit 2
fi
folder=build-fuzz
fuzzers=(images containers cameras readers files)
# What is left out takes the compiler a quarter of its time; where it leads to a wrong access AddressSanitizer finds it.
flags=(-std=c++17 -O1 -g1 -Iinclude -I. -DFT_SEQUENCE_TIFF=1 -fsanitize=fuzzer,address,undefined,float-cast-overflow
  -fno-sanitize=null,object-size,vptr,pointer-overflow -fno-sanitize-recover=all)
mkdir -p "$folder"

if ! echo 'extern "C" int LLVMFuzzerTestOneInput(unsigned char const*, unsigned long) { return 0; }' |
    clang++ "${flags[@]}" -x c++ - -o "$folder/probe" 2>/dev/null; then
  echo "clang++ with libFuzzer was not found: nothing was fuzzed"
  exit 77
fi

compiler=(clang++)
if command -v ccache >/dev/null; then compiler=(ccache clang++); fi

readers_parts=(examples/sequence/{reader,masks,recording_checks,recording_files,layout,layout_euroc,layout_folder_names,layout_folders,layout_kitti,layout_seven_scenes,layout_times,layout_tum,kitti_raw,ground_truth,imu_recording,stamps,table,calibration,calibration_basalt,calibration_checks,calibration_colmap,calibration_depthai,calibration_euroc,calibration_files,calibration_kalibr,calibration_kitti,calibration_opencv,calibration_orb_slam3,calibration_parts,calibration_realsense,calibration_tum,yaml_file,opencv_xml,trajectory_files,image_io,image_jpeg,image_png,image_raw,image_tiff,lens_projection,rectify,rig_cameras}.cpp)

# One unit: most of what the compiler does for each of them is the headers that they share.
printf '#include "%s"\n' "${readers_parts[@]}" >"$folder/readers_parts.cpp"

object_of() { echo "$folder/$(basename "$1" .cpp).o"; }

# Comparisons of pixels tell the fuzzer nothing, and to record them took half of the time.
compile() {
  local extra=()
  if [[ $1 == tests/fuzz/images_fuzz.cpp ]]; then extra=(-fno-sanitize-coverage=trace-cmp); fi
  "${compiler[@]}" "${flags[@]}" "${extra[@]}" -isystem /usr/include/eigen3 -c "$1" \
    -o "$(object_of "$1")"
}

link() {
  local name=$1 sources=(tests/fuzz/"$1"_fuzz.cpp) libraries=(-ltbb -lpthread) objects=() source
  if [[ $name == readers ]]; then
    sources+=("$folder/readers_parts.cpp")
    libraries=(-lpng -ljpeg -ltiff -lyaml-cpp -lpthread)
  fi
  for source in "${sources[@]}"; do objects+=("$(object_of "$source")"); done
  clang++ "${flags[@]}" "${objects[@]}" -o "$folder/${name}_fuzz" "${libraries[@]}"
}

run() {
  local name=$1 status=0 log=$folder/$1.log
  local shares=1
  if [[ $name == images ]]; then shares=2; fi
  mkdir -p "$folder/$name" "$folder/corpus/$name"
  "$folder/${name}_fuzz" -max_total_time=$((seconds * shares / (${#fuzzers[@]} + 1) + 1)) -max_len=2048 -timeout=20 \
    -rss_limit_mb=2048 -print_final_stats=1 -artifact_prefix="$folder/$name/" \
    "$folder/corpus/$name" "tests/fuzz/corpus/$name" >"$log" 2>&1 || status=$?
  if ((status != 0)); then
    cat "$log" >&2
    return "$status"
  fi
  awk -v name="$name" '/number_of_executed_units/ { runs = $2 } /cov:/ { line = $0 }
    END { match(line, /cov: [0-9]+/)
          printf "%-10s %8d executions, %s\n", name, runs, substr(line, RSTART, RLENGTH) }' "$log"
}

ft_start compile "$folder/readers_parts.cpp"
for source in "${fuzzers[@]/%/_fuzz.cpp}"; do ft_start compile "tests/fuzz/$source"; done
ft_wait
for name in "${fuzzers[@]}"; do ft_start link "$name"; done
ft_wait
for name in "${fuzzers[@]}"; do ft_start run "$name"; done
ft_wait
