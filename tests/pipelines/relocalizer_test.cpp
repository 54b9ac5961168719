// SPDX-License-Identifier: Apache-2.0
// Relocalisation of a frame that sees known points from a known place.
#include "ft/pipelines/relocalizer.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <string>
#include <utility>
#include <vector>

#include "ft/cameras/kannala_brandt.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "ft/kernels/grid.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/random.hpp"
#include "tests/support/word_groups.hpp"

namespace relocalizer_test {

using test::at;
using test::generator;

constexpr float width = 640;
constexpr float height = 480;
constexpr int levels = 8;
constexpr int points = 300;
constexpr int capacity = 320;  ///< keypoints of an image
using fisheye = ft::kannala_brandt<float>;
using fisheye_pair = ft::stereo_rig<fisheye, fisheye>;

ft::rectified_rig rectified() { return ft::rectified_rig::make({400, 400, 320, 240}, 0.1); }
fisheye_pair wide() {
  fisheye const camera{250, 250, 320, 240, 0.01f, -0.002f, 0, 0};
  return {camera, camera, {ft::mat3<float>::identity(), {-0.1f, 0, 0}}};
}

/// How a candidate sees the frame's points.
struct candidate {
  int words = 0;       ///< points that share a word with the frame
  int points = 0;      ///< points that its keypoints hold, the former included
  bool wrong = false;  ///< the points are elsewhere
};

/// A frame and keyframes on an executor.
template <typename Exec, typename Rig>
struct scene {
  static constexpr int cameras = Rig::cameras;
  static constexpr int numbers = cameras * capacity;
  Exec const& exec;
  Rig rig;
  ft::pose T_cw;
  int slots;
  ft::keypoints<Exec::space> kp{capacity, cameras};
  ft::keypoints<Exec::space> keyframe_kp;
  ft::map_points<Exec::space> map;
  ft::feature_grid<Exec::space> grids{ft::grid_geometry::over(0, 0, width, height), capacity,
                                      cameras};
  test::uploaded_groups<Exec> groups, keyframe_groups;
  ft::buffer<int, Exec::space> holder, held, first_right;
  ft::relocalization_input in;
  std::vector<int> rows;
  std::vector<int> first_slot;

  scene(Exec const& on, Rig const& of, std::vector<candidate> const& candidates)
      : exec(on),
        rig(of),
        slots(points * static_cast<int>(candidates.size())),
        keyframe_kp(capacity, cameras * static_cast<int>(candidates.size())),
        map(slots) {
    generator random(11);
    float const turn = 0.2f;
    T_cw = {{{std::cos(turn), 0, std::sin(turn), 0, 1, 0, -std::sin(turn), 0, std::cos(turn)}},
            {0.3f, -0.2f, 0.5f}};
    ft::map_points<ft::memory_space::host> const host(slots);
    ft::keypoints<ft::memory_space::host> const frame(capacity, cameras);
    ft::keypoints<ft::memory_space::host> const keyframes(capacity, keyframe_kp.batch());
    std::vector<int> node(at(numbers), -1);
    see_points(random, frame.view(), host.view(), node);
    std::vector<test::words_groups> all;
    std::vector<int> of_keyframes;
    for (std::size_t c = 0; c < candidates.size(); ++c) {
      int const row = static_cast<int>(c);
      rows.push_back(row);
      first_slot.push_back(row * points);
      copy_points(random, candidates[c], host.view(), row * points);
      std::vector<int> nodes(at(numbers), -1);
      std::vector<int> holds(at(numbers), -1);
      auto const to = keyframes.view().slice(cameras * row);
      for (int i = 0; i < candidates[c].points; ++i) {
        to.orb(i) = frame.view().orb(i);
        to.angle(i) = frame.view().angle(i);
        nodes[at(i)] = i < candidates[c].words ? node[at(i)] : 1000;
        holds[at(i)] = row * points + i;
      }
      for (int image = 0; image < cameras; ++image) {
        to.count[image] = image == 0 ? candidates[c].points : 0;
      }
      all.emplace_back(nodes, numbers);
      of_keyframes.insert(of_keyframes.end(), holds.begin(), holds.end());
    }
    ft::copy(exec, kp.view(), frame.view());
    ft::copy(exec, keyframe_kp.view(), keyframes.view());
    ft::copy(exec, map.view(), host.view());
    groups = {exec, {test::words_groups(node, numbers)}, numbers};
    keyframe_groups = {exec, all, numbers};
    holder = test::to_exec(exec, std::vector<int>(at(numbers), 5));
    held = test::to_exec(exec, of_keyframes);
    first_right = test::to_exec(exec, std::vector<int>{capacity});
    connect();
  }

