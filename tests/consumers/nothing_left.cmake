# SPDX-License-Identifier: Apache-2.0
# A part of another project defines nothing but the library.
get_property(targets DIRECTORY ${FT_SOURCE_DIR} PROPERTY BUILDSYSTEM_TARGETS)
list(REMOVE_ITEM targets ft ft_camera_contract ft_descriptor_contract ft_cuda)
if(targets OR CMAKE_RUNTIME_OUTPUT_DIRECTORY OR CMAKE_CXX_COMPILER_LAUNCHER)
  message(FATAL_ERROR "ft left something behind: ${targets}")
endif()
