// SPDX-License-Identifier: Apache-2.0
// Which points of one camera's map go when a keyframe is added: those that were not seen again soon
// after they were made.
#include <gtest/gtest.h>

#include <cstdint>
#include <string>
#include <vector>

#include "ft/cameras/monocular_rig.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "ft/kernels/map/insert_keyframe.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/plain_frames.hpp"

namespace doubtful_points_test {

constexpr int positions = 6;
constexpr int slots = 32;
constexpr int capacity = 16;

template <typename Rig>
Rig make_rig() {
  if constexpr (ft::is_monocular_v<Rig>) {
    return Rig::make({400.0f, 410.0f, 320.0f, 240.0f});
  } else {
    return Rig::make({400.0f, 410.0f, 320.0f, 240.0f}, 0.1);
  }
}

/// A point of the map, and whether it outlives the next keyframe.
struct point {
  std::vector<int> seen_by;  ///< numbers of keyframes
  int described;             ///< descriptors that it ever got
  bool stays;
  char const* why;
};

/// @param made number of the newest keyframe
std::vector<point> points(int made) {
  return {
      {{made}, 0, true, "it is new"},
      {{made - 1}, 0, false, "the next keyframe did not see it"},
      {{made - 1}, 2, false, "likewise, of two descriptors"},
      {{made - 1}, 3, true, "more keyframes saw it that are gone"},
      {{made - 3}, 8, false, "three keyframes saw nothing of it, one ever did that is still there"},
      {{made - 3, made - 2}, 0, true, "two keyframes are not enough to tell"},
      {{made - 4, made - 3}, 0, false, "two see it, the three after them do not"},
      {{made - 5, made - 4, made - 3}, 0, true, "three see it"},
      {{made - 5, made}, 0, true, "it was seen just now"},
      {{}, 4, false, "nothing sees it any more"},
  };
}

template <typename Exec, typename Rig>
struct room {
  Exec const& exec;
  test::mirrored<Exec, ft::odometry_map_view> map;
  test::mirrored<Exec, test::frames_view> frames;
  test::mirrored<Exec, ft::keyframe_workspace> work;

  room(Exec const& executor, int made, std::vector<point> const& all)
      : exec(executor),
        map([](ft::carver& c, ft::odometry_map_view& v) {
          carve(c, v, {slots, {positions, 1, capacity}}, 1);
        }),
        frames([](ft::carver& c, test::frames_view& v) { carve(c, v, capacity, 1, 1, 1); }),
        work([](ft::carver& c, ft::keyframe_workspace& v) { carve(c, v, slots, capacity, 1, 1); }) {
    clear(exec, map.device);
    map.pull(exec);
    auto const& kf = map.host.keyframes;
    kf.made[0] = made;
    kf.count[0] = positions;
    auto const& r = map.host.records;
    r.made[0] = r.alive[0] = r.used[0] = static_cast<int>(all.size());
    for (int s = 0; s < r.used[0]; ++s) {
      point const& p = all[static_cast<std::size_t>(s)];
      r.number[s] = s + 1;
      r.visible[s] = r.found[s] = 1;
      r.described[s] = p.described;
      for (int const number : p.seen_by) {
        r.mask(0, s)[0] |= std::uint64_t{1} << kf.position(number);
      }
    }
    *frames.host.keypoints.slice(0).count = 0;
    frames.host.order[0] = ft::keyframe_order::add;
    frames.host.T_cw[0] = ft::rigid<double>::identity();
  }
  void insert() {
    map.push(exec);
    frames.push(exec);
    test::frames_view const& v = frames.device;
    ft::keyframe_input<Rig> const in{
        make_rig<Rig>(), v.frame(), v.order, v.T_cw,
        v.time_ns,       v.depth,   v.point, ft::pyramid_geometry::make(640, 480, 4, 1.2f)};
    ft::keyframe_params params;
    params.near_depth = 50;
    ft::insert_keyframe(exec, in, params, map.device, {v.held, v.left_out}, work.device);
    map.pull(exec);
  }
};

template <typename Backend>
class doubtful_points : public test::on_backend<Backend> {
protected:
  Backend backend;
};
TYPED_TEST_SUITE(doubtful_points, test::backends);

TYPED_TEST(doubtful_points, leave_the_map_of_one_camera) {
  for (int const made : {6, 8, 23}) {  // the ring begins at its first position, or elsewhere
    SCOPED_TRACE("keyframe " + std::to_string(made));
    auto const all = points(made);
    room<typename TypeParam::exec_type, ft::monocular_rig<>> r(this->backend.exec, made, all);
    r.insert();
    int alive = 0;
    for (std::size_t s = 0; s < all.size(); ++s) {
      // The oldest keyframe leaves the ring, and with it its bit, after points are judged.
      EXPECT_EQ(r.map.host.records.number[s] != 0, all[s].stays) << s << ": " << all[s].why;
      alive += static_cast<int>(all[s].stays);
    }
    EXPECT_EQ(r.map.host.records.alive[0], alive);
    EXPECT_EQ(r.map.host.keyframes.made[0], made + 1);
  }
}

TYPED_TEST(doubtful_points, stay_where_depths_are_measured) {
  auto all = points(8);
  all.pop_back();  // what nothing sees goes everywhere
  room<typename TypeParam::exec_type, ft::rectified_rig> r(this->backend.exec, 8, all);
  r.insert();
  for (std::size_t s = 0; s < all.size(); ++s) {
    EXPECT_NE(r.map.host.records.number[s], 0) << s << ": " << all[s].why;
  }
}

}  // namespace doubtful_points_test
