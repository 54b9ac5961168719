// SPDX-License-Identifier: Apache-2.0
// The small stages between the steps of a relocalisation, on random frames.
#include <gtest/gtest.h>

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "ft/kernels/relocalization/frame_points.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/random.hpp"

namespace relocalization_stages_test {

using test::at;
using test::generator;

constexpr int batch = 3;
constexpr int cameras = 2;
constexpr int capacity = 70;
constexpr int numbers = cameras * capacity;
constexpr int slots = 50;
constexpr int pairs = 7;

/// Frames of two cameras, a map for each, and matches of pairs.
template <typename Exec>
struct scene {
  Exec const& exec;
  std::vector<int> count, octave, match, match_count, frame_of, held;
  std::vector<float> x, y;
  std::vector<ft::vec3<float>> position;
  ft::keypoints<Exec::space> kp{capacity, cameras* batch};
  ft::map_points<Exec::space> map{slots, batch};
  ft::buffer<int, Exec::space> d_match, d_match_count, d_frame_of, holder;
  ft::matched_frames in;

  explicit scene(Exec const& on, unsigned seed) : exec(on) {
    generator random(seed);
    for (int image = 0; image < cameras * batch; ++image) {
      count.push_back(image == 2 ? 0 : image == 4 ? capacity : random.below(capacity + 1));
      for (int k = 0; k < capacity; ++k) {
        x.push_back(random.real(0, 640));
        y.push_back(random.real(0, 480));
        octave.push_back(random.below(8));
        held.push_back(random.chance(50) ? random.below(slots) : -1);
      }
    }
    for (int i = 0; i < slots * batch; ++i) {
      position.push_back({random.real(-9, 9), random.real(-9, 9), random.real(1, 9)});
    }
    for (int p = 0; p < pairs; ++p) {
      frame_of.push_back(random.below(batch));
      match_count.push_back(random.from_to(10, 20));
      for (int k = 0; k < numbers; ++k) {
        match.push_back(random.chance(60) ? random.below(slots) : -1);
      }
    }
    put(ft::array_of<ft::field::x>(kp.view()), x);
    put(ft::array_of<ft::field::y>(kp.view()), y);
    put(ft::array_of<ft::field::octave>(kp.view()), octave);
    put(kp.view().count, count);
    put(ft::array_of<ft::field::position>(map.view()), position);
    d_match = test::to_exec(exec, match);
    d_match_count = test::to_exec(exec, match_count);
    d_frame_of = test::to_exec(exec, frame_of);
    holder = test::to_exec(exec, held);
    in.frame.keypoints = kp.view();
    in.frame.keypoint_step = in.frame.cameras = cameras;
    in.frame.batch = batch;
    in.frame.holder = holder.data();
    in.map = map.view();
    in.geometry = ft::pyramid_geometry::make(640, 480, 8, 1.2f);
    in.matches = {pairs, numbers, d_match.data(), d_match_count.data()};
    in.frame_of = d_frame_of.data();
    in.seed = 99;
  }
  template <typename T>
  void put(T* to, std::vector<T> const& values) const {
    ft::copy(exec, to, values.data(), values.size());
    exec.wait();
  }
  std::vector<int> holders() const {
    return test::from_exec(exec, static_cast<int const*>(holder.data()), held.size());
  }
};

/// What gather_correspondences() and hold_inliers() read and write.
template <typename Exec>
struct working_memory {
  ft::pnp_problems_view problems;
  ft::pnp_results_view results;
  ft::relocalization_view state;
  ft::observations_view seen;
  int* active = nullptr;
  ft::arena<Exec::space> memory;

  working_memory()
      : memory([this](ft::carver& c) {
          carve(c, problems, pairs, capacity + 3);
          carve(c, results, pairs, capacity + 3);
          carve(c, state, numbers, slots, batch);
          carve(c, seen, numbers, batch);
          active = c.template take<int>(pairs);
        }) {}
};

template <typename Backend>
class relocalization_stages : public test::on_backend<Backend> {
protected:
  Backend backend;

