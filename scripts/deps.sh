#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Installs, with apt-get, what is missing to build ft. Sourced by the other scripts; on its own:
#   scripts/deps.sh [build|python|test]
# After it, `nvcc` is on the PATH where a CUDA toolkit is installed in one of the usual places.

ft_build_packages=(build-essential cmake ninja-build ccache libtbb-dev libeigen3-dev libpng-dev
  libjpeg-dev libtiff-dev libyaml-cpp-dev nlohmann-json3-dev libcli11-dev)
ft_python_packages=(python3 python3-dev python3-venv)
ft_test_packages=("${ft_python_packages[@]}" libgtest-dev libbenchmark-dev libopencv-dev libceres-dev clang pkg-config git)
# Not every release has them; without them the formatting is not checked, the documentation not made, the
# evaluation not tested over MPI.
ft_optional_packages=(clang-format-14 doxygen openmpi-bin libopenmpi-dev)

ft_installed() {
  [[ $(dpkg-query -W -f '${db:Status-Status}' "$1" 2>/dev/null) == installed ]]
}

# ft_missing PACKAGE...: those that are not installed, one a line. A tool that came another way counts.
ft_missing() {
  local package tool
  for package in "$@"; do
    tool=
    case $package in
      cmake | ccache | clang | python3 | pkg-config | git | clang-format-14 | doxygen) tool=$package ;;
      ninja-build) tool=ninja ;;
    esac
    [[ -n $tool ]] && command -v "$tool" >/dev/null && continue
    [[ $package == clang ]] && command -v clang++ >/dev/null && continue
    ft_installed "$package" || echo "$package"
  done
}

ft_as_root() {
  if [[ $(id -u) == 0 ]]; then
    env DEBIAN_FRONTEND=noninteractive "$@"
  elif command -v sudo >/dev/null; then
    sudo env DEBIAN_FRONTEND=noninteractive "$@"
  else
    echo "ft: not root, and there is no sudo" >&2
    return 1
  fi
}

ft_quietly() { "$@" >/dev/null; }
# ft_not_silent WHAT COMMAND...: a line every 40 s while a command runs that says nothing.
ft_not_silent() {
  local what=$1 begin=$SECONDS said=0 pid
  shift
  "$@" &
  pid=$!
  while kill -0 "$pid" 2>/dev/null; do
    sleep 0.5
    if ((SECONDS - begin >= said + 40)); then
      said=$((SECONDS - begin))
      echo "ft: $what: $said s"
    fi
  done
  wait "$pid"
}

# ft_start_pulse WHAT: a line now and then, until ft_stop_pulse, while a command says nothing. No job of this shell, which waits
# for its jobs.
ft_start_pulse() {
  local what=$1 begin=$SECONDS
  exec 4>&1
  pulse=$(
    while sleep 50 4>&- && kill -0 $$ 2>/dev/null; do
      printf -- '-- %s: %d s\n' "$what" $((SECONDS - begin)) >&4
    done >/dev/null 2>&1 &
    echo $!
  )
}
ft_stop_pulse() {
  if [[ -n ${pulse:-} ]]; then kill "$pulse" 2>/dev/null || true; fi
  pulse=
}

