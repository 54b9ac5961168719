// SPDX-License-Identifier: Apache-2.0
// An odometry with a vocabulary: a camera that is carried to another place of its map is found
// there, one that is carried elsewhere is not, and nothing changes for one that is not lost.
#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "ft/containers/vocabulary.hpp"
#include "ft/pipelines/odometry.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/odometry_answers.hpp"
#include "tests/support/plain_vocabulary.hpp"
#include "tests/support/random.hpp"
#include "tests/support/room.hpp"

namespace odometry_recovery_test {

using test::room::stereo_frame;
constexpr std::int64_t period = 50'000'000;

/// The pose, camera to world, after a number of steps: the camera turns and goes on.
ft::pose pose_at(float step, float yaw_error = 0, ft::vec3<float> const& error = {0, 0, 0}) {
  float const yaw = 0.06f * step + yaw_error;
  float const c = std::cos(yaw), s = std::sin(yaw);
  return {{{c, 0, s, 0, 1, 0, -s, 0, c}},
          {0.01f * step + error.x, error.y, 1.0f + 0.02f * step + error.z}};
}

stereo_frame see(std::vector<test::room::image> const& walls, ft::pose const& T_wc) {
  auto const rig = test::room::rig();
  ft::pose const T_cw = T_wc.inverse();
  ft::pose T_rw = T_cw;
  T_rw.t.x -= rig.baseline_length().value;
  return {test::room::render(rig.camera, walls, T_cw), test::room::render(rig.camera, walls, T_rw),
          T_cw};
}

ft::stereo_images images_of(stereo_frame const& f) {
  return {test::room::view(f.left), test::room::view(f.right)};
}

std::vector<test::room::image> const& walls() {
  static auto const made = test::room::make_walls(0);
  return made;
}
constexpr int steps = 44;
std::vector<stereo_frame> const& walk() {
  static auto const frames = [] {
    std::vector<stereo_frame> all;
    for (int i = 0; i < steps; ++i) { all.push_back(see(walls(), pose_at(static_cast<float>(i)))); }
    return all;
  }();
  return frames;
}

double error_of(ft::tracking const& t, ft::pose const& T_cw) {
  auto const T_0w = walk()[0].T_cw.cast<double>();
  auto const d = t.T_world_camera.t - (T_0w * T_cw.cast<double>().inverse()).t;
  return std::sqrt(ft::dot(d, d));
}

ft::odometry_params params() {
  auto p = test::room::odometry_params(8192);
  p.keyframes = 40;
  return p;
}
ft::place_recovery how() {
  ft::place_recovery p;
  p.levels_up = 1;
  return p;
}

template <typename Backend>
class OdometryRecovery : public test::on_backend<Backend> {
protected:
  using exec_type = typename Backend::exec_type;
  using odometry = ft::odometry<exec_type>;
  Backend backend;
  ft::vocabulary<exec_type::space> words = ft::upload(
      backend.exec, ft::make_vocabulary(test::drawn_vocabulary(10, 3).arrays()).view());
  std::int64_t time = 0;

