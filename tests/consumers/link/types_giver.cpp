// SPDX-License-Identifier: Apache-2.0
#include "ft/kernels/pnp/problem.hpp"
#include "tests/consumers/link/passed_types.hpp"

ft::odometry_params given_params() {
  ft::odometry_params p;
  p.orb.width = 752;
  p.rules.motion.longest = 4.5;
  p.imu.T_bc.t = {0.25, -0.5, 4};
  p.imu.selection.rate_hz = 100;
  p.start.two_views.samples = 99;
  p.overlap[1].right = 7;
  return p;
}

ft::tracking given_tracking(ft::imu_measurement const& sample) {
  ft::tracking t;
  t.state = ft::tracking_state::recovering;
  t.T_world_camera.t.x = static_cast<double>(sample.accel.x);
  t.covariance[35] = static_cast<double>(sample.time_ns);
  t.imu.samples = ft::integration_status::contradicted;
  t.imu.left_out.crowded_out = 3;
  t.start_matches = 5;
  return t;
}

std::vector<std::size_t> given_sizes() { return sizes_of_types(); }

ft::rigid<double> given_product(ft::rigid<double> const& left, ft::rigid<double> const& right) {
  return product(left, right);
}

int given_pixel(ft::stereo_images const& images, int x, int y) { return images[1](x, y); }

void give_map(ft::odometry_map& map, std::vector<ft::stage_time>& times) {
  map.points.assign(1, ft::downloaded_point{{1, 2, 3}, {0, 0, 1}, 0.5f, 8, 4, 5, 6});
  map.keyframes.push_back({7, 8, ft::rigid<double>::identity()});
  times.push_back({"pose", 9});
}

void give_bad_argument(ft::place_recovery const& recovery) {
  ft::check(recovery.relocalization.pnp);
}

bool given_catch(void (*call)()) {
  try {
    call();
  } catch (ft::bad_argument const&) { return true; } catch (...) {
  }
  return false;
}