  ft::relocalization_params params() const {
    ft::relocalization_params p;
    p.frustum.max_x = width;
    p.frustum.max_y = height;
    p.frustum.levels = levels;
    p.frustum.log_scale_factor = ft::log_rounded(1.2f);
    return p;
  }
  ft::relocalizer_capacity room() const { return {capacity, capacity, slots, 8}; }

private:
  /// Points in front of the camera, and a keypoint of the left camera for each.
  void see_points(generator& random, ft::keypoints_view const& to, ft::map_points_view const& seen,
                  std::vector<int>& node) const {
    auto const& camera = ft::detail::left_camera(rig);
    for (int i = 0; i < points; ++i) {
      ft::vec2<float> const pixel{random.real(20, width - 20), random.real(20, height - 20)};
      auto const ray = camera.unproject(pixel).direction;
      float const depth = random.real(3, 12);
      ft::vec3<float> const p{ray.x * depth, ray.y * depth, ray.z * depth};
      float const distance = std::sqrt(ft::dot(p, p));
      int const octave = random.below(levels);
      to.x(i) = pixel.x + random.real(-0.3f, 0.3f);
      to.y(i) = pixel.y + random.real(-0.3f, 0.3f);
      to.angle(i) = random.real(0, 10);
      to.octave(i) = octave;
      to.orb(i) = random.descriptor();
      node[at(i)] = i % 30;
      seen.position(i) = T_cw.inverse() * p;
      seen.min_distance(i) = distance / 4;
      seen.max_distance(i) = distance * std::pow(1.2f, static_cast<float>(octave) - 0.5f);
      seen.orb(i) = random.flipped(to.orb(i), 20);
      seen.observations(i) = 2;
    }
    to.count[0] = points;
    for (int c = 1; c < cameras; ++c) { to.count[c] = 0; }
    *seen.count = slots;
  }
  /// The points as a candidate has them. The first one's are in place.
  static void copy_points(generator& random, candidate const& as, ft::map_points_view const& all,
                          int first) {
    for (int i = 0; i < points; ++i) {
      int const to = first + i;
      all.position(to) = all.position(i);
      all.min_distance(to) = all.min_distance(i);
      all.max_distance(to) = all.max_distance(i);
      all.orb(to) = all.orb(i);
      all.observations(to) = all.observations(i);
    }
    // Candidate 0 is never wrong, so that its points are the others' originals.
    for (int i = 0; as.wrong && i < points; ++i) {
      all.position(first + i) = {random.real(-9, 9), random.real(-9, 9), random.real(3, 12)};
    }
  }
  void connect() {
    in.frame.keypoints = kp.view();
    in.frame.keypoint_step = in.frame.cameras = cameras;
    in.frame.grids = grids.view();
    in.frame.holder = holder.data();
    ft::build_grid<ft::nearest_cell>(exec, in.frame.keypoints, 0, 1, cameras, in.frame.grids);
    in.map = map.view();
    in.geometry = ft::pyramid_geometry::make(640, 480, levels, 1.2f);
    int const* const right = cameras == 2 ? first_right.data() : nullptr;
    auto const angle = [](auto const& of) { return ft::array_of<ft::field::angle>(of.view()); };
    auto const orb = [](auto const& of) { return ft::array_of<ft::field::orb>(of.view()); };
    in.words = {groups.view(), orb(kp), angle(kp), right};
    in.keyframes = {keyframe_groups.view(), orb(keyframe_kp), angle(keyframe_kp), nullptr};
    in.keyframe_keypoints = keyframe_kp.view();
    in.holder = held.data();
    exec.wait();
  }
};

using steps = std::vector<std::string>;

/// Relocalises, and tells what was done: candidate, step and, where it is certain, the value.
template <typename Exec, typename Rig>
std::pair<ft::relocalization, steps> relocalize(scene<Exec, Rig>& s,
                                                ft::relocalization_params const& params) {
  ft::relocalizer<Exec, Rig> relocalizer(s.rig, params, s.room());
  relocalizer.match(s.exec, s.in, s.rows);
  steps done;
  auto const result = relocalizer.relocalize_matched(
      s.exec, s.in, s.rows, 7, [&](ft::relocalization_step step, int c, int value) {
        char const* const names[] = {"solved", "first", "coarse", "second", "narrow", "third"};
        done.push_back(std::to_string(c) + " " + names[static_cast<int>(step)] +
                       (value < 0 ? " none" : ""));
      });
  return {result, done};
}

/// Expects the true pose, and that keypoints hold what they see, at least `most` of them.
template <typename Exec, typename Rig>
void expect_place(scene<Exec, Rig> const& s, ft::relocalization const& got, int candidate,
                  int most) {
  ASSERT_TRUE(got.found);
  EXPECT_EQ(got.candidate, candidate);
  EXPECT_GE(got.inliers, most);
  EXPECT_NEAR(got.T_cw.t.x, s.T_cw.t.x, 5e-3);
  EXPECT_NEAR(got.T_cw.t.y, s.T_cw.t.y, 5e-3);
  EXPECT_NEAR(got.T_cw.t.z, s.T_cw.t.z, 5e-3);
  for (int i = 0; i < 9; ++i) { EXPECT_NEAR(got.T_cw.R.m[i], s.T_cw.R.m[i], 2e-3); }
  auto const holder =
      test::from_exec(s.exec, static_cast<int const*>(s.holder.data()), s.holder.size());
  int right = 0;
  for (std::size_t k = 0; k < holder.size(); ++k) {
    if (holder[k] < 0) { continue; }
    EXPECT_EQ(holder[k] - s.first_slot[at(candidate)], static_cast<int>(k));
    ++right;
  }
  EXPECT_GE(right, most);
}

template <typename Backend>
class relocalizer : public test::on_backend<Backend> {
protected:
  Backend backend;