# ft_install_missing build|python|test
ft_install_missing() {
  local wanted=("${ft_build_packages[@]}") missing optional=()
  if [[ $1 == python ]]; then wanted+=("${ft_python_packages[@]}"); fi
  if [[ $1 == test ]]; then wanted+=("${ft_test_packages[@]}"); fi

  if ! command -v apt-get >/dev/null || ! command -v dpkg-query >/dev/null; then
    cat >&2 <<EOF
ft: this is not a Debian or Ubuntu system (no apt-get): nothing is installed for you.
    Going on with what is there. Needed, by their Debian names:
    ${wanted[*]}
EOF
    return 0
  fi

  mapfile -t missing < <(ft_missing "${wanted[@]}")
  if [[ $1 == test ]]; then mapfile -t optional < <(ft_missing "${ft_optional_packages[@]}"); fi
  if ((${#missing[@]} + ${#optional[@]} == 0)); then return 0; fi

  echo "ft: installing ${missing[*]} ${optional[*]}"
  if ! ft_as_root apt-get update -qq && ((${#missing[@]} > 0)); then
    echo "ft: 'apt-get update' failed; trying with the package lists at hand" >&2
  fi
  if ((${#missing[@]} > 0)) &&
      ! ft_not_silent installing ft_quietly ft_as_root apt-get install -y -qq --no-install-recommends "${missing[@]}"; then
    cat >&2 <<EOF
ft: could not install the missing packages (no network, or not allowed?). Please install them:
    sudo apt-get install ${missing[*]}
EOF
    return 1
  fi
  local package
  for package in "${optional[@]}"; do
    ft_as_root apt-get install -y -qq --no-install-recommends "$package" >/dev/null 2>&1 ||
      echo "ft: no package $package here, going on without it" >&2
  done
}

# Puts a CUDA toolkit from the usual places on the PATH. Fails where there is none.
ft_find_nvcc() {
  command -v nvcc >/dev/null && return 0
  local dir
  for dir in "${CUDA_HOME:-}" "${CUDA_PATH:-}" /usr/local/cuda; do
    if [[ -n $dir && -x $dir/bin/nvcc ]]; then
      export PATH="$dir/bin:$PATH"
      return 0
    fi
  done
  return 1
}

# Compute capabilities of the GPUs here that nvcc knows, as it writes them (90), a line each. Where there are GPUs
# and it knows none of them: default.
ft_gpu_architectures() {
  local all known
  all=$(nvidia-smi --query-gpu=compute_cap --format=csv,noheader 2>/dev/null | grep -xE '[0-9]+\.[0-9]+' | tr -d . | sort -u || true)
  if [[ -z $all ]]; then return 0; fi
  known=$(grep -xFf <(nvcc --list-gpu-arch | sed 's/compute_//') <<<"$all" || true)
  echo "${known:-default}"
}

# Compile jobs at a time: FT_JOBS, else one a core and at most one per 2 GB of memory.
ft_jobs() {
  if [[ -n ${FT_JOBS:-} ]]; then
    echo "$FT_JOBS"
    return
  fi
  local cores gigabytes
  cores=$(nproc 2>/dev/null || echo 2)
  gigabytes=$(awk '/^MemTotal/ {print int($2 / 2e6)}' /proc/meminfo 2>/dev/null || echo "$cores")
  echo $((gigabytes < 1 ? 1 : cores < gigabytes ? cores : gigabytes))
}

# ft_start COMMAND...: beside this shell, as many at a time as ft_jobs says. What it says comes in one piece
# when it ends. ft_wait waits for all of them, and fails where one failed.
ft_start() {
  local command="$*"
  [[ -n ${ft_failures:-} ]] || ft_failures=$(mktemp)
  while (($(jobs -rp | wc -l) >= $(ft_jobs))); do wait -n || true; done
  (
    said=$(mktemp)
    exec 3>&1 >"$said" 2>&1
    trap 'status=$?; cat "$said" >&3; rm "$said"; ((status == 0)) || echo "$command" >>"$ft_failures"' EXIT
    "$@"
  ) &
}
ft_wait() {
  local status=0
  wait
  if [[ -s ${ft_failures:-} ]]; then
    sed 's/^/failed: /' "$ft_failures" >&2
    status=1
  fi
  rm -f "${ft_failures:-}"
  ft_failures=
  return "$status"
}

# ft_configure BUILD_DIR OPTION...: with Ninja in a new folder, with what it was made for in an old one.
ft_configure() {
  local dir=$1 generator=()
  shift
  if [[ ! -f $dir/CMakeCache.txt ]] && command -v ninja >/dev/null; then generator=(-G Ninja); fi
  cmake -S "$ft_root" -B "$dir" "${generator[@]}" "$@"
}

if [[ ${BASH_SOURCE[0]} == "$0" ]]; then
  set -euo pipefail
  case ${1:-build} in
    build | python | test) ft_install_missing "${1:-build}" ;;
    *) echo "usage: $0 [build|python|test]" >&2; exit 2 ;;
  esac
fi