  template <typename T>
  std::vector<T> get(T const* data, int n) {
    return test::from_exec(backend.exec, data, at(n));
  }
  /// Which points each frame has found.
  std::vector<bool> found(ft::relocalization_view const& state) {
    auto const now = get<int>(state.found_now, batch);
    auto const in = get<int>(state.found_in, batch * slots);
    std::vector<bool> all;
    for (int i = 0; i < batch * slots; ++i) { all.push_back(in[at(i)] == now[at(i / slots)]); }
    return all;
  }
};
TYPED_TEST_SUITE(relocalization_stages, test::backends);

TYPED_TEST(relocalization_stages, correspondences_are_the_matched_left_keypoints_in_order) {
  using exec_type = typename TypeParam::exec_type;
  scene<exec_type> const s(this->backend.exec, 1);
  working_memory<exec_type> const m;
  ft::gather_correspondences(this->backend.exec, s.in, m.problems, m.active);
  auto const count = this->template get<int>(m.problems.count, pairs);
  auto const seed = this->template get<std::uint64_t>(m.problems.seed, pairs);
  auto const active = this->template get<int>(m.active, pairs);
  for (int p = 0; p < pairs; ++p) {
    SCOPED_TRACE("pair " + std::to_string(p));
    int const image = cameras * s.frame_of[at(p)];
    int const first = p * (capacity + 3);
    auto const pixel = this->template get<ft::vec2<float>>(m.problems.pixel + first, capacity);
    auto const point = this->template get<ft::vec3<float>>(m.problems.point + first, capacity);
    auto const error = this->template get<float>(m.problems.max_error2 + first, capacity);
    auto const keypoint = this->template get<int>(m.problems.keypoint + first, capacity);
    int n = 0;
    for (int k = 0; k < s.count[at(image)]; ++k) {
      int const slot = s.match[at(p * numbers + k)];
      if (slot < 0) { continue; }
      auto const i = at(image * capacity + k);
      auto const& want = s.position[at(s.frame_of[at(p)] * slots + slot)];
      EXPECT_EQ(keypoint[at(n)], k);
      EXPECT_EQ(pixel[at(n)].x, s.x[i]);
      EXPECT_EQ(pixel[at(n)].y, s.y[i]);
      EXPECT_EQ(point[at(n)].x, want.x);
      EXPECT_EQ(point[at(n)].z, want.z);
      EXPECT_EQ(error[at(n)], 5.991f * s.in.geometry.sigma2[s.octave[i]]);
      ++n;
    }
    EXPECT_EQ(count[at(p)], n);
    EXPECT_EQ(seed[at(p)], 99u + static_cast<unsigned>(p));
    EXPECT_EQ(active[at(p)], s.match_count[at(p)] >= 15 ? 1 : 0);
  }
}

TYPED_TEST(relocalization_stages, a_frame_holds_the_inliers_of_its_problem) {
  using exec_type = typename TypeParam::exec_type;
  scene<exec_type> s(this->backend.exec, 2);
  working_memory<exec_type> const m;
  auto const& exec = this->backend.exec;
  generator random(5);
  std::vector<int> problem{-1, -1, -1};  // entry 0 keeps what it has
  for (int p = 0; p < pairs; ++p) {
    if (s.frame_of[at(p)] != 0) { problem[at(s.frame_of[at(p)])] = p; }
  }
  ft::clear(exec, m.state);
  ft::gather_correspondences(exec, s.in, m.problems, m.active);
  std::vector<std::uint8_t> inlier;
  for (int i = 0; i < pairs * (capacity + 3); ++i) {
    inlier.push_back(static_cast<std::uint8_t>(random.below(2)));
  }
  std::vector<ft::pnp_result> result(at(pairs));
  for (int p = 0; p < pairs; ++p) {
    result[at(p)] = {ft::pose::identity(), 0, 0, ft::pnp_status::found};
    result[at(p)].T_cw.t.x = static_cast<float>(p);
  }
  s.put(m.results.inlier, inlier);
  s.put(m.results.result, result);
  auto const d_problem = test::to_exec(exec, problem);
  ft::solved_frames const solved{m.problems, m.results, s.in.matches, d_problem.data()};
  ft::hold_inliers(exec, s.in.frame, solved, m.state);
  auto const holder = s.holders();
  auto const found = this->found(m.state);
  auto const T = this->template get<ft::pose>(m.state.T_cw, batch);
  for (int b = 0; b < batch; ++b) {
    SCOPED_TRACE("frame " + std::to_string(b));
    int const p = problem[at(b)];
    std::vector<int> want(at(numbers), -1);
    std::vector<bool> wanted(at(slots), false);
    if (p < 0) { want.assign(s.held.begin() + b * numbers, s.held.begin() + (b + 1) * numbers); }
    int i = 0;
    for (int k = 0; p >= 0 && k < s.count[at(cameras * b)]; ++k) {
      int const slot = s.match[at(p * numbers + k)];
      if (slot < 0 || inlier[at(p * (capacity + 3) + i++)] == 0) { continue; }
      want[at(k)] = slot;
      wanted[at(slot)] = true;
    }
    EXPECT_EQ(std::vector<int>(holder.begin() + b * numbers, holder.begin() + (b + 1) * numbers),
              want);
    EXPECT_EQ(std::vector<bool>(found.begin() + b * slots, found.begin() + (b + 1) * slots),
              wanted);
    if (p >= 0) { EXPECT_EQ(T[at(b)].t.x, static_cast<float>(p)); }
  }
}

TYPED_TEST(relocalization_stages, found_are_the_points_held_last) {
  using exec_type = typename TypeParam::exec_type;
  scene<exec_type> s(this->backend.exec, 3);
  working_memory<exec_type> const m;
  auto const& exec = this->backend.exec;
  ft::clear(exec, m.state);
  for (int round = 0; round < 3; ++round) {
    for (int& h : s.held) { h = h >= 0 ? (h + 7) % slots : -1; }
    s.held[0] = slots + 3;  // not in the map
    s.put(s.holder.data(), s.held);
    ft::find_held_points(exec, s.in.frame, m.state);
    std::vector<bool> want(at(batch * slots), false);
    for (int i = 1; i < batch * numbers; ++i) {
      if (s.held[at(i)] >= 0) { want[at(i / numbers * slots + s.held[at(i)])] = true; }
    }
    EXPECT_EQ(this->found(m.state), want);
  }
}

TYPED_TEST(relocalization_stages, outliers_are_noted_and_then_released) {
  using exec_type = typename TypeParam::exec_type;
  scene<exec_type> s(this->backend.exec, 4);
  working_memory<exec_type> const m;
  auto const& exec = this->backend.exec;
  generator random(6);
  ft::clear(exec, m.state);
  std::vector<unsigned char> flags(at(batch * numbers), 0);
  for (int round = 0; round < 3; ++round) {
    std::vector<int> number(at(batch * numbers), 0), count;
    std::vector<unsigned char> outlier(at(batch * numbers), 0);
    std::vector<int> after = s.held;
    for (int b = 0; b < batch; ++b) {
      int n = 0;
      for (int k = 0; k < numbers; ++k) {
        int& holder = after[at(b * numbers + k)];
        if (holder < 0) { continue; }
        auto const flag = static_cast<unsigned char>(random.chance(30));
        number[at(b * numbers + n)] = k;
        outlier[at(b * numbers + n++)] = flag;
        flags[at(b * numbers + k)] = flag;
        if (flag != 0) { holder = -1; }  // as an optimisation does
      }
      count.push_back(n);
    }
    s.put(m.seen.number, number);
    s.put(m.seen.outlier, outlier);
    s.put(m.seen.count, count);
    s.put(m.state.held, s.held);
    s.put(s.holder.data(), after);
    ft::keep_outliers(exec, s.in.frame, m.seen, m.state);
    EXPECT_EQ(s.holders(), s.held);
    EXPECT_EQ(this->template get<unsigned char>(m.state.outlier, batch * numbers), flags);
    ft::release_outliers(exec, s.in.frame, m.state);
    EXPECT_EQ(s.holders(), after);
    s.held = after;  // the flags of the released ones stay
  }
}

TYPED_TEST(relocalization_stages, refuses_views_of_another_shape) {
  using exec_type = typename TypeParam::exec_type;
  scene<exec_type> s(this->backend.exec, 5);
  working_memory<exec_type> const m;
  auto const& exec = this->backend.exec;
  auto problems = m.problems;
  problems.problems = pairs - 1;
  EXPECT_THROW(ft::gather_correspondences(exec, s.in, problems, m.active), ft::bad_argument);
  problems = m.problems;
  problems.capacity = capacity - 1;
  EXPECT_THROW(ft::gather_correspondences(exec, s.in, problems, m.active), ft::bad_argument);
  auto state = m.state;
  state.numbers = numbers - 1;
  EXPECT_THROW(ft::find_held_points(exec, s.in.frame, state), ft::bad_argument);
  EXPECT_THROW(ft::release_outliers(exec, s.in.frame, state), ft::bad_argument);
  state = m.state;
  state.batch = batch - 1;
  EXPECT_THROW(ft::keep_outliers(exec, s.in.frame, m.seen, state), ft::bad_argument);
  EXPECT_THROW(ft::hold_inliers(exec, s.in.frame, {}, state), ft::bad_argument);
}

}  // namespace relocalization_stages_test
