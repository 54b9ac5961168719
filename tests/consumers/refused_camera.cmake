# SPDX-License-Identifier: Apache-2.0
# cmake -DCXX=COMPILER -DINCLUDE=FOLDER -P refused_camera.cmake: a rig of a type that misses the camera contract is one
# error that names what is missing, however much of the library is instantiated with the rig.
cmake_minimum_required(VERSION 3.22)

set(camera [[
#include "ft/cameras/stereo_rig.hpp"
#include "ft/pipelines/frame_tracker.hpp"
template <typename Scalar>
struct lens {
  using scalar_type = Scalar;
  static constexpr char const* name = "lens";
  static constexpr auto parameters = ft::camera_parameters();
  Scalar fx, fy, cx, cy;
  @EXTRA@
  ft::projection<Scalar> project(ft::vec3<Scalar>) const { return {{cx, cy}, false}; }
  ft::@RAY@<Scalar> unproject(ft::vec2<Scalar>) const { return {}; }
  ft::projection_with_jacobian<Scalar> @JACOBIAN@(ft::vec3<Scalar>) const { return {}; }
  template <typename U>
  lens<U> cast() const { return {}; }
  void check() const {}
};
using rig = ft::stereo_rig<lens<float>, lens<float>>;
int main() {
  rig const two{{1, 1, 0, 0}, {1, 1, 0, 0}, ft::pose::identity()};
  two.check();
  ft::host_exec const exec;
  ft::frame_tracker<ft::host_exec, rig> tracker(exec, two, ft::tracker_params{});
  tracker.extract(exec);
}
]])

function(compile)  # sets `code`, `errors` and `output`
  string(CONFIGURE "${camera}" text @ONLY)
  set(unit ${CMAKE_CURRENT_BINARY_DIR}/refused_camera.cpp)
  file(WRITE ${unit} "${text}")
  execute_process(COMMAND ${CXX} -std=c++17 -fsyntax-only -I${INCLUDE} ${unit}
                  RESULT_VARIABLE result OUTPUT_QUIET ERROR_VARIABLE said)
  string(REGEX MATCHALL "error:[^\n]*" found "${said}")
  set(code ${result} PARENT_SCOPE)
  set(errors "${found}" PARENT_SCOPE)
  set(output "${said}" PARENT_SCOPE)
endfunction()
function(expect_refused message)
  compile()
  list(LENGTH errors count)
  if(code EQUAL 0 OR NOT count EQUAL 1 OR NOT errors MATCHES "${message}")
    message(SEND_ERROR "not refused by one error with '${message}': ${output}")
  endif()
endfunction()

set(RAY ray)
set(JACOBIAN project_with_jacobian)
set(EXTRA "")
compile()
if(NOT code EQUAL 0)
  message(SEND_ERROR "a camera that keeps the contract is refused: ${output}")
endif()

set(JACOBIAN project_jacobian)
expect_refused("a camera model needs: ft::projection_with_jacobian<Scalar> project_with_jacobian")
set(JACOBIAN project_with_jacobian)
set(RAY projection)
expect_refused("a camera model needs: ft::ray<Scalar> unproject")
set(RAY ray)
set(EXTRA "Scalar inverse_fx;")
expect_refused("a camera model holds its parameters and nothing else")