  ft::tracking track(odometry& odo, stereo_frame const& f) {
    return odo.track(images_of(f), time += period);
  }
  std::vector<ft::tracking> run(odometry& odo, std::vector<stereo_frame> const& frames) {
    std::vector<ft::tracking> all;
    time = 0;
    for (auto const& f : frames) { all.push_back(track(odo, f)); }
    return all;
  }
};
TYPED_TEST_SUITE(OdometryRecovery, test::backends);

TYPED_TEST(OdometryRecovery, FindsACameraThatWasCarriedAway) {
  typename TestFixture::odometry odo(this->backend.exec, test::room::rig(), params());
  odo.recognize_places(this->words.view(), how());
  auto const walked = this->run(odo, walk());
  for (auto const& t : walked) { ASSERT_EQ(t.state, ft::tracking_state::tracking); }
  test::generator random(5);
  float at = static_cast<float>(steps - 1);
  int found = 0;
  for (int jump = 0; jump < 20; ++jump) {
    float to = at;
    while (std::abs(to - at) < 14) { to = random.real(2, static_cast<float>(steps - 3)); }
    at = to;
    ft::vec3<float> const error{random.real(-0.1f, 0.1f), random.real(-0.05f, 0.05f),
                                random.real(-0.1f, 0.1f)};
    auto const frame = see(walls(), pose_at(to, random.real(-0.05f, 0.05f), error));
    for (int i = 0; i < 3; ++i) {
      auto const t = this->track(odo, frame);
      if (t.state != ft::tracking_state::tracking) { continue; }
      EXPECT_LT(error_of(t, frame.T_cw), 0.05) << jump;
      EXPECT_EQ(t.maps, 1);
      EXPECT_GE(t.inliers, 30);
      EXPECT_FALSE(std::isinf(t.covariance[0]));
      ++found;
      this->RecordProperty("jump_" + std::to_string(jump),
                     std::to_string(i + 1) + " frames, " +
                         std::to_string(error_of(t, frame.T_cw)) + " m");
      break;
    }
  }
  EXPECT_GE(found, 19);
  // Tracking goes on from the place.
  auto const next = this->track(odo, see(walls(), pose_at(at + 0.5f)));
  EXPECT_EQ(next.state, ft::tracking_state::tracking);
}

TYPED_TEST(OdometryRecovery, ClaimsNoPlaceThatWasNeverSeen) {
  // The new map begins in the frame in which it does without a vocabulary.
  std::vector<stereo_frame> frames(walk().begin(), walk().begin() + 8);
  auto const other = test::room::make_walls(3);
  for (int i = 0; i < 8; ++i) { frames.push_back(see(other, pose_at(static_cast<float>(i)))); }
  typename TestFixture::odometry plain(this->backend.exec, test::room::rig(), params());
  auto const want = this->run(plain, frames);
  typename TestFixture::odometry odo(this->backend.exec, test::room::rig(), params());
  odo.recognize_places(this->words.view(), how());
  auto const got = this->run(odo, frames);
  test::expect_same(got, want);
  EXPECT_EQ(got[11].state, ft::tracking_state::recovering);
  EXPECT_EQ(got[12].maps, 2);
  EXPECT_GT(odo.memory_bytes().executor, plain.memory_bytes().executor);
}

TYPED_TEST(OdometryRecovery, ABatchGivesWhatItsCamerasGiveAlone) {
  std::vector<std::vector<stereo_frame>> frames(2);
  frames[0].assign(walk().begin(), walk().begin() + 22);
  frames[0].push_back(walk()[1]);
  frames[1].assign(walk().begin() + 20, walk().begin() + 42);
  frames[1].push_back(walk()[43]);
  std::vector<std::vector<ft::tracking>> alone, together(2);
  for (auto const& f : frames) {
    typename TestFixture::odometry odo(this->backend.exec, test::room::rig(), params());
    odo.recognize_places(this->words.view(), how());
    alone.push_back(this->run(odo, f));
    EXPECT_EQ(alone.back().back().state, ft::tracking_state::tracking);
  }
  typename TestFixture::odometry odo(this->backend.exec, test::room::rig(), params(), 2);
  odo.recognize_places(this->words.view(), how());
  for (std::size_t i = 0; i < frames[0].size(); ++i) {
    std::vector<ft::stereo_images> const images{images_of(frames[0][i]), images_of(frames[1][i])};
    std::vector<std::int64_t> const times(2, static_cast<std::int64_t>(i + 1) * period);
    auto const* const t = odo.track(images.data(), times.data());
    for (std::size_t b = 0; b < 2; ++b) { together[b].push_back(t[b]); }
  }
  for (std::size_t b = 0; b < 2; ++b) { test::expect_same(together[b], alone[b]); }
}

TYPED_TEST(OdometryRecovery, RefusesWhatCannotBe) {
  typename TestFixture::odometry odo(this->backend.exec, test::room::rig(), params());
  EXPECT_THROW(odo.recognize_places({}), ft::bad_argument);
  auto p = how();
  p.candidates = 0;
  EXPECT_THROW(odo.recognize_places(this->words.view(), p), ft::bad_argument);
  this->track(odo, walk()[0]);
  EXPECT_THROW(odo.recognize_places(this->words.view(), how()), ft::bad_argument);
  static_assert(!ft::detail::recognizes_places_of<int>, "rigs that are not supported");
}

}  // namespace odometry_recovery_test
