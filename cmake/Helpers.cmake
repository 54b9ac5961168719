# SPDX-License-Identifier: Apache-2.0
# Functions for ft's own binaries. Nothing here reaches those who use the library.

include(GoogleTest)

add_custom_target(ft_host_tests)

# The host's half of CUDA programs that do not run is not optimised.
if(FT_HAS_CUDA AND FT_FAST_COMPILE)
  string(REGEX REPLACE "-O[1-3]" "-O0" CMAKE_CUDA_FLAGS_RELEASE "${CMAKE_CUDA_FLAGS_RELEASE}")
  include(CheckCompilerFlag)
  check_compiler_flag(CUDA --Ofast-compile=max FT_HAS_OFAST_COMPILE)  # CUDA 12.9 and newer
endif()

# The host has many stages twice, for vectors that each processor has and for wide ones. Code for this machine has them
# once: with FT_FAST_COMPILE, and with sanitizers.
set(ft_processor_options)
if((FT_FAST_COMPILE OR FT_SANITIZE) AND CMAKE_CXX_COMPILER_ID MATCHES "GNU|Clang" AND NOT CMAKE_CROSSCOMPILING)
  include(CheckCXXSourceRuns)
  check_cxx_source_runs("
    int main() { return __builtin_cpu_supports(\"avx2\") && __builtin_cpu_supports(\"popcnt\") ? 0 : 1; }"
    FT_HAS_WIDE_VECTORS)
  if(FT_HAS_WIDE_VECTORS)
    # Eigen's types lie in memory as without AVX: programs link libraries, and units of their own, that have none.
    set(ft_processor_options -mavx2 -mpopcnt -DEIGEN_MAX_ALIGN_BYTES=16)
  endif()
endif()

# FT_FAST_COMPILE: CUDA programs that are compiled and not run have PTX of the newest architecture and no
# optimisations. One that is OPTIMIZED has the machine code, optimised but for what takes nvcc long.
function(ft_set_fast_device_code target)
  list(GET CMAKE_CUDA_ARCHITECTURES -1 newest)
  set(architectures ${newest}-virtual)
  set(speed max)
  if(ARGN)  # min: what costs a program next to nothing is left out, which is more than half of the compiler's time
    set(architectures ${newest})
    set(speed min)
  endif()
  set_target_properties(${target} PROPERTIES CUDA_ARCHITECTURES ${architectures})
  if(FT_HAS_OFAST_COMPILE)
    target_compile_options(${target} PRIVATE $<$<COMPILE_LANGUAGE:CUDA>:--Ofast-compile=${speed}>)
  endif()
endfunction()

# Warnings, sanitizers and language settings of one of our targets.
# ft_target_defaults(target [OPTIMIZED]): the code of a target that is OPTIMIZED is what users have, also with FT_FAST_COMPILE.
function(ft_target_defaults target)
  if(FT_HAS_CUDA AND FT_FAST_COMPILE)
    ft_set_fast_device_code(${target} ${ARGN})
  endif()
  set(warnings -Wall -Wextra -Wshadow -Wconversion)
  set(host_warnings ${warnings} -Wpedantic)
  if(CMAKE_CXX_COMPILER_ID MATCHES "Clang")  # TYPED_TEST_SUITE
    list(APPEND host_warnings -Wno-gnu-zero-variadic-macro-arguments)
  endif()
  # nvcc writes line directives and extensions into what the host compiler sees: no -Wpedantic there.
  list(JOIN warnings "," cuda_warnings)
  set(cuda_warnings -Xcompiler=${cuda_warnings})
  if(FT_WARNINGS_AS_ERRORS)
    list(APPEND host_warnings -Werror)
    list(APPEND cuda_warnings -Xcompiler=-Werror "SHELL:-Werror all-warnings")
  endif()
  target_compile_options(${target} PRIVATE "$<$<COMPILE_LANGUAGE:CXX>:${host_warnings}>"
                                           "$<$<COMPILE_LANGUAGE:CUDA>:${cuda_warnings}>")
  if(FT_SANITIZE)
    # What is left out is found by AddressSanitizer where it leads to a wrong access. It took a fifth of the compiler's time.
    set(sanitize -fsanitize=${FT_SANITIZE} -fno-sanitize=null,object-size,vptr,pointer-overflow
        -fno-sanitize-recover=all -fno-omit-frame-pointer)
    target_compile_options(${target} PRIVATE "$<$<COMPILE_LANGUAGE:CXX>:${sanitize}>")
    if(CMAKE_CXX_COMPILER_ID MATCHES "Clang")  # what is inlined is compiled again: 11 GB in one unit of many stages
      target_compile_options(${target} PRIVATE "SHELL:-mllvm -inline-threshold=20")
    endif()
    target_link_options(${target} PRIVATE "$<$<LINK_LANGUAGE:CXX>:${sanitize}>")
  endif()
  if(NOT ARGN)
    target_compile_options(${target} PRIVATE "$<$<COMPILE_LANGUAGE:CXX>:${ft_processor_options}>")
  endif()
  set_target_properties(${target} PROPERTIES CXX_EXTENSIONS OFF CUDA_EXTENSIONS OFF)
endfunction()

# ft_collect_less(target): g++ collects its garbage from half a gigabyte on, not from 128 MB: a tenth of the time of a unit
# that takes about as much memory anyhow.
function(ft_collect_less target)
  if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU")
    target_compile_options(${target} PRIVATE "$<$<COMPILE_LANGUAGE:CXX>:SHELL:--param ggc-min-heapsize=524288>")
  endif()
endfunction()

# ft_compile_fast(target): with FT_FAST_COMPILE, for C++ that runs for no longer than it is compiled. -Og still warns of what
# its passes see, and is no slower to compile than -O0.
function(ft_compile_fast target)
  if(FT_FAST_COMPILE)
    target_compile_options(${target} PRIVATE $<$<COMPILE_LANGUAGE:CXX>:-Og>)
  endif()
endfunction()

# Programs and benches have all architectures. Tests, which take the compiler longest, have those of
# FT_TEST_CUDA_ARCHITECTURES: by default the newest, and the oldest one's PTX, which other GPUs translate.
function(ft_set_test_architectures target)
  if(FT_FAST_COMPILE)
    return()
  endif()
  set(architectures ${CMAKE_CUDA_ARCHITECTURES})
  list(GET architectures 0 oldest)
  list(GET architectures -1 newest)
  if(FT_TEST_CUDA_ARCHITECTURES)
    set(architectures ${FT_TEST_CUDA_ARCHITECTURES})
  elseif(oldest MATCHES "^[0-9]+$" AND NOT oldest STREQUAL newest)
    set(architectures ${oldest}-virtual ${newest})
  endif()
  set_target_properties(${target} PROPERTIES CUDA_ARCHITECTURES "${architectures}")
endfunction()

# ft_add_test(NAME name SOURCES files... [LIBS targets...] [LABELS labels...] [OPTIMIZED])
# One GoogleTest executable. Each of its tests becomes one of ctest's, or with FT_TEST_SHARDS that many parts of it do;
# those that need a device stay one each, or with FT_FAST_COMPILE are one together. The label gpu marks what needs a
# device, cuda what needs no more than the CUDA compiler; the target ft_host_tests builds all others.
function(ft_add_test)
  cmake_parse_arguments(PARSE_ARGV 0 arg "OPTIMIZED" "NAME" "SOURCES;LIBS;LABELS")
  if(arg_UNPARSED_ARGUMENTS OR NOT arg_NAME OR NOT arg_SOURCES)
    message(FATAL_ERROR "ft_add_test: NAME and SOURCES are needed; not understood: "
                        "'${arg_UNPARSED_ARGUMENTS}'")
  endif()
  add_executable(${arg_NAME} ${arg_SOURCES})
  target_include_directories(${arg_NAME} PRIVATE ${PROJECT_SOURCE_DIR})
  target_link_libraries(${arg_NAME} PRIVATE ${arg_LIBS} GTest::gtest_main)
  set(optimized)
  if(arg_OPTIMIZED)
    set(optimized OPTIMIZED)
  endif()
  ft_target_defaults(${arg_NAME} ${optimized})
  if("gpu" IN_LIST arg_LABELS)
    ft_set_test_architectures(${arg_NAME})
  else()
    add_dependencies(ft_host_tests ${arg_NAME})
  endif()
  set(shards ${FT_TEST_SHARDS})
  if("gpu" IN_LIST arg_LABELS)
    set(shards 0)
    if(FT_FAST_COMPILE)
      set(shards 1)  # compiled where no GPU is: all of its tests skip
    endif()
  endif()
  set(properties TIMEOUT 600)
  if(shards)
    set(properties TIMEOUT 1800)
  endif()
  if(arg_LABELS)
    string(REPLACE ";" "\\;" labels "${arg_LABELS}")
    list(APPEND properties LABELS "${labels}")
  endif()
  if(shards)
    math(EXPR last "${shards} - 1")
    foreach(shard RANGE ${last})
      add_test(NAME ${arg_NAME}_${shard} COMMAND ${arg_NAME} WORKING_DIRECTORY ${PROJECT_BINARY_DIR})
      set_tests_properties(${arg_NAME}_${shard} PROPERTIES ${properties}
        ENVIRONMENT "GTEST_TOTAL_SHARDS=${shards};GTEST_SHARD_INDEX=${shard}")
    endforeach()
    return()
  endif()
  gtest_discover_tests(${arg_NAME}
    TEST_PREFIX ${arg_NAME}:
    WORKING_DIRECTORY ${PROJECT_BINARY_DIR}
    DISCOVERY_MODE PRE_TEST
    DISCOVERY_TIMEOUT 120
    PROPERTIES ${properties})
endfunction()

# ft_write_unit(unit sources...): a file that includes them by their paths from the project's folder, which it has to be
# compiled with as an include folder. So it has the same text in every checkout, for compiler caches. With sanitizers
# clang++ does not optimise the sources themselves, bodies of tests, which halves its time; it optimises what they include.
function(ft_write_unit unit)
  set(includes)
  set(text)
  foreach(source IN LISTS ARGN)
    get_filename_component(source ${source} ABSOLUTE)
    file(RELATIVE_PATH relative ${PROJECT_SOURCE_DIR} ${source})
    string(APPEND text "#include \"${relative}\"\n")
    if(FT_SANITIZE AND CMAKE_CXX_COMPILER_ID MATCHES "Clang")
      file(STRINGS ${source} lines REGEX "^#include (<[a-z_]+>|<gtest/gtest.h>|\"(ft|integration|tests)/)")
      list(APPEND includes ${lines})
    endif()
  endforeach()
  if(includes)
    list(REMOVE_DUPLICATES includes)
    list(JOIN includes "\n" includes)
    set(text "${includes}\n#pragma clang optimize off\n${text}#pragma clang optimize on\n")
  endif()
  file(CONFIGURE OUTPUT ${unit} CONTENT "${text}" @ONLY)
endfunction()

# ft_make_units(out folder extension sources...): units that include equally many of the sources each, at most
# FT_TEST_BATCH. Those with the tracker come first, then those with another pipeline: most of what the compiler does for
# them is the pipeline, once in a unit.
function(ft_make_units out folder extension)
  set(units)
  set(trackers)
  set(pipelines)
  set(others)
  foreach(source IN LISTS ARGN)
    file(STRINGS ${source} headers REGEX "^#include \"ft/(pipelines/|ft\\.hpp)")
    if(headers MATCHES "frame_tracker|ft/ft\\.hpp")
      list(APPEND trackers ${source})
    elseif(headers)
      list(APPEND pipelines ${source})
    else()
      list(APPEND others ${source})
    endif()
  endforeach()
  set(all ${trackers} ${pipelines} ${others})
  list(LENGTH all count)
  math(EXPR last "${count} - 1")
  math(EXPR batches "(${count} + ${FT_TEST_BATCH} - 1) / ${FT_TEST_BATCH}")
  math(EXPR batch "(${count} + ${batches} - 1) / ${batches}")
  foreach(begin RANGE 0 ${last} ${batch})
    list(SUBLIST all ${begin} ${batch} sources)
    list(GET sources 0 first)
    get_filename_component(first ${first} ABSOLUTE)
    file(RELATIVE_PATH relative ${PROJECT_SOURCE_DIR} ${first})
    set(unit ${CMAKE_CURRENT_BINARY_DIR}/${folder}/${relative}.${extension})
    ft_write_unit(${unit} ${sources})
    list(APPEND units ${unit})
  endforeach()
  set(${out} ${units} PARENT_SCOPE)
endfunction()

# With FT_FAST_COMPILE, the host's stages that a program calls are those of the compiled library, and of its units other than
# `units`: FT_STAGES_ELSEWHERE. Without `units` all of its units take them.
# ft_take_stages(target [units...])
set(ft_stages_are_shared OFF)
if(FT_FAST_COMPILE AND FT_BUILD_LIBRARY AND NOT BUILD_SHARED_LIBS)
  set(ft_stages_are_shared ON)
endif()
function(ft_take_stages target)
  if(NOT ft_stages_are_shared)
    return()
  endif()
  if(ARGN)
    set_property(SOURCE ${ARGN} APPEND PROPERTY COMPILE_DEFINITIONS FT_STAGES_ELSEWHERE)
  else()
    target_compile_definitions(${target} PRIVATE $<$<COMPILE_LANGUAGE:CXX>:FT_STAGES_ELSEWHERE>)
  endif()
  target_link_libraries(${target} PRIVATE ft::odometry)
endfunction()

# ft_add_ptx(target SOURCES files.cu... [TAKES_STAGES files.cu...] LIBS targets...)
# With FT_FAST_COMPILE, what would not run without a device and has no code of its own for the host: it is compiled to
# PTX (of the newest architecture, where its own is not set), and not linked. The kernels of ft that TAKES_STAGES call are
# compiled in other programs: the library, conformance, the benches.
function(ft_add_ptx target)
  cmake_parse_arguments(PARSE_ARGV 1 arg "" "" "SOURCES;TAKES_STAGES;LIBS")
  add_library(${target} OBJECT ${arg_SOURCES} ${arg_TAKES_STAGES})
  if(arg_TAKES_STAGES)
    set_property(SOURCE ${arg_TAKES_STAGES} APPEND PROPERTY COMPILE_DEFINITIONS FT_STAGES_ELSEWHERE)
  endif()
  target_include_directories(${target} PRIVATE ${PROJECT_SOURCE_DIR})
  target_link_libraries(${target} PRIVATE ${arg_LIBS})
  ft_target_defaults(${target})
  set_target_properties(${target} PROPERTIES CUDA_PTX_COMPILATION ON)
endfunction()

# ft_add_stage_tests(NAME name SOURCES files.cpp... [HOST_WITHOUT files...] [TAKES_STAGES files...] [LIBS targets...]
#                    [LABELS labels...] [OPTIMIZED])
# One body, every executor: <name>_host from the sources as C++, but those of HOST_WITHOUT, and, with CUDA,
# <name>_cuda from the same sources as CUDA, through generated units that include FT_TEST_BATCH of them. Sources that
# have options of their own stay alone in the plain host program; those of TAKES_STAGES take the host's stages, see
# ft_take_stages. With FT_FAST_COMPILE <name>_cuda is compiled to PTX and not linked: without a device its tests would
# skip.
function(ft_add_stage_tests)
  cmake_parse_arguments(PARSE_ARGV 0 arg "OPTIMIZED" "NAME" "SOURCES;HOST_WITHOUT;TAKES_STAGES;LIBS;LABELS")
  set(optimized)
  if(arg_OPTIMIZED)
    set(optimized OPTIMIZED)
  endif()
  set(host_sources ${arg_SOURCES})
  list(REMOVE_ITEM host_sources ${arg_HOST_WITHOUT})
  set(takers)
  if(ft_stages_are_shared AND arg_TAKES_STAGES)
    ft_make_units(takers ${arg_NAME}_host cpp ${arg_TAKES_STAGES})
    list(REMOVE_ITEM host_sources ${arg_TAKES_STAGES})
  endif()
  set(together)
  set(alone)
  foreach(source IN LISTS host_sources)
    get_source_file_property(options ${source} COMPILE_OPTIONS)
    if(FT_TEST_BATCH EQUAL 1 OR (options AND NOT FT_SANITIZE))
      list(APPEND alone ${source})
    else()
      list(APPEND together ${source})
    endif()
  endforeach()
  set(units)
  if(together)
    ft_make_units(units ${arg_NAME}_host cpp ${together})
  endif()
  list(APPEND units ${alone} ${takers})
  ft_add_test(NAME ${arg_NAME}_host SOURCES ${units} LIBS ft::ft ${arg_LIBS}
              LABELS ${arg_LABELS} ${optimized} ${arg_UNPARSED_ARGUMENTS})
  if(takers)
    ft_take_stages(${arg_NAME}_host ${takers})
  endif()
  if(FT_HAS_CUDA AND FT_FAST_COMPILE)
    # Those with device code of their own: a stage, a descriptor, a camera model.
    set(own)
    foreach(source IN LISTS arg_SOURCES)
      file(STRINGS ${source} lines REGEX "for_each_item|FT_DESCRIPTOR|(camera|descriptor)_contract/" LIMIT_COUNT 1)
      if(lines)
        list(APPEND own ${source})
      endif()
    endforeach()
    set(takers ${arg_SOURCES})
    list(REMOVE_ITEM takers ${own})
    set(own_units)
    set(taker_units)
    if(own)
      ft_make_units(own_units ${arg_NAME}_cuda cu ${own})
    endif()
    if(takers)
      ft_make_units(taker_units ${arg_NAME}_cuda cu ${takers})
    endif()
    ft_add_ptx(${arg_NAME}_cuda SOURCES ${own_units} TAKES_STAGES ${taker_units}
               LIBS ft::cuda GTest::gtest ${arg_LIBS})
  elseif(FT_HAS_CUDA)
    ft_make_units(units ${arg_NAME}_cuda cu ${arg_SOURCES})
    ft_add_test(NAME ${arg_NAME}_cuda SOURCES ${units} LIBS ft::cuda ${arg_LIBS}
                LABELS gpu ${arg_LABELS})
  endif()
endfunction()
