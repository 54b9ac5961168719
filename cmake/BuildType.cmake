# SPDX-License-Identifier: Apache-2.0
# Of projects that use ft: a single-configuration generator without a build type compiles without optimisation.

get_property(ft_build_type_looked_at GLOBAL PROPERTY ft_build_type_looked_at)
get_property(ft_multi_config GLOBAL PROPERTY GENERATOR_IS_MULTI_CONFIG)
if(NOT ft_build_type_looked_at AND NOT ft_multi_config AND NOT CMAKE_BUILD_TYPE
   AND NOT CMAKE_CXX_FLAGS MATCHES "(^| )-O([1-9sz]|fast| |$)" AND NOT CMAKE_SCRIPT_MODE_FILE)
  message(WARNING "ft: no build type is set, so the compiler does not optimise, and the host executor is about 30 \
times slower: -DCMAKE_BUILD_TYPE=Release")
endif()
set_property(GLOBAL PROPERTY ft_build_type_looked_at TRUE)
unset(ft_build_type_looked_at)
unset(ft_multi_config)
