# SPDX-License-Identifier: Apache-2.0
# What find_package(ft COMPONENTS ...) says about components that ft has not.
#   cmake -DCMAKE_PREFIX_PATH=PREFIX -DOUT=FOLDER -P components.cmake
foreach(asked "COMPONENTS host;OK" "COMPONENTS hots;ft has no component \"hots\": there are host, cuda, odometry and sequence"
              "COMPONENTS host OPTIONAL_COMPONENTS gpu;OK")
  list(GET asked 0 components)
  list(GET asked 1 expected)
  string(MAKE_C_IDENTIFIER "${components}" name)
  file(WRITE ${OUT}/${name}/CMakeLists.txt "cmake_minimum_required(VERSION 3.22)
project(asks LANGUAGES CXX)
find_package(ft REQUIRED ${components})
message(STATUS OK)
")
  execute_process(COMMAND ${CMAKE_COMMAND} -S ${OUT}/${name} -B ${OUT}/${name}/build
                          -DCMAKE_PREFIX_PATH=${CMAKE_PREFIX_PATH}
                  OUTPUT_VARIABLE said ERROR_VARIABLE said RESULT_VARIABLE result)
  string(REGEX REPLACE "[ \n]+" " " said "${said}")
  string(FIND "${said}" "${expected}" at)
  if(at EQUAL -1 OR (expected STREQUAL "OK" AND NOT result EQUAL 0)
     OR (NOT expected STREQUAL "OK" AND result EQUAL 0))
    message(FATAL_ERROR "find_package(ft REQUIRED ${components}): expected ${expected}, got ${said}")
  endif()
endforeach()
