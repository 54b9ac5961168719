# SPDX-License-Identifier: Apache-2.0
# What a project that includes ft decides for itself: build type, compiler cache, where binaries go.

get_property(multi_config GLOBAL PROPERTY GENERATOR_IS_MULTI_CONFIG)
if(NOT multi_config AND NOT CMAKE_BUILD_TYPE)
  set(CMAKE_BUILD_TYPE Release CACHE STRING "Build type" FORCE)
endif()

set(CMAKE_EXPORT_COMPILE_COMMANDS ON)
set(CMAKE_RUNTIME_OUTPUT_DIRECTORY ${PROJECT_BINARY_DIR}/bin)

find_program(FT_CCACHE ccache DOC "Compiler cache")
mark_as_advanced(FT_CCACHE)
# What one checkout has compiled another one finds: paths count from the project's folder.
set(checkout CCACHE_BASEDIR=${PROJECT_SOURCE_DIR} CCACHE_NOHASHDIR=1)
if(FT_CCACHE AND NOT DEFINED CMAKE_CXX_COMPILER_LAUNCHER)
  set(CMAKE_CXX_COMPILER_LAUNCHER ${CMAKE_COMMAND} -E env ${checkout} ${FT_CCACHE})
endif()
# ccache compares what nvcc's preprocessor makes of one architecture, and takes a change that only the host
# or another architecture sees for no change at all. Comparing the included files does not have that fault.
if(FT_CCACHE AND NOT DEFINED CMAKE_CUDA_COMPILER_LAUNCHER)
  set(CMAKE_CUDA_COMPILER_LAUNCHER
      ${CMAKE_COMMAND} -E env ${checkout} CCACHE_DIRECT=1 CCACHE_DEPEND=1 ${FT_CCACHE})
endif()
