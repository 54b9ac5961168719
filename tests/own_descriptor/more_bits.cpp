// SPDX-License-Identifier: Apache-2.0
// 488 bits, as many bytes as AKAZE has.
#define FT_DESCRIPTOR more_bits
#include <cstring>
#include <string>

#include "ft/descriptors/binary_descriptor.hpp"

struct more_bits : ft::binary_descriptor<488> {
  static constexpr char const* name = "more_bits";
};

#include "tests/own_descriptor/follow.hpp"

namespace own_descriptor_test {

/// Most of ORB's bits twice.
answers track_more_bits(given_walk const& given, std::string const& orb_map) {
  return follow(given, pair_of(given), orb_map, [](orb_bytes const& orb) {
    more_bits own{};
    std::memcpy(own.words, orb, sizeof orb);
    std::memcpy(own.words + 8, orb, 61 - sizeof orb);
    return own;
  });
}

#if !defined(__CUDACC__)
int keypoints_of_a_frame(int count, float const* positions, std::int64_t time_ns) {
  std::vector<more_bits> const rows(static_cast<std::size_t>(count));
  more_bits const* const descriptors = rows.data();

  auto const rig = ft::rectified_rig::make({435.0f, 435.0f, 367.0f, 252.0f}, 0.11f);  // pixels, m
  ft::odometry_params params;
  params.orb.width = 752;
  params.orb.height = 480;
  params.own_features = true;
  ft::odometry odo(ft::host_exec(), rig, params, 1, ft::own_features{});

  ft::given_features frame;  // and frame.right likewise, or frame.left.right_x
  frame.left.count = count;
  frame.left.positions = positions;      // [count][2] pixels
  frame.left.descriptors = descriptors;  // [count], more_bits
  frame.left.descriptor_bytes = sizeof(more_bits);
  ft::tracking const pose = odo.track(frame, time_ns);
  return pose.keypoints;
}
#endif

}  // namespace own_descriptor_test
