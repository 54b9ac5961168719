# SPDX-License-Identifier: Apache-2.0
# Links `target` (an interface) to the CUDA runtime that CMake links where the CUDA language is enabled:
# the static one, unless the including target's CUDA_RUNTIME_LIBRARY says otherwise. A program with both
# runtimes in it would keep two of every state.
function(ft_link_cuda_runtime target)
  set(choice $<UPPER_CASE:$<TARGET_PROPERTY:CUDA_RUNTIME_LIBRARY>>)
  set_property(TARGET ${target} APPEND PROPERTY INTERFACE_LINK_LIBRARIES
    $<$<STREQUAL:${choice},SHARED>:CUDA::cudart>
    $<$<NOT:$<OR:$<STREQUAL:${choice},SHARED>,$<STREQUAL:${choice},NONE>>>:CUDA::cudart_static>)
endfunction()
