# SPDX-License-Identifier: Apache-2.0
# cmake -DSOURCE=FOLDER_OF_FT -DCXX=COMPILER -DOUT=FOLDER -P build_type.cmake: who uses ft without a build type is warned
# once, of a build that is 30 times slower; nobody else is. Configures only.
cmake_minimum_required(VERSION 3.22)

file(WRITE ${OUT}/twice/CMakeLists.txt "
cmake_minimum_required(VERSION 3.22)
project(twice LANGUAGES CXX)
set(FT_ENABLE_CUDA OFF)
add_subdirectory(${SOURCE} ft)
include(${SOURCE}/cmake/BuildType.cmake)  # as find_package(ft) does
")
unset(ENV{CMAKE_BUILD_TYPE})

function(warnings_of variable)  # options of the call follow
  file(REMOVE_RECURSE ${OUT}/build)
  execute_process(COMMAND ${CMAKE_COMMAND} -S ${OUT}/twice -B ${OUT}/build -DCMAKE_CXX_COMPILER=${CXX} ${ARGN}
                  RESULT_VARIABLE result OUTPUT_QUIET ERROR_VARIABLE said)
  if(NOT result EQUAL 0)
    message(FATAL_ERROR "${ARGN}: ${said}")
  endif()
  string(REGEX MATCHALL "no build type is set" found "${said}")
  list(LENGTH found count)
  set(${variable} ${count} PARENT_SCOPE)
endfunction()
function(expect wanted)
  warnings_of(count ${ARGN})
  if(NOT count EQUAL wanted)
    message(SEND_ERROR "${ARGN}: ${count} warnings, should be ${wanted}")
  endif()
endfunction()

expect(1)
expect(0 -DCMAKE_BUILD_TYPE=Release)
expect(0 -DCMAKE_BUILD_TYPE=Debug)  # asked for
expect(0 -DCMAKE_CXX_FLAGS=-O2)
expect(1 -DCMAKE_CXX_FLAGS=-O0)
