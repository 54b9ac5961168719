// SPDX-License-Identifier: Apache-2.0
#include <cmath>
#include <cstdio>
#include <cstring>
#include <string>

#include "ft/kernels/two_view/problem.hpp"
#include "tests/consumers/link/passed_types.hpp"

namespace {

int failures = 0;

void expect(bool holds, char const* what) {
  if (holds) { return; }
  ++failures;
  std::fprintf(stderr, "not so: %s\n", what);
}

bool same_bits(ft::rigid<double> const& a, ft::rigid<double> const& b) {
  return std::memcmp(&a, &b, sizeof a) == 0;
}

ft::rigid<double> turned(double angle, double x) {
  double const s = std::sin(angle);
  double const c = std::cos(angle);
  return {{{c, -s, 0, s, c, 0, 0, 0, 1}}, {x, 0.1 * x, -x / 3}};
}

void take_values() {
  ft::odometry_params const p = given_params();
  ft::odometry_params const plain;
  expect(p.orb.width == 752 && p.rules.motion.longest == 4.5, "settings come as they were given");
  expect(p.imu.T_bc.t.z == 4 && p.imu.T_bc.R.m[8] == 1, "the IMU's place comes as it was given");
  expect(p.imu.selection.rate_hz == 100 && p.start.two_views.samples == 99, "nested settings");
  expect(p.overlap[1].right == 7 && !p.overlap[0].has_none(752), "overlaps");
  expect(p.keyframes == plain.keyframes && p.rules.keep_share == plain.rules.keep_share,
         "what was not set is the default of both units");
  ft::tracking const t = given_tracking({1000000007, {1.5f, 2, 3}, {4, 5, 6}});
  expect(t.state == ft::tracking_state::recovering && t.T_world_camera.t.x == 1.5, "state, pose");
  expect(t.covariance[35] == 1000000007 && t.imu.left_out.crowded_out == 3, "covariance, counts");
  expect(!ft::usable(t.imu.samples) && t.start_matches == 5, "status of samples, matches");
  expect(given_sizes() == sizes_of_types(), "sizes of types");
  std::uint8_t const pixels[] = {1, 2, 3, 4, 5, 6};
  expect(given_pixel({{}, {pixels, 2, 2, 3}}, 1, 1) == 5, "a pixel of an image");
  ft::odometry_map map;
  std::vector<ft::stage_time> times;
  give_map(map, times);
  expect(map.points.size() == 1 && map.points[0].keyframes == 6, "points of a map");
  expect(map.keyframes.size() == 1 && map.keyframes[0].time_ns == 8, "keyframes of a map");
  expect(times.size() == 1 && std::string(times[0].name) == "pose", "times of stages");
}

/// The same bits whichever instructions either unit is compiled for.
void take_products() {
  bool same = true;
  for (int i = 0; i < 1000; ++i) {
    ft::rigid<double> const left = turned(0.013 * i, 1.7 * i);
    ft::rigid<double> const right = turned(3.1 - 0.021 * i, 0.3 * i);
    same = same && same_bits(product(left, right), given_product(left, right));
  }
  expect(same, "products have the same bits in both units");
}

void take_exceptions() {
  ft::place_recovery recovery;
  recovery.relocalization.pnp.min_share = 1.5f;
  std::string said;
  try {
    give_bad_argument(recovery);
  } catch (ft::bad_argument const& e) { said = e.what(); } catch (std::exception const&) {
    said = "another exception";
  }
  expect(said == "ft: min_share is 1.5, must be in [0, 1]", said.c_str());
  bool as_base = false;
  try {
    give_bad_argument(recovery);
  } catch (ft::error const&) { as_base = true; }
  expect(as_base, "a bad_argument is caught as an error");
  auto const refused = [] {
    ft::two_view_params p;
    p.samples = 0;
    ft::check(p);
  };
  expect(given_catch(refused), "a bad_argument of this unit is caught in the other one");
  expect(!given_catch([] { throw ft::cuda_error("no"); }), "another exception is not taken for it");
  expect(!given_catch([] {}), "nothing is caught where nothing is thrown");
}

}  // namespace

int main() {
  take_values();
  take_products();
  take_exceptions();
  return failures == 0 ? 0 : 1;
}
