# SPDX-License-Identifier: Apache-2.0
# What the applications and their support library need beyond the library itself.

find_package(Eigen3 3.3 REQUIRED NO_MODULE)
find_package(PNG REQUIRED)
find_package(JPEG REQUIRED)
find_package(TIFF QUIET)  # without it TIFF images are refused
if(NOT TARGET TIFF::TIFF)
  message(STATUS "ft: libtiff not found, TIFF images will not be read")
endif()
find_package(yaml-cpp REQUIRED)
find_package(nlohmann_json REQUIRED)
if(NOT TARGET yaml-cpp::yaml-cpp)  # before yaml-cpp 0.8
  add_library(yaml-cpp::yaml-cpp ALIAS yaml-cpp)
endif()
