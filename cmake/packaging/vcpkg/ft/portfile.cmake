# SPDX-License-Identifier: Apache-2.0
# An overlay port of this source tree:  vcpkg install ft --overlay-ports=FOLDER/cmake/packaging/vcpkg
# Headers only, so there is nothing to build and no debug version.
get_filename_component(SOURCE_PATH "${CMAKE_CURRENT_LIST_DIR}/../../../.." ABSOLUTE)
set(VCPKG_BUILD_TYPE release)

vcpkg_cmake_configure(
  SOURCE_PATH "${SOURCE_PATH}"
  OPTIONS
    -DFT_ENABLE_CUDA=OFF
    -DFT_BUILD_TESTS=OFF
    -DFT_BUILD_EXAMPLES=OFF
    -DFT_BUILD_BENCH=OFF)
vcpkg_cmake_install()
vcpkg_cmake_config_fixup(CONFIG_PATH share/cmake/ft)
vcpkg_fixup_pkgconfig()

file(INSTALL "${CMAKE_CURRENT_LIST_DIR}/usage" DESTINATION "${CURRENT_PACKAGES_DIR}/share/${PORT}")
vcpkg_install_copyright(FILE_LIST "${SOURCE_PATH}/LICENSE" "${SOURCE_PATH}/NOTICE")
