# SPDX-License-Identifier: Apache-2.0
# cmake -DNM=nm "-DWITHOUT=a.o;b.o" "-DWITH=c.o" -P no_loops.cmake
# Objects of programs that use an odometry without ft::loops have no symbol of loops, neither defined nor called; those of
# a program with loops have.
set(loops "odometry_loops<|loop_search<|loop_path|loop_archive|vote_for_rows|match_keyframes|pose_graph")

# Symbols of the objects that match.
function(symbols_of_loops out)
  execute_process(COMMAND ${NM} -C ${ARGN} OUTPUT_VARIABLE symbols RESULT_VARIABLE failed)
  if(failed)
    message(FATAL_ERROR "${NM} cannot read ${ARGN}")
  endif()
  if(NOT symbols MATCHES "ft::v0")
    message(FATAL_ERROR "${ARGN}: no symbol of ft")
  endif()
  string(REGEX MATCHALL "[^\n]*(${loops})[^\n]*" found "${symbols}")
  set(${out} "${found}" PARENT_SCOPE)
endfunction()

symbols_of_loops(found ${WITH})
if(NOT found)
  message(FATAL_ERROR "${WITH}: the program with loops has none of (${loops}): they have other names")
endif()
symbols_of_loops(found ${WITHOUT})
if(found)
  list(LENGTH found count)
  list(GET found 0 first)
  message(FATAL_ERROR "${WITHOUT}: ${count} symbols of loops, the first is ${first}")
endif()
