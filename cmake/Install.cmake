# SPDX-License-Identifier: Apache-2.0
# Headers, the contracts of cameras and descriptors, CMake package (find_package(ft)) and pkg-config file. All of it is
# independent of machine and compiler, so it goes to share/. With FT_BUILD_LIBRARY also the library, whose own
# package, ftOdometry, lies beside it.

include(CMakePackageConfigHelpers)
include(GNUInstallDirs)

set(package_dir ${CMAKE_INSTALL_DATADIR}/cmake/ft)

install(DIRECTORY ${PROJECT_SOURCE_DIR}/include/ft TYPE INCLUDE)
set(contract_dir ${CMAKE_INSTALL_DATADIR}/ft)
install(FILES ${PROJECT_SOURCE_DIR}/tests/camera_contract.hpp ${PROJECT_SOURCE_DIR}/tests/descriptor_contract.hpp
        DESTINATION ${contract_dir}/tests)
install(DIRECTORY ${PROJECT_SOURCE_DIR}/tests/camera_contract ${PROJECT_SOURCE_DIR}/tests/descriptor_contract
        DESTINATION ${contract_dir}/tests)
target_include_directories(ft_camera_contract INTERFACE $<INSTALL_INTERFACE:${contract_dir}>)
install(TARGETS ft ft_camera_contract ft_descriptor_contract EXPORT ftTargets)
install(EXPORT ftTargets NAMESPACE ft:: DESTINATION ${package_dir})

configure_package_config_file(${CMAKE_CURRENT_LIST_DIR}/ftConfig.cmake.in
  ${PROJECT_BINARY_DIR}/ftConfig.cmake INSTALL_DESTINATION ${package_dir})
write_basic_package_version_file(${PROJECT_BINARY_DIR}/ftConfigVersion.cmake
  COMPATIBILITY SameMajorVersion ARCH_INDEPENDENT)
install(FILES ${PROJECT_BINARY_DIR}/ftConfig.cmake ${PROJECT_BINARY_DIR}/ftConfigVersion.cmake
              ${CMAKE_CURRENT_LIST_DIR}/CudaRuntime.cmake ${CMAKE_CURRENT_LIST_DIR}/BuildType.cmake
        DESTINATION ${package_dir})

if(FT_BUILD_LIBRARY)
  set(library_package_dir ${CMAKE_INSTALL_LIBDIR}/cmake/ftOdometry)
  install(TARGETS ft_odometry EXPORT ftOdometryTargets)
  install(EXPORT ftOdometryTargets NAMESPACE ft:: DESTINATION ${library_package_dir})
  configure_file(${CMAKE_CURRENT_LIST_DIR}/ftOdometryConfig.cmake.in ${PROJECT_BINARY_DIR}/ftOdometryConfig.cmake @ONLY)
  write_basic_package_version_file(${PROJECT_BINARY_DIR}/ftOdometryConfigVersion.cmake
    COMPATIBILITY SameMinorVersion)
  install(FILES ${PROJECT_BINARY_DIR}/ftOdometryConfig.cmake ${PROJECT_BINARY_DIR}/ftOdometryConfigVersion.cmake
          DESTINATION ${library_package_dir})
  set(private_packages)
  set(private_libraries)
  if(NOT BUILD_SHARED_LIBS)  # a static library needs what it was made of
    set(private_packages tbb)
    set(private_libraries -lstdc++ -pthread)
    if(FT_HAS_CUDA)
      list(APPEND private_libraries ${CUDA_cudart_static_LIBRARY} -ldl -lrt)
    endif()
  endif()
  list(JOIN private_libraries " " private_libraries)
  set(pkgconfig_dir ${CMAKE_INSTALL_LIBDIR}/pkgconfig)
  file(RELATIVE_PATH from_pkgconfig /${pkgconfig_dir} /)
  string(REGEX REPLACE "/$" "" from_pkgconfig ${from_pkgconfig})
  configure_file(${CMAKE_CURRENT_LIST_DIR}/ft-odometry.pc.in ${PROJECT_BINARY_DIR}/ft-odometry.pc @ONLY)
  install(FILES ${PROJECT_BINARY_DIR}/ft-odometry.pc DESTINATION ${pkgconfig_dir})
endif()

configure_file(${CMAKE_CURRENT_LIST_DIR}/ft.pc.in ${PROJECT_BINARY_DIR}/ft.pc @ONLY)
install(FILES ${PROJECT_BINARY_DIR}/ft.pc DESTINATION ${CMAKE_INSTALL_DATADIR}/pkgconfig)
install(FILES ${PROJECT_SOURCE_DIR}/LICENSE ${PROJECT_SOURCE_DIR}/NOTICE TYPE DOC)
