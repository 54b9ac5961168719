# SPDX-License-Identifier: Apache-2.0
# cmake -DCXX=COMPILER -DINCLUDE=FOLDER -P refused_flags.cmake: flags that the headers refuse, each with its message,
# and the way round it. Preprocesses only.
cmake_minimum_required(VERSION 3.22)

set(unit ${CMAKE_CURRENT_BINARY_DIR}/refused_flags.cpp)
file(WRITE ${unit} "#include \"ft/ft.hpp\"\n")
set(small_unit ${CMAKE_CURRENT_BINARY_DIR}/refused_flags_config.cpp)
file(WRITE ${small_unit} "#include \"ft/core/config.hpp\"\n")

function(preprocess)  # sets `code` and `output`
  execute_process(COMMAND ${CXX} -E -I${INCLUDE} ${ARGN} RESULT_VARIABLE result OUTPUT_QUIET ERROR_VARIABLE said)
  set(code ${result} PARENT_SCOPE)
  set(output "${said}" PARENT_SCOPE)
endfunction()
function(expect_refused message)
  preprocess(${ARGN})
  if(code EQUAL 0 OR NOT output MATCHES "${message}")
    message(SEND_ERROR "${ARGN}: not refused with '${message}': ${output}")
  endif()
endfunction()
function(expect_accepted)
  preprocess(${ARGN})
  if(NOT code EQUAL 0)
    message(SEND_ERROR "${ARGN}: refused: ${output}")
  endif()
endfunction()

expect_accepted(-std=c++17 ${unit})
expect_accepted(-std=c++17 -O3 -fno-math-errno ${unit})
expect_refused("C\\+\\+17 or newer" -std=c++14 ${small_unit})
foreach(flags -ffast-math -Ofast -ffinite-math-only "-O2;-ffast-math")
  expect_refused("standard floating point" -std=c++17 ${flags} ${unit})
  expect_accepted(-std=c++17 ${flags} -DFT_ALLOW_FAST_MATH ${unit})
endforeach()
# As a CUDA compiler says it to device code.
expect_refused("compute capability 7.0" -std=c++17 -D__CUDA_ARCH__=610 ${small_unit})
expect_accepted(-std=c++17 -D__CUDA_ARCH__=700 ${small_unit})
# Another descriptor has a namespace of its own, which the first header names.
set(own "struct own : ft::binary_descriptor<192> {\n  static constexpr char const* name = \"own\";\n};\n")
set(early ${CMAKE_CURRENT_BINARY_DIR}/refused_flags_early.cpp)
file(WRITE ${early} "#define FT_DESCRIPTOR own\n#include \"ft/descriptors/binary_descriptor.hpp\"\n${own}#include \"ft/containers/keypoints.hpp\"\n")
set(late ${CMAKE_CURRENT_BINARY_DIR}/refused_flags_late.cpp)
file(WRITE ${late} "#include \"ft/descriptors/binary_descriptor.hpp\"\n${own}#define FT_DESCRIPTOR own\n#include \"ft/containers/keypoints.hpp\"\n")
expect_accepted(-std=c++17 ${early})
expect_refused("define it before the first one" -std=c++17 ${late})
