// SPDX-License-Identifier: Apache-2.0
// Images that are given before their frames are tracked: no answer changes, and what is refused.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "ft/pipelines/odometry.hpp"
#include "tests/support/allocation_count.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/effort.hpp"
#include "tests/support/odometry_answers.hpp"
#include "tests/support/room.hpp"

namespace odometry_prefetch_test {

using test::room::stereo_frame;
constexpr std::int64_t period = 50'000'000;

ft::odometry_params params(int prefetch) {
  auto p = test::room::odometry_params(4096);
  p.prefetch = prefetch;
  return p;
}
std::vector<stereo_frame> const& walk() {
  static auto const frames = test::room::make_walk(test::room::rig(), 0, 16);
  return frames;
}
std::vector<stereo_frame> const& fisheye_walk() {
  static auto const frames = test::room::make_walk(test::room::fisheye(), 1, 12);
  return frames;
}
std::int64_t time_of(std::size_t i) { return period * static_cast<std::int64_t>(i + 1); }

template <typename Exec, typename Rig>
std::vector<ft::tracking> run(Exec const& exec, Rig const& rig,
                              std::vector<stereo_frame> const& frames,
                              ft::odometry_params const& p = params(0)) {
  ft::odometry<Exec, Rig> odo(exec, rig, p);
  return test::track_all(odo, frames.size(), period,
                         [&](std::size_t i) { return images_of(frames[i]); });
}

template <typename Backend>
class odometry_prefetch : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(odometry_prefetch, test::backends);

TYPED_TEST(odometry_prefetch, changes_no_answer_of_a_rectified_pair) {
  TypeParam backend;
  auto const want = run(backend.exec, test::room::rig(), walk());
  EXPECT_GE(want.back().keyframes, 2);
  for (int const ahead : {1, 2, 5}) {
    if (ahead == 2 && !test::whole_effort()) { continue; }  // below, launch by launch
    SCOPED_TRACE(std::to_string(ahead) + " frames ahead");
    test::expect_same(run(backend.exec, test::room::rig(), walk(), params(ahead)), want);
  }
  auto launches = params(2);
  launches.use_graphs = false;
  launches.measure_stages = true;
  test::expect_same(run(backend.exec, test::room::rig(), walk(), launches), want);
}

TYPED_TEST(odometry_prefetch, changes_no_answer_of_two_fisheye_cameras) {
  TypeParam backend;
  test::expect_same(run(backend.exec, test::room::fisheye(), fisheye_walk(), params(3)),
                    run(backend.exec, test::room::fisheye(), fisheye_walk()));
}

TYPED_TEST(odometry_prefetch, of_a_batch_takes_the_images_of_all) {
  TypeParam backend;
  auto const& frames = walk();
  auto const last = frames.size() - 1;
  auto const images = [&](std::size_t i) {
    return std::vector<ft::stereo_images>{images_of(frames[i]), images_of(frames[last - i])};
  };
  ft::odometry odo(backend.exec, test::room::rig(), params(2), 2);
  EXPECT_THROW(odo.prefetch(images_of(frames[0])), ft::bad_argument);
  auto const first = images(0);
  odo.prefetch(first.data());
  EXPECT_THROW(odo.track_prefetched(period), ft::bad_argument);
  std::vector<ft::tracking> forward, backward;
  for (std::size_t i = 0; i < 6; ++i) {
    auto const next = images(i + 1);
    odo.prefetch(next.data());
    std::vector<std::int64_t> const times(2, time_of(i));
    ft::tracking const* const t = odo.track_prefetched(times.data());
    forward.push_back(t[0]);
    backward.push_back(t[1]);
  }
  auto const alone = [&](std::vector<stereo_frame> walked) {
    walked.resize(6);
    return run(backend.exec, test::room::rig(), walked);
  };
  test::expect_same(forward, alone(frames));
  test::expect_same(backward, alone({frames.rbegin(), frames.rend()}));
}

TYPED_TEST(odometry_prefetch, mixes_with_track_which_forgets_given_frames) {
  TypeParam backend;
  auto const& frames = walk();
  auto const want = run(backend.exec, test::room::rig(), frames);
  ft::odometry odo(backend.exec, test::room::rig(), params(3));
  std::vector<ft::tracking> all;
  for (std::size_t i = 0; i < frames.size(); ++i) {
    // Two frames of every three are given, and one more that is not tracked.
    if (i % 3 == 0) {
      all.push_back(odo.track(images_of(frames[i]), time_of(i)));
      EXPECT_THROW(odo.track_prefetched(time_of(i + 1)), ft::bad_argument) << "none is given";
    } else {
      if (i % 3 == 1) {
        for (std::size_t k = i; k < i + 2 && k < frames.size(); ++k) {
          odo.prefetch(images_of(frames[k]));
        }
        odo.prefetch(images_of(frames[0]));
      }
      all.push_back(odo.track_prefetched(time_of(i)));
    }
  }
  test::expect_same(all, want);
}

TYPED_TEST(odometry_prefetch, forgets_frames_whose_images_may_go_then) {
  TypeParam backend;
  auto const& frames = walk();
  auto const want = run(backend.exec, test::room::rig(), {frames.begin(), frames.begin() + 5});
  ft::odometry without(backend.exec, test::room::rig(), params(0));
  without.forget_prefetched();
  ft::odometry odo(backend.exec, test::room::rig(), params(3));
  std::vector<ft::tracking> all;
  for (std::size_t i = 0; i < 5; ++i) {
    odo.prefetch(images_of(frames[i]));
    {
      auto other = frames[i + 1];
      odo.prefetch(images_of(other));
      if (i % 2 == 0) { odo.prefetch(images_of(other)); }
      odo.forget_prefetched();
    }
    EXPECT_THROW(odo.track_prefetched(time_of(i)), ft::bad_argument);
    odo.prefetch(images_of(frames[i]));
    all.push_back(odo.track_prefetched(time_of(i)));
  }
  test::expect_same(all, want);
}

TYPED_TEST(odometry_prefetch, refuses_what_it_cannot_take_and_goes_on) {
  TypeParam backend;
  auto const& frames = walk();
  auto const want = run(backend.exec, test::room::rig(), {frames.begin(), frames.begin() + 4});
  ft::odometry without(backend.exec, test::room::rig(), params(0));
  EXPECT_THROW(without.prefetch(images_of(frames[0])), ft::bad_argument);
  EXPECT_THROW(without.track_prefetched(period), ft::bad_argument);
  for (int const out_of_range : {-1, 65}) {
    EXPECT_THROW(ft::odometry(backend.exec, test::room::rig(), params(out_of_range)),
                 ft::bad_argument);
  }

  ft::odometry odo(backend.exec, test::room::rig(), params(2));
  std::vector<ft::tracking> all;
  odo.prefetch(images_of(frames[0]));
  for (std::size_t i = 0; i < 4; ++i) {
    auto none = images_of(frames[i + 1]);
    none.right.data = nullptr;
    EXPECT_THROW(odo.prefetch(none), ft::bad_argument);
    auto narrow = images_of(frames[i + 1]);
    narrow.left.width -= 16;
    EXPECT_THROW(odo.prefetch(narrow), ft::bad_argument);
    odo.prefetch(images_of(frames[i + 1]));
    EXPECT_THROW(odo.prefetch(images_of(frames[i + 1])), ft::bad_argument) << "two are given";
    if (i > 0) { EXPECT_THROW(odo.track_prefetched(time_of(i - 1)), ft::bad_argument); }
    EXPECT_THROW(odo.stage_times(), ft::bad_argument);
    all.push_back(odo.track_prefetched(time_of(i)));
  }
  test::expect_same(all, want);
}

TYPED_TEST(odometry_prefetch, takes_a_mask_for_the_images_that_are_given_after_it) {
  TypeParam backend;
  auto const& frames = walk();
  test::room::image half(test::room::image(frames[0].left.size(), std::uint8_t{255}));
  std::fill(half.begin(), half.begin() + static_cast<std::ptrdiff_t>(half.size() / 2),
            std::uint8_t{0});
  auto p = params(2);
  p.orb.mask_width = test::room::width;
  p.orb.mask_height = test::room::height;
  ft::odometry odo(backend.exec, test::room::rig(), p);
  ft::odometry one_by_one(backend.exec, test::room::rig(), p);
  odo.prefetch(images_of(frames[0]));
  odo.prefetch(images_of(frames[1]));
  odo.set_mask(0, 0, test::room::view(half));
  std::vector<ft::tracking> all, want;
  for (std::size_t i = 0; i < 6; ++i) {
    all.push_back(odo.track_prefetched(time_of(i)));
    odo.prefetch(images_of(frames[i + 2]));
    if (i == 2) { one_by_one.set_mask(0, 0, test::room::view(half)); }
    want.push_back(one_by_one.track(images_of(frames[i]), time_of(i)));
  }
  EXPECT_LT(all[2].keypoints, all[1].keypoints);
  test::expect_same(all, want);
}

TYPED_TEST(odometry_prefetch, ends_while_frames_are_in_flight) {
  TypeParam backend;
  auto const& frames = walk();
  for (std::size_t tracked = 0; tracked < 6; tracked += test::whole_effort() ? 1 : 2) {
    ft::odometry odo(backend.exec, test::room::rig(), params(5));
    std::size_t given = 0;
    while (given < 5) { odo.prefetch(images_of(frames[given++])); }
    for (std::size_t i = 0; i < tracked; ++i) {
      EXPECT_EQ(odo.track_prefetched(time_of(i)).state, ft::tracking_state::tracking);
      odo.prefetch(images_of(frames[given++]));
    }
  }
}

TYPED_TEST(odometry_prefetch, survives_moves) {
  TypeParam backend;
  auto const& frames = walk();
  auto const want = run(backend.exec, test::room::rig(), {frames.begin(), frames.begin() + 3});
  ft::odometry odo(backend.exec, test::room::rig(), params(2));
  std::vector<ft::tracking> all;
  odo.prefetch(images_of(frames[0]));
  for (std::size_t i = 0; i < 3; ++i) {
    odo.prefetch(images_of(frames[i + 1]));
    ft::odometry<typename TypeParam::exec_type> other(std::move(odo));
    EXPECT_THROW(odo.prefetch(images_of(frames[0])), ft::bad_argument);  // NOLINT: it says so
    all.push_back(other.track_prefetched(time_of(i)));
    odo = std::move(other);
  }
  test::expect_same(all, want);
}

#if !defined(__CUDACC__)

TEST(OdometryPrefetchOnTheHost, AllocatesNothingInAFrame) {
  auto const& frames = walk();
  ft::odometry odo(ft::host_exec(2), test::room::rig(), params(2));
  odo.prefetch(images_of(frames[0]));
  odo.track_prefetched(time_of(0));
  test::allocation_count const allocations;
  auto const one = std::make_unique<int>(1);
  if (allocations.so_far() == 0) { GTEST_SKIP() << "this program does not count allocations"; }
  for (std::size_t i = 1; i < 6; ++i) {
    odo.prefetch(images_of(frames[i]));
    odo.track_prefetched(time_of(i));
  }
  EXPECT_EQ(allocations.so_far(), *one);
}

TEST(OdometryPrefetchOnTheHost, SaysWhatMemoryItTook) {
  auto const bytes = [](int prefetch) {
    ft::odometry odo(ft::host_exec(1), test::room::rig(), params(prefetch));
    auto const told = [&] { return odo.memory_bytes().executor + odo.memory_bytes().staging; };
    std::size_t const at_first = told();
    if (prefetch > 0) {
      odo.prefetch(images_of(walk()[0]));
      odo.track_prefetched(time_of(0));
    }
    EXPECT_EQ(told(), at_first);
    return at_first;
  };
  std::size_t const one = bytes(1) - bytes(0);
  EXPECT_GT(one, 2u * test::room::width * test::room::height);
  EXPECT_EQ(bytes(3) - bytes(0), 3 * one);
}

#else

TEST(OdometryPrefetchParity, HostAndDeviceGiveTheSameBits) {
  if (!test::cuda_backend::available()) { GTEST_SKIP() << "no CUDA device"; }
  test::cuda_backend backend;
  test::expect_same(run(backend.exec, test::room::rig(), walk(), params(2)),
                    run(ft::host_exec(), test::room::rig(), walk(), params(2)));
}

#endif

}  // namespace odometry_prefetch_test
