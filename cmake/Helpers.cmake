# SPDX-License-Identifier: Apache-2.0
# Functions for ft's own binaries. Nothing here reaches those who use the library.

include(GoogleTest)

add_custom_target(ft_host_tests)

# Warnings, sanitizers and language settings of one of our targets.
function(ft_target_defaults target)
  set(warnings -Wall -Wextra -Wshadow -Wconversion)
  set(host_warnings ${warnings} -Wpedantic)
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
    set(sanitize -fsanitize=${FT_SANITIZE} -fno-sanitize-recover=all -fno-omit-frame-pointer)
    target_compile_options(${target} PRIVATE "$<$<COMPILE_LANGUAGE:CXX>:${sanitize}>")
    target_link_options(${target} PRIVATE "$<$<LINK_LANGUAGE:CXX>:${sanitize}>")
  endif()
  set_target_properties(${target} PROPERTIES CXX_EXTENSIONS OFF CUDA_EXTENSIONS OFF)
endfunction()

# ft_add_test(NAME name SOURCES files... [LIBS targets...] [LABELS labels...])
# One GoogleTest executable; each of its tests becomes one of ctest's, or with FT_TEST_SHARDS that many
# parts of it do. The label gpu marks what needs a device, cuda what needs no more than the CUDA compiler;
# the target ft_host_tests builds all others.
function(ft_add_test)
  cmake_parse_arguments(PARSE_ARGV 0 arg "" "NAME" "SOURCES;LIBS;LABELS")
  if(arg_UNPARSED_ARGUMENTS OR NOT arg_NAME OR NOT arg_SOURCES)
    message(FATAL_ERROR "ft_add_test: NAME and SOURCES are needed; not understood: "
                        "'${arg_UNPARSED_ARGUMENTS}'")
  endif()
  add_executable(${arg_NAME} ${arg_SOURCES})
  target_include_directories(${arg_NAME} PRIVATE ${PROJECT_SOURCE_DIR})
  target_link_libraries(${arg_NAME} PRIVATE ${arg_LIBS} GTest::gtest_main)
  ft_target_defaults(${arg_NAME})
  if("gpu" IN_LIST arg_LABELS)
    # Programs and benches have all architectures. For tests, which take the compiler longest, the oldest
    # (as PTX it runs on those in between) and the newest are enough.
    set(architectures ${CMAKE_CUDA_ARCHITECTURES})
    list(LENGTH architectures count)
    if(count GREATER 2)
      list(GET architectures 0 oldest)
      list(GET architectures -1 newest)
      set_target_properties(${arg_NAME} PROPERTIES CUDA_ARCHITECTURES "${oldest};${newest}")
    endif()
  else()
    add_dependencies(ft_host_tests ${arg_NAME})
  endif()
  set(properties TIMEOUT 600)
  if(arg_LABELS)
    string(REPLACE ";" "\\;" labels "${arg_LABELS}")
    list(APPEND properties LABELS "${labels}")
  endif()
  if(FT_TEST_SHARDS)
    math(EXPR last "${FT_TEST_SHARDS} - 1")
    foreach(shard RANGE ${last})
      add_test(NAME ${arg_NAME}_${shard} COMMAND ${arg_NAME} WORKING_DIRECTORY ${PROJECT_BINARY_DIR})
      set_tests_properties(${arg_NAME}_${shard} PROPERTIES ${properties}
        ENVIRONMENT "GTEST_TOTAL_SHARDS=${FT_TEST_SHARDS};GTEST_SHARD_INDEX=${shard}")
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

# ft_add_stage_tests(NAME name SOURCES files.cpp... [LIBS targets...] [LABELS labels...])
# One body, every executor: <name>_host from the sources as C++ and, with CUDA, <name>_cuda from the same
# sources as CUDA, each through a generated unit that includes it.
function(ft_add_stage_tests)
  cmake_parse_arguments(PARSE_ARGV 0 arg "" "NAME" "SOURCES;LIBS;LABELS")
  ft_add_test(NAME ${arg_NAME}_host SOURCES ${arg_SOURCES} LIBS ft::ft ${arg_LIBS}
              LABELS ${arg_LABELS} ${arg_UNPARSED_ARGUMENTS})
  if(NOT FT_HAS_CUDA)
    return()
  endif()
  set(units)
  foreach(source IN LISTS arg_SOURCES)
    get_filename_component(source ${source} ABSOLUTE)
    file(RELATIVE_PATH relative ${PROJECT_SOURCE_DIR} ${source})
    set(unit ${CMAKE_CURRENT_BINARY_DIR}/${arg_NAME}_cuda/${relative}.cu)
    file(CONFIGURE OUTPUT ${unit} CONTENT "#include \"${source}\"\n" @ONLY)
    list(APPEND units ${unit})
  endforeach()
  ft_add_test(NAME ${arg_NAME}_cuda SOURCES ${units} LIBS ft::cuda ${arg_LIBS}
              LABELS gpu ${arg_LABELS})
endfunction()