  template <typename Rig>
  void find(Rig const& rig) {
    // Few share words with the right keyframe: the searches find the others of its points.
    scene<typename Backend::exec_type, Rig> s(backend.exec, rig,
                                              {{5, 200}, {25, 200, true}, {25, 200}});
    auto const [got, done] = relocalize(s, s.params());
    EXPECT_EQ(done, (steps{"1 solved none", "2 solved", "2 first", "2 coarse", "2 second"}));
    EXPECT_EQ(got.rounds, 1);
    expect_place(s, got, 2, 150);
  }
};
TYPED_TEST_SUITE(relocalizer, test::backends);

TYPED_TEST(relocalizer, finds_the_place_among_candidates) { this->find(rectified()); }
TYPED_TEST(relocalizer, finds_the_place_with_two_fisheye_cameras) { this->find(wide()); }

TYPED_TEST(relocalizer, does_not_search_where_words_give_enough) {
  scene<typename TypeParam::exec_type, ft::rectified_rig> s(this->backend.exec, rectified(),
                                                            {{120, 200}, {120, 200}});
  auto const [got, done] = relocalize(s, s.params());
  EXPECT_EQ(done, (steps{"0 solved", "0 first"}));
  expect_place(s, got, 0, 100);
}

TYPED_TEST(relocalizer, gives_up_after_the_limit_of_rounds) {
  // No more points than the few that the pose is from: too few each time.
  scene<typename TypeParam::exec_type, ft::rectified_rig> s(this->backend.exec, rectified(),
                                                            {{30, 30}, {14, 200}});
  auto params = s.params();
  params.rounds = 3;
  auto const [got, done] = relocalize(s, params);
  EXPECT_FALSE(got.found);
  EXPECT_EQ(got.candidate, -1);
  EXPECT_EQ(got.rounds, 3);
  steps want;
  for (int round = 0; round < 3; ++round) {
    for (auto const* step : {"0 solved", "0 first", "0 coarse"}) { want.emplace_back(step); }
  }
  EXPECT_EQ(done, want);
}

TYPED_TEST(relocalizer, needs_candidates_with_matches) {
  scene<typename TypeParam::exec_type, ft::rectified_rig> s(this->backend.exec, rectified(),
                                                            {{14, 200}, {0, 0}, {0, 200}});
  auto const [got, done] = relocalize(s, s.params());
  EXPECT_FALSE(got.found);
  EXPECT_EQ(got.rounds, 0);
  EXPECT_TRUE(done.empty());
  s.rows.clear();
  EXPECT_FALSE(relocalize(s, s.params()).first.found);
}

TYPED_TEST(relocalizer, gives_the_same_answer_again) {
  scene<typename TypeParam::exec_type, ft::rectified_rig> s(this->backend.exec, rectified(),
                                                            {{25, 200, false}, {60, 200, true}});
  ft::relocalizer<typename TypeParam::exec_type, ft::rectified_rig> r(s.rig, s.params(), s.room());
  auto const first = r.relocalize(this->backend.exec, s.in, s.rows, 3);
  auto const second = r.relocalize(this->backend.exec, s.in, s.rows, 3);
  expect_place(s, second, 0, 150);
  EXPECT_EQ(second.inliers, first.inliers);
  for (int i = 0; i < 9; ++i) { EXPECT_EQ(second.T_cw.R.m[i], first.T_cw.R.m[i]); }
  EXPECT_GT(r.bytes(), 0u);
}

TYPED_TEST(relocalizer, refuses_inputs_that_do_not_fit) {
  using exec_type = typename TypeParam::exec_type;
  auto const& exec = this->backend.exec;
  scene<exec_type, ft::rectified_rig> s(exec, rectified(), {{25, 200}});
  using relocalizer_type = ft::relocalizer<exec_type, ft::rectified_rig>;
  for (auto const& room :
       {ft::relocalizer_capacity{0, 1, 1, 1}, {1, 0, 1, 1}, {1, 1, 0, 1}, {1, 1, 1, 0}}) {
    EXPECT_THROW(relocalizer_type(s.rig, s.params(), room), ft::bad_argument);
  }
  auto params = s.params();
  params.rounds = 0;
  EXPECT_THROW(relocalizer_type(s.rig, params, s.room()), ft::bad_argument);
  relocalizer_type none;
  EXPECT_THROW(none.relocalize(exec, s.in, s.rows, 1), ft::bad_argument);
  relocalizer_type r(s.rig, s.params(), s.room());
  EXPECT_THROW(r.relocalize(exec, s.in, std::vector<int>{1}, 1), ft::bad_argument);
  EXPECT_THROW(r.relocalize(exec, s.in, std::vector<int>{-1}, 1), ft::bad_argument);
  EXPECT_THROW(r.relocalize(exec, s.in, std::vector<int>(9, 0), 1), ft::bad_argument);
  auto input = s.in;
  input.frame.cameras = 2;
  EXPECT_THROW(r.relocalize(exec, input, s.rows, 1), ft::bad_argument);
  input = s.in;
  input.map.capacity -= 1;
  EXPECT_THROW(r.relocalize(exec, input, s.rows, 1), ft::bad_argument);
  input = s.in;
  input.words.groups.capacity += 1;
  EXPECT_THROW(r.relocalize(exec, input, s.rows, 1), ft::bad_argument);
  r.match(exec, s.in, s.rows);
  EXPECT_THROW(r.relocalize_matched(exec, s.in, {}, 1, [](ft::relocalization_step, int, int) {}),
               ft::bad_argument);
}

}  // namespace relocalizer_test
