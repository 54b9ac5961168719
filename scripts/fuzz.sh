#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Builds the fuzzers of fuzz/ with AddressSanitizer and UndefinedBehaviorSanitizer and lets them run:
#   scripts/fuzz.sh [SECONDS]     of all of them together; 60 without the argument
# Each begins with fuzz/corpus/NAME and what earlier runs found (build-fuzz/corpus/NAME). It ends with
# an error where a fuzzer finds one; the input is then in build-fuzz/NAME.
# Without a clang++ that has libFuzzer it says so and ends with 77.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

seconds=${1:-60}
if ! [[ $seconds =~ ^[1-9][0-9]*$ ]]; then
  echo "usage: scripts/fuzz.sh [SECONDS]" >&2
  exit 2
fi
folder=build-fuzz
fuzzers=(images containers cameras readers)
flags=(-std=c++17 -O2 -g1 -Iinclude -I. -fsanitize=fuzzer,address,undefined,float-cast-overflow
  -fno-sanitize-recover=all)
mkdir -p "$folder"

if ! echo 'extern "C" int LLVMFuzzerTestOneInput(unsigned char const*, unsigned long) { return 0; }' |
    clang++ "${flags[@]}" -x c++ - -o "$folder/probe" 2>/dev/null; then
  echo "clang++ with libFuzzer was not found: nothing was fuzzed"
  exit 77
fi

compiler=(clang++)
if command -v ccache >/dev/null; then compiler=(ccache clang++); fi

build() {
  local name=$1 sources=(fuzz/"$1"_fuzz.cpp) libraries=(-ltbb -lpthread) objects=() source object
  if [[ $name == readers ]]; then
    sources+=(sequence/{reader,calibration,evaluation,image_io,rectify}.cpp)
    libraries=(-lpng -ljpeg -lyaml-cpp -lpthread)
  fi
  for source in "${sources[@]}"; do
    object=$folder/$(basename "$source" .cpp).o
    "${compiler[@]}" "${flags[@]}" -isystem /usr/include/eigen3 -c "$source" -o "$object"
    objects+=("$object")
  done
  clang++ "${flags[@]}" "${objects[@]}" -o "$folder/${name}_fuzz" "${libraries[@]}"
}

run() {
  local name=$1 status=0 log=$folder/$1.log
  mkdir -p "$folder/$name" "$folder/corpus/$name"
  "$folder/${name}_fuzz" -max_total_time=$((seconds / ${#fuzzers[@]} + 1)) -max_len=2048 -timeout=20 \
    -rss_limit_mb=2048 -print_final_stats=1 -artifact_prefix="$folder/$name/" \
    "$folder/corpus/$name" "fuzz/corpus/$name" >"$log" 2>&1 || status=$?
  if ((status != 0)); then
    cat "$log" >&2
    return "$status"
  fi
  awk -v name="$name" '/number_of_executed_units/ { runs = $2 } /cov:/ { line = $0 }
    END { match(line, /cov: [0-9]+/)
          printf "%-10s %8d executions, %s\n", name, runs, substr(line, RSTART, RLENGTH) }' "$log"
}

for name in "${fuzzers[@]}"; do build "$name"; done
for name in "${fuzzers[@]}"; do run "$name"; done
