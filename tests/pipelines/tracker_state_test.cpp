// SPDX-License-Identifier: Apache-2.0
// What a tracker keeps from one frame to the next, how its inputs are given, its results as ranges,
// and the times of its stages.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cstring>
#include <initializer_list>
#include <limits>
#include <map>
#include <memory>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "ft/pipelines/frame_tracker.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/room.hpp"
#include "tests/support/tracking.hpp"

namespace tracker_state {

using namespace test::room;  // NOLINT(google-build-using-namespace)
using test::same_bits;
using test::snapshot;

/// The three frames of a walk of this kind of cameras.
template <typename Rig>
std::vector<stereo_frame> const& walk_of(Rig const& rig) {
  static std::vector<stereo_frame> const frames = make_walk(rig, 0, 3);
  return frames;
}

template <typename Call>
void for_both_rigs(Call const& call) {
  {
    SCOPED_TRACE("rectified");
    call(rig());
  }
  SCOPED_TRACE("fisheye");
  call(fisheye());
}

bool same_pose(ft::pose const& a, ft::pose const& b) { return std::memcmp(&a, &b, sizeof a) == 0; }

/// A tracker that has seen the first frame of its walk, and has a map of it.
template <typename Exec, typename Rig>
struct tracked_walk {
  using tracker_type = ft::frame_tracker<Exec, Rig>;

  Exec const& exec;
  std::vector<stereo_frame> const& frames;
  tracker_type tracker;
  std::vector<int> holders;  ///< of the first frame's keypoints
  std::vector<int> slots;    ///< of all points

  tracked_walk(Exec const& e, Rig const& rig, ft::tracker_params const& p = params())
      : exec(e), frames(walk_of(rig)), tracker(e, rig, p) {
    set_images(tracker, 0, frames[0]);
    test::frame_inputs in(tracker);
    in.predicted[0] = first_pose();
    in.extract(exec);
    exec.wait();
    make_map(in, exec, 0, 0);
    holders = in.last_holder;
    slots.assign(in.local_slots.begin(), in.local_slots.begin() + in.local_count[0]);
    use_first();
  }
  tracked_walk(tracked_walk const&) = delete;
  tracked_walk& operator=(tracked_walk const&) = delete;

  ft::pose const& first_pose() const { return frames[0].T_cw; }
  /// The first frame becomes the last one, whatever came in between.
  void use_first() {
    set_images(tracker, 0, frames[0]);
    tracker.extract(exec);
    exec.wait();
    tracker.set_last(exec, 0, first_pose(), holders);
    exec.wait();
  }
  void see(int frame) { set_images(tracker, 0, frames[at(frame)]); }
  snapshot result(bool local) {
    exec.wait();
    return take(tracker, 0, local);
  }
  snapshot track(int frame) {
    see(frame);
    tracker.track(exec, {first_pose(), slots});
    return result(true);
  }
  snapshot track_motion(int frame) {
    see(frame);
    tracker.track_motion(exec, first_pose());
    return result(false);
  }
};

template <typename Backend>
class tracker_state_test : public test::on_backend<Backend> {
protected:
  using exec_type = typename Backend::exec_type;

