#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
set -euo pipefail
ft_root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
# shellcheck source=scripts/deps.sh
source "$ft_root/scripts/deps.sh"
cd "$ft_root"

usage() {
  cat <<EOF
usage: bench/compile_times.sh [HEADER...]

Processor seconds to compile a unit that includes one public header and nothing else, slowest first: with
the C++ compiler (CXX, g++; -O2) and, where there is one, nvcc (-O2, one architecture: FT_ARCH, sm_90).
Without arguments all headers but those of interop.
EOF
}

case ${1:-} in
  -h | --help) usage; exit 0 ;;
  -*) usage >&2; exit 2 ;;
esac
headers=("$@")
if ((${#headers[@]} == 0)); then
  mapfile -t headers < <(cd include && find ft -name '*.hpp' -not -path '*/detail/*' -not -path '*/interop/*' | sort)
fi
have_cuda=1
ft_find_nvcc || have_cuda=0
compiler=${CXX:-g++}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

# seconds COMMAND...: the processor time it takes, or "failed"
seconds() {
  local TIMEFORMAT='%U %S'
  if ! { time "$@" 2>"$work/errors"; } 2>"$work/time"; then
    cat "$work/errors" >&2
    echo failed
    return
  fi
  awk '{ printf "%.2f\n", $1 + $2 }' "$work/time"
}

for header in "${headers[@]}"; do
  header=${header#include/}
  if [[ ! -f include/$header ]]; then
    echo "compile_times.sh: no header include/$header" >&2
    exit 1
  fi
  echo "#include \"$header\"" | tee "$work/unit.cpp" >"$work/unit.cu"
  host=$(seconds "$compiler" -std=c++17 -O2 -Iinclude -c "$work/unit.cpp" -o "$work/unit.o")
  cuda=-
  if ((have_cuda)); then
    cuda=$(seconds nvcc -std=c++17 -O2 -arch="${FT_ARCH:-sm_90}" -Iinclude -c "$work/unit.cu" -o "$work/unit.o")
  fi
  printf '%8s %8s  %s\n' "$host" "$cuda" "$header"
done >"$work/table"
printf '%8s %8s  %s\n' "$compiler, s" "nvcc, s" header
sort -k2,2gr -k1,1gr "$work/table"
if grep -q failed "$work/table"; then exit 1; fi
