# SPDX-License-Identifier: Apache-2.0
# Runs cmake/packaging/vcpkg/ft/portfile.cmake without vcpkg: its functions are replaced by what they do for a
# header-only port.   cmake -DPORT=FOLDER -DOUT=FOLDER -P run_port.cmake
cmake_minimum_required(VERSION 3.22)
set(CURRENT_PACKAGES_DIR ${OUT}/packages)
set(build ${OUT}/build)
get_filename_component(port_dir ${PORT} ABSOLUTE)
set(PORT ft)

function(run)
  execute_process(COMMAND ${ARGN} COMMAND_ERROR_IS_FATAL ANY)
endfunction()

function(vcpkg_cmake_configure)
  cmake_parse_arguments(PARSE_ARGV 0 arg "" "SOURCE_PATH" "OPTIONS")
  run(${CMAKE_COMMAND} -S ${arg_SOURCE_PATH} -B ${build} -DCMAKE_BUILD_TYPE=Release
      -DCMAKE_INSTALL_PREFIX=${CURRENT_PACKAGES_DIR} ${arg_OPTIONS})
endfunction()

function(vcpkg_cmake_install)
  run(${CMAKE_COMMAND} --build ${build} --target install)
endfunction()

# Moves the package to share/<port> and corrects the depth of its import prefix.
function(vcpkg_cmake_config_fixup)
  cmake_parse_arguments(PARSE_ARGV 0 arg "" "CONFIG_PATH" "")
  set(from ${CURRENT_PACKAGES_DIR}/${arg_CONFIG_PATH})
  set(to ${CURRENT_PACKAGES_DIR}/share/${PORT})
  file(GLOB files ${from}/*)
  file(COPY ${files} DESTINATION ${to})
  file(REMOVE_RECURSE ${from})
  set(up "get_filename_component(_IMPORT_PREFIX \"\${_IMPORT_PREFIX}\" PATH)\n")
  file(READ ${to}/ftTargets.cmake text)
  string(FIND "${text}" "${up}${up}${up}" found)
  if(found EQUAL -1)
    message(FATAL_ERROR "ftTargets.cmake does not find its prefix as expected")
  endif()
  string(REPLACE "${up}${up}${up}" "${up}${up}" text "${text}")
  file(WRITE ${to}/ftTargets.cmake "${text}")
  file(READ ${to}/ftConfig.cmake text)
  string(REPLACE "/../../../\" ABSOLUTE" "/../../\" ABSOLUTE" text "${text}")
  file(WRITE ${to}/ftConfig.cmake "${text}")
endfunction()

function(vcpkg_fixup_pkgconfig)
  if(NOT EXISTS ${CURRENT_PACKAGES_DIR}/share/pkgconfig/ft.pc)
    message(FATAL_ERROR "there is no pkg-config file")
  endif()
endfunction()

function(vcpkg_install_copyright)
  cmake_parse_arguments(PARSE_ARGV 0 arg "" "" "FILE_LIST")
  foreach(file IN LISTS arg_FILE_LIST)
    if(NOT EXISTS ${file})
      message(FATAL_ERROR "no file ${file}")
    endif()
  endforeach()
endfunction()

include(${port_dir}/portfile.cmake)