  void SetUp() override {
    test::on_backend<Backend>::SetUp();
    if (!this->IsSkipped() && !this->HasFailure()) { backend_ = std::make_unique<Backend>(); }
  }
  exec_type const& exec() const { return backend_->exec; }

private:
  std::unique_ptr<Backend> backend_;
};
TYPED_TEST_SUITE(tracker_state_test, test::backends);

// ---- the last frame ---------------------------------------------------------------------------

/// Two frames after the first: the second depends on what the first left.
/// @param between called with the walk between the two
template <typename Exec, typename Rig, typename Between>
std::vector<snapshot> two_frames(Exec const& exec, Rig const& rig, ft::tracker_params const& p,
                                 bool whole, Between const& between) {
  tracked_walk<Exec, Rig> walk(exec, rig, p);
  std::vector<snapshot> all;
  ft::pose T = walk.first_pose();
  for (int frame = 1; frame < 3; ++frame) {
    if (frame == 2) { between(walk); }
    walk.see(frame);
    if (whole) {
      walk.tracker.track(exec, {T, walk.slots});
    } else {
      walk.tracker.track_motion(exec, T);
      all.push_back(walk.result(false));
      walk.tracker.track_local(exec, walk.slots);
    }
    all.push_back(walk.result(true));
    T = walk.tracker.frame().T_cw();
  }
  return all;
}

TYPED_TEST(tracker_state_test, the_last_state_is_the_results_pose_and_holders) {
  auto const& exec = this->exec();
  for_both_rigs([&](auto const& rig) {
    for (bool const use_graphs : test::both(true)) {
      for (bool const whole : test::both(true)) {
        SCOPED_TRACE(std::string(use_graphs ? "graphs" : "launch by launch") +
                     (whole ? ", one call" : ", two halves"));
        auto p = params();
        p.use_graphs = use_graphs;
        auto const own = two_frames(exec, rig, p, whole, [](auto const&) {});
        auto const given = two_frames(exec, rig, p, whole, [&](auto& walk) {
          auto const& r = walk.tracker.result();
          std::vector<int> const held(r.holder, r.holder + r.numbers());
          walk.tracker.set_last(exec, 0, walk.tracker.frame().T_cw(), held);
        });
        expect_same(own, given);
        // Which is not the result of any last state.
        auto const nothing = two_frames(exec, rig, p, whole, [&](auto& walk) {
          walk.tracker.set_last(exec, 0, walk.first_pose(),
                                std::vector<int>(walk.holders.size(), -1));
        });
        EXPECT_GT(own.back().inliers, 100);
        EXPECT_NE(nothing.back().holder, own.back().holder);
        if (!whole) {
          EXPECT_GT(own[2].matches, 100);
          EXPECT_EQ(nothing[2].matches, 0);
        }
      }
    }
  });
}

TYPED_TEST(tracker_state_test, a_batch_keeps_the_last_states_of_its_pairs_apart) {
  auto const& exec = this->exec();
  ft::frame_tracker<typename TestFixture::exec_type> tracker(exec, rig(), params(), 2);
  test::frame_inputs in(tracker);
  auto const together = track(in, exec, {&walk(0), &walk(1)});
  // The same once more, but that the second of the tracked frames gets nothing from the host: the
  // walk of pair 1 has lost its last frame, that of pair 0 has not.
  for (int b = 0; b < 2; ++b) { set_images(tracker, b, walk(static_cast<unsigned>(b))[2]); }
  tracker.set_last(exec, 1, walk(1)[1].T_cw, std::vector<int>(at(tracker.capacity()), -1));
  tracker.track_motion(exec, in.predicted.data());
  exec.wait();
  EXPECT_GT(tracker.frame(0).matches(), 100);
  EXPECT_EQ(tracker.frame(1).matches(), 0);
}

TYPED_TEST(tracker_state_test, the_first_last_pose_is_the_identity_and_extract_keeps_it) {
  auto const& exec = this->exec();
  for_both_rigs([&](auto const& rig) {
    using rig_type = std::decay_t<decltype(rig)>;
    ft::frame_tracker<typename TestFixture::exec_type, rig_type> fresh(exec, rig, params());
    set_images(fresh, 0, walk_of(rig)[0]);
    fresh.extract(exec);
    exec.wait();
    EXPECT_TRUE(same_pose(fresh.frame().T_cw(), ft::pose::identity()));

    tracked_walk<typename TestFixture::exec_type, rig_type> walk(exec, rig);
    auto const seen = walk.track(1);
    ASSERT_GT(seen.inliers, 100);
    walk.see(2);
    walk.tracker.extract(exec);
    auto const extracted = walk.result(false);
    EXPECT_TRUE(same_pose(extracted.T_cw, seen.T_cw));
    EXPECT_EQ(held(extracted), 0);
    auto const next = walk.track_motion(2);
    EXPECT_EQ(next.matches, 0) << "a keypoint of an extracted frame holds nothing";
    EXPECT_TRUE(same_pose(next.T_cw, walk.first_pose())) << "which is the predicted one";
  });
}

TYPED_TEST(tracker_state_test, relocalize_leaves_its_pose_and_holders) {
  auto const& exec = this->exec();
  for_both_rigs([&](auto const& rig) {
    using rig_type = std::decay_t<decltype(rig)>;
    std::vector<snapshot> of[2];
    for (bool const given : {false, true}) {
      tracked_walk<typename TestFixture::exec_type, rig_type> walk(exec, rig);
      walk.see(1);
      walk.tracker.extract(exec);
      exec.wait();
      walk.tracker.relocalize(exec, {walk.first_pose(), walk.slots}, {5, 0});
      of[given].push_back(walk.result(true));
      if (given) {
        auto const& s = of[1].back();
        walk.tracker.set_last(exec, 0, s.T_cw, s.holder);
      }
      of[given].push_back(walk.track_motion(2));
    }
    expect_same(of[1], of[0]);
    EXPECT_GT(of[0][0].inliers, 50);
    EXPECT_GT(of[0][1].matches, 50);
  });
}

TYPED_TEST(tracker_state_test, a_frame_with_the_number_of_an_earlier_one_knows_nothing_of_it) {
  auto const& exec = this->exec();
  tracked_walk<typename TestFixture::exec_type, ft::rectified_rig> walk(exec, rig());
  std::vector<int> const none(walk.holders.size(), -1);
  auto const track_without_last = [&] {
    walk.tracker.set_last(exec, 0, walk.first_pose(), none);
    return walk.track(1);
  };
  auto const want = track_without_last();  // number 1
  ASSERT_GT(want.matches, 100);
  walk.use_first();
  ASSERT_GT(walk.track_motion(1).matches, 100);  // number 2, by which map points are stamped
  for (int number = 3; number < ft::detail::frame_numbers + 2; ++number) {
    walk.tracker.relocalize(exec, {walk.first_pose(), {}});
    exec.wait();
  }
  walk.use_first();
  expect_same(track_without_last(), want);  // number 2 again
}

TYPED_TEST(tracker_state_test, a_moved_tracker_keeps_its_last_state) {
  auto const& exec = this->exec();
  tracked_walk<typename TestFixture::exec_type, ft::rectified_rig> stays(exec, rig());
  stays.track(1);
  auto const want = stays.track_motion(2);
  ASSERT_GT(want.matches, 100);
  tracked_walk<typename TestFixture::exec_type, ft::rectified_rig> walk(exec, rig());
  walk.track(1);
  auto moved = std::move(walk.tracker);
  set_images(moved, 0, walk.frames[2]);
  moved.track_motion(exec, walk.first_pose());
  exec.wait();
  expect_same(take(moved, 0, false), want);
}

TYPED_TEST(tracker_state_test, set_last_refuses_what_no_frame_leaves_and_changes_nothing) {
  auto const& exec = this->exec();
  for_both_rigs([&](auto const& rig) {
    using rig_type = std::decay_t<decltype(rig)>;
    tracked_walk<typename TestFixture::exec_type, rig_type> walk(exec, rig);
    auto& tracker = walk.tracker;
    auto const want = walk.track(1);
    walk.use_first();
    auto const refused = [&](int b, ft::pose const& T, ft::slot_list holders) {
      EXPECT_THROW(tracker.set_last(exec, b, T, holders), ft::bad_argument);
    };
    auto const identity = ft::pose::identity();
    int const numbers = tracker.cameras * tracker.capacity();
    std::vector<int> const nothing(at(numbers) + 1, -1);
    for (int const count : {numbers + 1, numbers - 1, 1, 0, -1, std::numeric_limits<int>::max()}) {
      refused(0, identity, {nothing.data(), count});
    }
    if (tracker.cameras == 2) { refused(0, identity, {nothing.data(), tracker.capacity()}); }
    refused(0, identity, {});
    refused(1, identity, {nothing.data(), numbers});
    refused(-1, identity, {nothing.data(), numbers});
    for (int k = 0; k < 12; ++k) {
      for (float const v :
           {std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity(),
            -std::numeric_limits<float>::infinity()}) {
        auto T = identity;
        (k < 9 ? T.R.m[k] : k == 9 ? T.t.x : k == 10 ? T.t.y : T.t.z) = v;
        refused(0, T, {nothing.data(), numbers});
      }
    }
    expect_same(walk.track(1), want);
  });
}

// ---- inputs -----------------------------------------------------------------------------------

TEST(slot_list, is_a_view_of_anything_with_data_and_size) {
  auto const expect_view = [](ft::slot_list const& s, int const* data, int count) {
    EXPECT_EQ(s.data, data);
    EXPECT_EQ(s.count, count);
  };
  std::vector<int> const vector{4, 5, 6};
  expect_view(vector, vector.data(), 3);
  std::vector<int> changing{1};
  expect_view(changing, changing.data(), 1);
  std::array<int, 2> const array{7, 8};
  expect_view(array, array.data(), 2);
  expect_view(std::array<int, 0>{}, std::array<int, 0>{}.data(), 0);
  EXPECT_EQ(ft::slot_list(std::vector<int>{}).count, 0);
  int const raw[] = {1, 2, 3};
  expect_view({raw, 2}, raw, 2);
  expect_view({}, nullptr, 0);
  ft::slot_list const of_vector = vector;
  ft::slot_list const copy = of_vector;
  expect_view(copy, vector.data(), 3);
  expect_view(ft::frame_input{}.local_slots, nullptr, 0);
  EXPECT_TRUE(same_pose(ft::frame_input{}.T_predicted, ft::pose::identity()));
}

TYPED_TEST(tracker_state_test, slots_come_from_any_container) {
  auto const& exec = this->exec();
  tracked_walk<typename TestFixture::exec_type, ft::rectified_rig> walk(exec, rig());
  auto const& T = walk.first_pose();
  std::array<int, 60> few{};
  std::copy_n(walk.slots.begin(), few.size(), few.begin());
  auto const with = [&](ft::slot_list slots) {
    walk.use_first();
    walk.track_motion(1);
    walk.tracker.track_local(exec, slots);
    return walk.result(true);
  };
  std::vector<int> const vector(few.begin(), few.end());
  auto const want = with({few.data(), static_cast<int>(few.size())});
  auto const in_view = [](snapshot const& s) {
    return std::count(s.in_view.begin(), s.in_view.end(), 1);
  };
  EXPECT_GT(want.inliers, 100);
  EXPECT_GT(in_view(with(walk.slots)), 0);
  expect_same(with(vector), want);
  expect_same(with(few), want);
  walk.use_first();
  walk.see(1);
  walk.tracker.track(exec, {T, few});
  expect_same(walk.result(true), want);
}

TYPED_TEST(tracker_state_test, a_batch_refuses_the_input_of_one_pair) {
  auto const& exec = this->exec();
  ft::frame_tracker<typename TestFixture::exec_type> tracker(exec, rig(), params(), 2);
  for (int b = 0; b < 2; ++b) { set_images(tracker, b, walk(static_cast<unsigned>(b))[0]); }
  ft::frame_input const input;
  std::vector<ft::frame_input> const inputs(2);
  std::vector<ft::pose> const predicted(2, ft::pose::identity());
  std::vector<ft::slot_list> const slots(2);
  EXPECT_THROW(tracker.track(exec, input), ft::bad_argument);
  EXPECT_THROW(tracker.track_motion(exec, ft::pose::identity()), ft::bad_argument);
  EXPECT_THROW(tracker.track_local(exec, ft::slot_list{}), ft::bad_argument);
  EXPECT_THROW(tracker.relocalize(exec, input), ft::bad_argument);
  EXPECT_NO_THROW(tracker.track(exec, inputs.data()));
  exec.wait();
  EXPECT_NO_THROW(tracker.track_motion(exec, predicted.data()));
  exec.wait();
  EXPECT_NO_THROW(tracker.track_local(exec, slots.data()));
  exec.wait();
  EXPECT_NO_THROW(tracker.relocalize(exec, inputs.data()));
  exec.wait();
  EXPECT_GT(tracker.frame(1).left().size(), 100);
}

TYPED_TEST(tracker_state_test, a_frame_needs_no_local_map) {
  auto const& exec = this->exec();
  for_both_rigs([&](auto const& rig) {
    using rig_type = std::decay_t<decltype(rig)>;
    tracked_walk<typename TestFixture::exec_type, rig_type> walk(exec, rig);
    auto const with_map = walk.track(1);  // whose slots must not be searched again
    EXPECT_GT(std::count(with_map.in_view.begin(), with_map.in_view.end(), 1), 0);
    walk.use_first();
    walk.see(1);
    walk.tracker.track(exec, {walk.first_pose()});
    auto const once = walk.result(true);
    EXPECT_EQ(once.matches, 0);
    EXPECT_GT(once.inliers, 100);
    EXPECT_EQ(once.inliers, held(once));
    EXPECT_EQ(std::count(once.in_view.begin(), once.in_view.end(), 1), 0);

    walk.use_first();
    auto const motion = walk.track_motion(1);
    walk.tracker.track_local(exec, {});
    expect_same(walk.result(true), once);
    EXPECT_LE(once.inliers, motion.inliers);
    for (std::size_t i = 0; i < once.holder.size(); ++i) {
      EXPECT_TRUE(once.holder[i] == -1 || once.holder[i] == motion.holder[i]);
    }
    walk.tracker.relocalize(exec, {});
    auto const none = walk.result(true);
    EXPECT_EQ(held(none), 0);
    EXPECT_TRUE(same_pose(none.T_cw, ft::pose::identity()));
    walk.tracker.track(exec, {});
    EXPECT_EQ(walk.result(true).keypoints, once.keypoints);
  });
}

TYPED_TEST(tracker_state_test, parameters_of_relocalize_are_of_that_call_alone) {
  auto const& exec = this->exec();
  for (bool const use_graphs : test::both(true)) {
    SCOPED_TRACE(use_graphs ? "graphs" : "launch by launch");
    auto p = params();
    p.use_graphs = use_graphs;
    tracked_walk<typename TestFixture::exec_type, ft::rectified_rig> walk(exec, rig(), p);
    ft::local_search_params wide;
    wide.radius_factor = 6;
    wide.max_distance = 4;
    ft::frame_input const input{walk.first_pose(), walk.slots};
    auto const relocalized = [&](auto const&... search) {
      walk.see(1);
      walk.tracker.extract(exec);
      exec.wait();
      walk.tracker.relocalize(exec, input, search...);
      return walk.result(true);
    };
    auto const usual = relocalized();
    auto const other = relocalized(wide);
    EXPECT_NE(other.holder, usual.holder);
    expect_same(relocalized(), usual);

    walk.use_first();
    auto const tracked = walk.track(1);
    auto const local = [&] {
      walk.use_first();
      walk.track_motion(1);
      walk.tracker.track_local(exec, walk.slots);
      return walk.result(true);
    };
    expect_same(local(), tracked);
    relocalized(wide);
    expect_same(local(), tracked);
    relocalized(wide);
    walk.use_first();
    expect_same(walk.track(1), tracked);
  }
}

// ---- the result as ranges ---------------------------------------------------------------------

void expect_keypoint(ft::tracked_keypoint const& k, ft::tracked_frame_view const& r, int b,
                     int camera, int i) {
  std::ptrdiff_t const number = b * r.cameras * r.capacity + camera * r.capacity + i;
  EXPECT_EQ(k.number, i);
  EXPECT_EQ(k.pixel.x, r.x[number]);
  EXPECT_EQ(k.pixel.y, r.y[number]);
  EXPECT_EQ(k.octave, r.octave[number]);
  EXPECT_EQ(k.slot, r.holder[number]);
  std::ptrdiff_t const left = b * r.capacity + i;
  EXPECT_EQ(k.depth, camera == 0 ? r.depth[left] : -1);
  auto const point = camera == 0 ? r.point[left] : ft::vec3<float>{0, 0, 0};
  EXPECT_EQ(std::memcmp(&k.point, &point, sizeof point), 0);
  int const partner = r.partner[number];
  EXPECT_EQ(k.partner, partner < 0 ? -1 : camera == 0 ? partner - r.capacity : partner);
}

/// @return how many have a point, and how many a partner
template <typename Tracker>
std::pair<int, int> expect_frames_are_the_result(Tracker const& tracker, int local) {
  auto const& r = tracker.result();
  int with_point = 0;
  int with_partner = 0;
  for (int b = 0; b < tracker.batch(); ++b) {
    auto const frame = tracker.frame(b);
    EXPECT_TRUE(same_pose(frame.T_cw(), r.T_cw[b]));
    EXPECT_EQ(frame.matches(), r.matches[b]);
    EXPECT_EQ(frame.inliers(), r.inliers[b]);
    for (int i = 0; i < local; ++i) {
      EXPECT_EQ(frame.in_view(i), r.in_view[b * r.local_points + i] == 1);
    }
    for (int c = 0; c < 2; ++c) {
      auto const keypoints = c == 0 ? frame.left() : frame.right();
      EXPECT_EQ(keypoints.size(), c < r.cameras ? r.keypoints[b * r.cameras + c] : 0);
      int i = 0;
      for (auto const& k : keypoints) {
        expect_keypoint(k, r, b, c, i);
        expect_keypoint(keypoints[i], r, b, c, i);
        ++i;
        with_point += static_cast<int>(k.slot >= 0);
        if (k.partner < 0) { continue; }
        ++with_partner;
        // Several left keypoints may have the same partner, whose own is the last of them.
        if (c == 1) { EXPECT_EQ(frame.left()[k.partner].partner, k.number); }
      }
      EXPECT_EQ(i, keypoints.size());
      std::vector<ft::tracked_keypoint> const copied(keypoints.begin(), keypoints.end());
      EXPECT_EQ(static_cast<int>(copied.size()), keypoints.size());
    }
  }
  return {with_point, with_partner};
}

TYPED_TEST(tracker_state_test, frames_are_the_result_keypoint_by_keypoint) {
  auto const& exec = this->exec();
  ft::frame_tracker<typename TestFixture::exec_type> tracker(exec, rig(), params(), 2);
  track(tracker, exec, {&walk(0), &walk(1)});
  auto const rectified = expect_frames_are_the_result(tracker, params().local_points);
  EXPECT_EQ(rectified.first, tracker.frame(0).inliers() + tracker.frame(1).inliers());
  EXPECT_GT(rectified.first, 200);
  EXPECT_EQ(rectified.second, 0);
  EXPECT_EQ(tracker.frame(1).right().size(), 0);
  EXPECT_FALSE(tracker.frame(1).right().begin() != tracker.frame(1).right().end());
  EXPECT_THROW(tracker.frame(2), ft::bad_argument);
  EXPECT_THROW(tracker.frame(-1), ft::bad_argument);

  auto const& frames = walk_of(fisheye());
  auto const others = make_walk(fisheye(), 4, 3);
  ft::frame_tracker<typename TestFixture::exec_type, fisheye_rig> pair(exec, fisheye(), params(),
                                                                       2);
  track(pair, exec, {&frames, &others});
  auto const both = expect_frames_are_the_result(pair, params().local_points);
  EXPECT_EQ(both.first, pair.frame(0).inliers() + pair.frame(1).inliers());
  EXPECT_GT(both.first, 200);
  EXPECT_GT(both.second, 200);
  EXPECT_GT(pair.frame(1).right().size(), 100);
}

// ---- times of stages --------------------------------------------------------------------------

enum class call { extract, track_motion, track_local, track, relocalize };
constexpr call all_calls[] = {call::extract, call::track_motion, call::track_local, call::track,
                              call::relocalize};

/// Makes a call for the second frame of a walk.
template <typename Exec, typename Rig>
void enqueue(tracked_walk<Exec, Rig>& walk, call c, Exec const& exec) {
  auto& tracker = walk.tracker;
  ft::frame_input const input{walk.first_pose(), walk.slots};
  switch (c) {
    case call::extract:
      return tracker.extract(exec);
    case call::track_motion:
      return tracker.track_motion(exec, input.T_predicted);
    case call::track_local:
      return tracker.track_local(exec, input.local_slots);
    case call::track:
      return tracker.track(exec, input);
    case call::relocalize:
      return tracker.relocalize(exec, input);
  }
}
/// @return its result
template <typename Exec, typename Rig>
snapshot make_call(tracked_walk<Exec, Rig>& walk, call c) {
  enqueue(walk, c, walk.exec);
  return walk.result(c != call::extract && c != call::track_motion);
}

/// Before the measured call.
template <typename Exec, typename Rig>
void prepare(tracked_walk<Exec, Rig>& walk, call c) {
  walk.use_first();
  walk.see(1);
  if (c == call::track_local || c == call::relocalize) { make_call(walk, call::track_motion); }
}

/// Names of stages in the order of frame_schedule.hpp. @param p for optional pose optimisation
std::vector<std::string> stage_names(call c, ft::tracker_params const& p) {
  std::vector<std::string> names{"upload"};
  auto const add = [&](std::initializer_list<char const*> more) {
    names.insert(names.end(), more.begin(), more.end());
  };
  bool const local = c != call::extract && c != call::track_motion;
  if (c != call::track_local && c != call::relocalize) {
    add({"pyramid", "corners", "distribution", "blur", "order", "descriptors"});
    if (c == call::extract) {
      add({"stereo"});
    } else {
      add({"search last frame", "stereo"});
    }
    if (c != call::extract && p.optimize_last) { add({"pose last frame"}); }
  }
  if (local) { add({"search local map"}); }
  if (local && p.optimize_local) { add({"pose local map"}); }
  add({"result"});
  return names;
}

TYPED_TEST(tracker_state_test, stages_have_the_names_of_the_schedule_and_times_within_the_call) {
  using executor = typename TestFixture::exec_type;
  auto const& exec = this->exec();
  for_both_rigs([&](auto const& rig) {
    using rig_type = std::decay_t<decltype(rig)>;
    for (bool const use_graphs : test::both(true)) {
      for (bool const optimize : test::both(true)) {
        auto p = params();
        p.use_graphs = use_graphs;
        p.optimize_last = p.optimize_local = optimize;
        p.measure_stages = true;
        tracked_walk<executor, rig_type> walk(exec, rig, p);
        for (call const c : all_calls) {
          SCOPED_TRACE("call " + std::to_string(static_cast<int>(c)) +
                       (use_graphs ? ", graphs" : ", launch by launch") +
                       (optimize ? "" : ", without pose optimisation"));
          prepare(walk, c);
          auto const from = std::chrono::steady_clock::now();
          make_call(walk, c);
          auto const until = std::chrono::steady_clock::now();
          double const wall = std::chrono::duration<double, std::micro>(until - from).count();
          auto const times = walk.tracker.stage_times();
          std::vector<std::string> names;
          double sum = 0;
          for (auto const& t : times) {
            names.emplace_back(t.name);
            EXPECT_GE(t.us, 0) << t.name;
            EXPECT_LE(t.us, wall) << t.name;
            sum += t.us;
          }
          EXPECT_EQ(names, stage_names(c, p));
          EXPECT_GT(sum, 0);
          // On a device the stereo matching of two cameras runs concurrently with the search.
          if (rig_type::rectified || executor::space == ft::memory_space::host) {
            EXPECT_LE(sum, wall);
          }
        }
      }
    }
  });
}

TYPED_TEST(tracker_state_test, measured_calls_give_the_bits_of_others) {
  using executor = typename TestFixture::exec_type;
  auto const& exec = this->exec();
  for_both_rigs([&](auto const& rig) {
    using rig_type = std::decay_t<decltype(rig)>;
    for (bool const optimize : test::both(true)) {
      SCOPED_TRACE(optimize ? "with pose optimisation" : "without pose optimisation");
      std::vector<snapshot> wanted;
      for (bool const use_graphs : test::both(true)) {
        for (bool const measure : {false, true}) {
          SCOPED_TRACE(std::string(use_graphs ? "graphs" : "launch by launch") +
                       (measure ? ", measured" : ""));
          auto p = params();
          p.use_graphs = use_graphs;
          p.measure_stages = measure;
          p.optimize_last = p.optimize_local = optimize;
          tracked_walk<executor, rig_type> walk(exec, rig, p);
          std::vector<snapshot> got;
          for (call const c : all_calls) {
            prepare(walk, c);
            got.push_back(make_call(walk, c));
          }
          if (wanted.empty()) { wanted = got; }
          expect_same(got, wanted);
        }
      }
      EXPECT_GT(wanted[3].matches, 0);
    }
  });
}

TYPED_TEST(tracker_state_test, stage_times_need_measuring_and_a_call) {
  auto const& exec = this->exec();
  tracked_walk<typename TestFixture::exec_type, ft::rectified_rig> plain(exec, rig());
  EXPECT_THROW(plain.tracker.stage_times(), ft::bad_argument);
  auto p = params();
  p.measure_stages = true;
  ft::frame_tracker<typename TestFixture::exec_type> tracker(exec, rig(), p);
  EXPECT_TRUE(tracker.stage_times().empty()) << "before any call";
  set_images(tracker, 0, walk(0)[0]);
  tracker.extract(exec);
  exec.wait();
  auto moved = std::move(tracker);
  EXPECT_EQ(moved.stage_times().size(), stage_names(call::extract, p).size());
  EXPECT_THROW(tracker.stage_times(), ft::bad_argument);  // NOLINT(bugprone-use-after-move)
}

#if defined(__CUDACC__)

/// What a call enqueues, as a graph: its nodes but event records, and how they depend on each
/// other.
struct captured_call {
  struct node {
    cudaGraphNodeType type;
    void const* function = nullptr;  ///< of a kernel
    std::array<unsigned, 6> shape{};

