# SPDX-License-Identifier: Apache-2.0
# Compiles each public header alone as C++: the target header_check_host, built on request, since scripts/test.sh
# has clang++ do the same where there is one. With CUDA those headers which nvcc reads differently, and stages.hpp, are
# also compiled alone as CUDA, for one architecture: for nvcc the others have the same text as for a C++ compiler.

file(GLOB_RECURSE headers CONFIGURE_DEPENDS RELATIVE ${PROJECT_SOURCE_DIR}/include
     ${PROJECT_SOURCE_DIR}/include/ft/*.hpp)
list(FILTER headers EXCLUDE REGEX "/detail/")

# Headers of interop need their third party: Thrust comes with CUDA, OpenCV and Eigen are optional.
set(host_headers ${headers})
list(FILTER host_headers EXCLUDE REGEX "^ft/interop/thrust.hpp$")
if(NOT OpenCV_FOUND)
  list(FILTER headers EXCLUDE REGEX "^ft/interop/opencv.hpp$")
  list(FILTER host_headers EXCLUDE REGEX "^ft/interop/opencv.hpp$")
endif()
find_package(Eigen3 3.3 QUIET NO_MODULE)
if(NOT TARGET Eigen3::Eigen)
  list(FILTER headers EXCLUDE REGEX "^ft/interop/eigen.hpp$")
  list(FILTER host_headers EXCLUDE REGEX "^ft/interop/eigen.hpp$")
endif()

function(ft_add_header_check target extension)
  set(units)
  foreach(header IN LISTS ARGN)
    set(unit ${CMAKE_CURRENT_BINARY_DIR}/${target}/${header}.${extension})
    # Twice, so that a missing include guard shows as well.
    file(CONFIGURE OUTPUT ${unit} CONTENT "#include \"${header}\"\n#include \"${header}\"\n" @ONLY)
    if(header MATCHES "eigen" AND extension STREQUAL cu)  # a warning about Eigen 3.4's own functions
      set_source_files_properties(${unit} PROPERTIES COMPILE_OPTIONS -diag-suppress=20015)
    endif()
    list(APPEND units ${unit})
  endforeach()
  if(units)
    add_library(${target} OBJECT ${units})
    ft_target_defaults(${target})
    if(OpenCV_FOUND)
      target_link_libraries(${target} PRIVATE ${OpenCV_LIBS})
    endif()
    if(TARGET Eigen3::Eigen)
      target_link_libraries(${target} PRIVATE Eigen3::Eigen)
    endif()
  endif()
endfunction()

ft_add_header_check(header_check_host cpp ${host_headers})
if(TARGET header_check_host)
  target_link_libraries(header_check_host PRIVATE ft::ft)
  set_target_properties(header_check_host PROPERTIES EXCLUDE_FROM_ALL ON)
endif()
if(FT_HAS_CUDA)
  set(cuda_headers)
  foreach(header IN LISTS headers)
    file(STRINGS ${PROJECT_SOURCE_DIR}/include/${header} cuda_lines LIMIT_COUNT 1
         REGEX "__CUDA|include [<\"](cuda|cub|thrust|cooperative)")
    if(cuda_lines OR header MATCHES "^ft/(stages\\.hpp|interop/.*)$")
      list(APPEND cuda_headers ${header})
    endif()
  endforeach()
  ft_add_header_check(header_check_cuda cu ${cuda_headers})
  if(TARGET header_check_cuda)
    target_link_libraries(header_check_cuda PRIVATE ft::cuda)
    list(GET CMAKE_CUDA_ARCHITECTURES -1 architecture)
    set_target_properties(header_check_cuda PROPERTIES CUDA_ARCHITECTURES ${architecture})
  endif()
endif()
