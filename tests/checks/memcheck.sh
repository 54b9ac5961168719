#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Tests of limits, lifetimes and trackers on the host under a slow checker (not in scripts/test.sh):
#   tests/checks/memcheck.sh            valgrind's memcheck: memory that is read before it is written, leaks, bounds; about 10 minutes
#   tests/checks/memcheck.sh threads    ThreadSanitizer; about 5 minutes
# Ends with 1 where one of them reports anything. Nothing is suppressed.
set -euo pipefail
ft_root=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)
# shellcheck source=scripts/deps.sh
source "$ft_root/scripts/deps.sh"
cd "$ft_root"

mode=${1:-memory}
case $mode in
  memory) tool=valgrind flags=(-g) ;;
  threads) tool=taskset flags=(-g1 -fsanitize=thread) ;;
  *) echo "usage: $0 [memory|threads]" >&2; exit 2 ;;
esac
command -v $tool >/dev/null || { echo "ft: $0 needs $tool" >&2; exit 2; }

# Not by CMake: there new memory is filled with garbage (FT_NEW_MEMORY_SEED), and memcheck takes that for a value.
build=$ft_root/build-$mode
mkdir -p "$build"
compile() {
  c++ -std=c++17 -O1 "${@:2}" -Iinclude -I. -c "tests/$1_test.cpp" -o "$build/$(basename "$1").o"
}
export -f compile
export build
tests=(pipelines/{lifetime,limits,bad_input,tracker,extractor} core/{memory,group} containers/soa)
printf '%s\n' "${tests[@]}" | xargs -P "$(ft_jobs)" -I{} bash -c "compile {} ${flags[*]}"
c++ "${flags[@]}" "$build"/*.o -lgtest -lgtest_main -ltbb -lpthread -o "$build/tests"

export FT_TEST_EFFORT=2  # percent of the random cases, and no image of 8192 x 8192
if [[ $mode == memory ]]; then
  # Left out: where memory is asked for that is not there valgrind ends the program instead of throwing; tests that
  # count allocations, which are valgrind's; what alone takes minutes.
  skipped='*memory_that_is_not_there*:*a_size_that_does_not_fit_throws:*the_counter_counts:*takes_nothing_from_the_heap'
  skipped+=':*leaves_nothing_stale:*twenty_runs*'
  exec valgrind --error-exitcode=1 --num-callers=25 --leak-check=full --errors-for-leak-kinds=definite "$build/tests" \
    --gtest_filter="-$skipped"
fi
# On one core: oneTBB then starts no threads of its own. It is not instrumented, so what it hands from thread to
# thread would be reported. The tests' own threads stay.
exec taskset -c 0 "$build/tests" \
  --gtest_filter='*lifetime*:*limits*:*group_unit*:*thread*:*two_trackers*:*turns*-*memory_that_is_not_there*'