    friend bool operator==(node const& a, node const& b) {
      return a.type == b.type && a.function == b.function && a.shape == b.shape;
    }
  };
  std::vector<node> nodes;
  std::vector<std::array<std::size_t, 3>> edges;  ///< from, to, type
  int kernels = 0;
  int events = 0;
  int after_events = 0;  ///< nodes that depend on one

  template <typename Queue>
  explicit captured_call(Queue const& queue) {
    ft::stream const capturing;
    cudaGraph_t graph = nullptr;
    ft::throw_on_error(cudaStreamBeginCapture(capturing.get(), cudaStreamCaptureModeThreadLocal),
                       "cudaStreamBeginCapture");
    queue(ft::detail::launch_access::make(capturing.get(), true));
    ft::throw_on_error(cudaStreamEndCapture(capturing.get(), &graph), "cudaStreamEndCapture");
    read(graph);
    ft::throw_on_error(cudaGraphDestroy(graph), "cudaGraphDestroy");
  }

private:
  static constexpr std::size_t is_event = ~std::size_t{0};

  void read(cudaGraph_t graph) {
    std::size_t count = 0;
    ft::throw_on_error(cudaGraphGetNodes(graph, nullptr, &count), "cudaGraphGetNodes");
    std::vector<cudaGraphNode_t> all(count);
    ft::throw_on_error(cudaGraphGetNodes(graph, all.data(), &count), "cudaGraphGetNodes");
    std::map<cudaGraphNode_t, std::size_t> numbers;
    for (auto const& each : all) {
      node n = describe(each);
      bool const event = n.type == cudaGraphNodeTypeEventRecord;
      numbers[each] = event ? is_event : nodes.size();
      events += static_cast<int>(event);
      kernels += static_cast<int>(n.type == cudaGraphNodeTypeKernel);
      if (!event) { nodes.push_back(n); }
    }
    read_edges(graph, numbers);
  }
  static node describe(cudaGraphNode_t of) {
    node n;
    ft::throw_on_error(cudaGraphNodeGetType(of, &n.type), "cudaGraphNodeGetType");
    if (n.type == cudaGraphNodeTypeKernel) {
      cudaKernelNodeParams p = {};
      ft::throw_on_error(cudaGraphKernelNodeGetParams(of, &p), "cudaGraphKernelNodeGetParams");
      n.function = p.func;
      n.shape = {p.gridDim.x,  p.gridDim.y,  p.gridDim.z,
                 p.blockDim.x, p.blockDim.y, p.sharedMemBytes};
    }
    return n;
  }
  void read_edges(cudaGraph_t graph, std::map<cudaGraphNode_t, std::size_t> const& numbers) {
    std::size_t count = 0;
    std::vector<cudaGraphNode_t> from;
    std::vector<cudaGraphNode_t> to;
    std::vector<std::size_t> types;
#if CUDART_VERSION >= 12030
    std::vector<cudaGraphEdgeData> data;
    auto const get = [&](auto* f, auto* t, auto* d) {
#if CUDART_VERSION >= 13000
      ft::throw_on_error(cudaGraphGetEdges(graph, f, t, d, &count), "cudaGraphGetEdges");
#else
      ft::throw_on_error(cudaGraphGetEdges_v2(graph, f, t, d, &count), "cudaGraphGetEdges_v2");
#endif
    };
    get(static_cast<cudaGraphNode_t*>(nullptr), static_cast<cudaGraphNode_t*>(nullptr),
        static_cast<cudaGraphEdgeData*>(nullptr));
    from.resize(count);
    to.resize(count);
    data.resize(count);
    get(from.data(), to.data(), data.data());
    for (auto const& d : data) { types.push_back(d.type); }
#else
    ft::throw_on_error(cudaGraphGetEdges(graph, nullptr, nullptr, &count), "cudaGraphGetEdges");
    from.resize(count);
    to.resize(count);
    types.resize(count);
    ft::throw_on_error(cudaGraphGetEdges(graph, from.data(), to.data(), &count),
                       "cudaGraphGetEdges");
#endif
    for (std::size_t i = 0; i < count; ++i) {
      std::size_t const a = numbers.at(from[i]);
      std::size_t const b = numbers.at(to[i]);
      if (a == is_event) { ++after_events; }
      if (a != is_event && b != is_event) { edges.push_back({a, b, types[i]}); }
    }
    std::sort(edges.begin(), edges.end());
  }
};

TEST(tracker_graphs, measuring_adds_events_that_no_launch_depends_on) {
  if (!test::cuda_backend::available()) { GTEST_SKIP() << "no CUDA device"; }
  test::cuda_backend const backend;
  for_both_rigs([&](auto const& rig) {
    using rig_type = std::decay_t<decltype(rig)>;
    for (bool const optimize : test::both(true)) {
      auto p = params();
      p.use_graphs = false;  // a call enqueues what its graph would hold
      p.optimize_last = p.optimize_local = optimize;
      tracked_walk<ft::cuda_exec, rig_type> plain(backend.exec, rig, p);
      p.measure_stages = true;
      tracked_walk<ft::cuda_exec, rig_type> measured(backend.exec, rig, p);
      for (call const c : all_calls) {
        SCOPED_TRACE("call " + std::to_string(static_cast<int>(c)) +
                     (optimize ? "" : ", without pose optimisation"));
        captured_call const without([&](auto const& e) { enqueue(plain, c, e); });
        captured_call const with([&](auto const& e) { enqueue(measured, c, e); });
        EXPECT_GT(without.kernels, c == call::track ? 15 : 2);
        EXPECT_EQ(without.events, 0);
        EXPECT_GT(with.events, 2);
        EXPECT_EQ(with.after_events, 0);
        EXPECT_EQ(with.kernels, without.kernels);
        EXPECT_TRUE(with.nodes == without.nodes) << "other launches, or in another order";
        EXPECT_EQ(with.edges, without.edges);
      }
    }
  });
}

#endif

}  // namespace tracker_state
