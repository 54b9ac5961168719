# SPDX-License-Identifier: Apache-2.0
# The part that the CMake consumers share.
set(source ${CMAKE_CURRENT_LIST_DIR}/consumer.cpp)
if(CONSUMER_CUDA STREQUAL "ON")
  enable_language(CUDA)
  set_source_files_properties(${source} PROPERTIES LANGUAGE CUDA)
endif()
add_executable(consumer ${source})
if(CONSUMER_CUDA STREQUAL "OFF")
  target_link_libraries(consumer PRIVATE ft::ft)
else()
  target_link_libraries(consumer PRIVATE ft::cuda)
endif()
