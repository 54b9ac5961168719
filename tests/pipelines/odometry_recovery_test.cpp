// SPDX-License-Identifier: Apache-2.0
// An odometry with a vocabulary: a camera that is carried to another place of its map is found
// there, one that is carried elsewhere is not, and nothing changes for one that is not lost.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <istream>
#include <memory>
#include <sstream>
#include <vector>

#include "ft/cameras/distorted_pair.hpp"
#include "ft/cameras/multi_rig.hpp"
#include "ft/cameras/radtan.hpp"
#include "ft/cameras/rgbd_rig.hpp"
#include "ft/containers/vocabulary.hpp"
#include "ft/containers/vocabulary_files.hpp"
#include "ft/pipelines/odometry.hpp"
#include "ft/pipelines/orb_extractor.hpp"
#include "tests/support/allocation_count.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/odometry_answers.hpp"
#include "tests/support/random.hpp"
#include "tests/support/room.hpp"
#include "tests/support/trained_vocabulary.hpp"

namespace odometry_recovery_test {

using test::at;
using test::room::image;
using test::room::images_of;
using test::room::see;
using test::room::stereo_frame;
constexpr std::int64_t period = 50'000'000;
constexpr int steps = 34;

/// The pose, camera to world, after a number of steps: the camera turns and goes on.
ft::pose pose_at(float step, float yaw_error = 0, ft::vec3<float> const& error = {0, 0, 0}) {
  float const yaw = 0.08f * step + yaw_error;
  float const c = std::cos(yaw), s = std::sin(yaw);
  return {{{c, 0, s, 0, 1, 0, -s, 0, c}},
          {0.01f * step + error.x, error.y, 1.0f + 0.02f * step + error.z}};
}

std::vector<image> const& walls() {
  static auto const made = test::room::make_walls(0);
  return made;
}

/// The frame of a step, rendered once.
stereo_frame const& step(int i) {
  static std::vector<stereo_frame> frames(steps);
  stereo_frame& f = frames[at(i)];
  if (f.left.empty()) {
    f = see(test::room::rig(), walls(), pose_at(static_cast<float>(i)).inverse());
  }
  return f;
}
std::vector<stereo_frame> walk(int first, int count) {
  std::vector<stereo_frame> frames;
  for (int i = 0; i < count; ++i) { frames.push_back(step(first + i)); }
  return frames;
}
stereo_frame const& black() {
  static stereo_frame const frame = [] {
    image const none(at(test::room::width) * at(test::room::height));
    return stereo_frame{none, none, step(0).T_cw};
  }();
  return frame;
}
/// Some steps, black images, and a place that was seen `back` steps before the last one.
std::vector<stereo_frame> carried_back(int first, int count, int back) {
  auto frames = walk(first, count);
  frames.push_back(black());
  frames.push_back(black());
  frames.push_back(step(first + count - 1 - back));
  return frames;
}

/// Whether a frame is tracked, and where the camera is: within 0.1 m and about 2 degrees.
bool is_right(ft::tracking const& t, ft::pose const& T_cw, ft::pose const& first_T_cw) {
  auto const want = first_T_cw.cast<double>() * T_cw.cast<double>().inverse();
  auto const d = t.T_world_camera.t - want.t;
  auto const turn = t.T_world_camera.R.transposed() * want.R;
  return t.state == ft::tracking_state::tracking && std::sqrt(ft::dot(d, d)) < 0.1 &&
         turn.m[0] + turn.m[4] + turn.m[8] > 2.998;
}

ft::odometry_params params() {
  auto p = test::room::odometry_params(8192);
  p.keyframes = 40;
  p.window = {4, 2};
  p.rules.matches_without_window = false;  // words alone find the camera
  return p;
}
/// A lost camera is searched for in narrow windows, which do not reach from one place to the next.
ft::odometry_params narrow() {
  auto p = params();
  p.rules.first_wide_search = p.rules.later_wide_search = 1;
  return p;
}
/// For a small vocabulary.
ft::place_recovery how() {
  ft::place_recovery p;
  p.levels_up = 1;
  return p;
}

/// A vocabulary that is trained with the keypoints of some frames.
ft::vocabulary<ft::memory_space::host> const& trained() {
  static auto const words = [] {
    ft::host_exec const exec;
    ft::orb_extractor<ft::host_exec> extractor(exec, params().orb, 1);
    std::vector<ft::descriptor> all;
    for (int i = 0; i < steps; i += 4) {
      extractor.upload(exec, 0, test::room::view(step(i).left));
      extractor.extract(exec);
      auto const keypoints = extractor.keypoints();
      for (int k = 0; k < *keypoints.count; ++k) { all.push_back(keypoints.orb(k)); }
    }
    return ft::make_vocabulary(test::trained_vocabulary(all, 10, 3).arrays());
  }();
  return words;
}

/// Places of its map that a camera is carried to, each far from the one before.
std::vector<stereo_frame> const& jumps() {
  static auto const frames = [] {
    std::vector<stereo_frame> all;
    test::generator random(5);
    float at = static_cast<float>(steps - 1);
    for (int jump = 0; jump < std::max(5, test::effort(20)); ++jump) {
      float to = at;
      while (std::abs(to - at) < 11) { to = random.real(2, static_cast<float>(steps - 3)); }
      at = to;
      float const x = random.real(-0.1f, 0.1f), y = random.real(-0.05f, 0.05f);
      float const z = random.real(-0.1f, 0.1f);
      all.push_back(see(test::room::rig(), walls(),
                        pose_at(to, random.real(-0.05f, 0.05f), {x, y, z}).inverse()));
    }
    return all;
  }();
  return frames;
}

/// What becomes of a camera that is carried to all jumps, for three frames each.
struct journey {
  int found = 0;  ///< jumps
  int wrong = 0;  ///< frames that claim another place
};
template <typename Odometry>
journey carry(Odometry& odo) {
  journey j;
  std::int64_t time = 0;
  for (int i = 0; i < steps; ++i) { odo.track(images_of(step(i)), time += period); }
  EXPECT_TRUE(is_right(odo.last(), step(steps - 1).T_cw, step(0).T_cw));
  for (auto const& f : jumps()) {
    bool found = false;
    for (int i = 0; i < 3 && !found; ++i) {
      auto const t = odo.track(images_of(f), time += period);
      found = is_right(t, f.T_cw, step(0).T_cw);
      j.wrong += static_cast<int>(!found && t.state == ft::tracking_state::tracking);
    }
    j.found += static_cast<int>(found);
  }
  return j;
}
ft::odometry_params patient() {
  auto p = params();
  p.rules.patience = 1000;
  return p;
}

template <typename Odometry>
std::vector<ft::tracking> run(Odometry& odo, std::vector<stereo_frame> const& frames) {
  std::vector<ft::tracking> all;
  std::int64_t time = 0;
  for (auto const& f : frames) { all.push_back(odo.track(images_of(f), time += period)); }
  return all;
}
template <typename Exec>
std::vector<ft::tracking> run_with_words(Exec const& exec, std::vector<stereo_frame> const& frames,
                                         ft::vocabulary_view const& words) {
  ft::odometry odo(exec, test::room::rig(), narrow(), 1, ft::places{words, how()});
  return run(odo, frames);
}

template <typename Backend>
class OdometryRecovery : public test::on_backend<Backend> {
protected:
  using exec_type = typename Backend::exec_type;
  Backend backend;
  exec_type exec = backend.exec;
  ft::vocabulary<exec_type::space> words;

  void SetUp() override {
    test::on_backend<Backend>::SetUp();
    if (!this->IsSkipped()) { words = ft::upload(exec, trained().view()); }
  }
};
TYPED_TEST_SUITE(OdometryRecovery, test::backends);

TYPED_TEST(OdometryRecovery, FindsACameraThatWasCarriedAway) {
  ft::odometry odo(this->exec, test::room::rig(), patient(), 1,
                   ft::places{this->words.view(), how()});
  journey const with = carry(odo);
  int const all = static_cast<int>(jumps().size());
  EXPECT_GE(with.found, all - std::max(1, all / 20));
  EXPECT_EQ(with.wrong, 0);
  EXPECT_EQ(odo.last().maps, 1);
  EXPECT_GE(odo.last().inliers, 30);
  EXPECT_LT(odo.last().covariance[0], 1e-3);
  ft::odometry plain(this->exec, test::room::rig(), patient());
  journey const without = carry(plain);
  EXPECT_LT(without.found, all / 2) << "the words did not make the difference";
  this->RecordProperty("found", with.found);
  this->RecordProperty("found_without_words", without.found);
}

TYPED_TEST(OdometryRecovery, ClaimsNoPlaceThatWasNeverSeen) {
  // The new map begins in the frame in which it does without a vocabulary.
  auto frames = walk(0, 6);
  auto const other = test::room::make_walls(3);
  for (int i = 0; i < 7; ++i) {
    frames.push_back(see(test::room::rig(), other, pose_at(static_cast<float>(i)).inverse()));
  }
  ft::odometry plain(this->exec, test::room::rig(), params());
  auto const want = run(plain, frames);
  ft::odometry odo(this->exec, test::room::rig(), params(), 1,
                   ft::places{this->words.view(), how()});
  auto const got = run(odo, frames);
  test::expect_same(got, want);
  EXPECT_EQ(got[9].state, ft::tracking_state::recovering);
  EXPECT_EQ(got[10].maps, 2);
  EXPECT_EQ(got.back().state, ft::tracking_state::tracking);
  EXPECT_GT(odo.memory_bytes().executor, plain.memory_bytes().executor);
}

TYPED_TEST(OdometryRecovery, ABatchGivesWhatItsCamerasGiveAlone) {
  // Not lost at the same time.
  std::vector<std::vector<stereo_frame>> frames{carried_back(0, 9, 7), carried_back(20, 7, 5)};
  for (int i = 22; i < 24; ++i) { frames[1].push_back(step(i)); }
  constexpr std::size_t last_dark[] = {10, 8};
  ft::odometry odo(this->exec, test::room::rig(), narrow(), 2,
                   ft::places{this->words.view(), how()});
  std::vector<std::vector<ft::tracking>> together(2);
  for (std::size_t i = 0; i < frames[0].size(); ++i) {
    std::vector<ft::stereo_images> const images{images_of(frames[0][i]), images_of(frames[1][i])};
    std::vector<std::int64_t> const times(2, static_cast<std::int64_t>(i + 1) * period);
    auto const* const t = odo.track(images.data(), times.data());
    for (std::size_t b = 0; b < 2; ++b) { together[b].push_back(t[b]); }
  }
  for (std::size_t b = 0; b < 2; ++b) {
    auto const alone = run_with_words(this->exec, frames[b], this->words.view());
    test::expect_same(together[b], alone);
    EXPECT_EQ(alone[last_dark[b]].state, ft::tracking_state::recovering) << "black images";
    auto p = narrow();
    p.prefetch = 2;
    ft::odometry early(this->exec, test::room::rig(), p, 1, ft::places{this->words.view(), how()});
    test::expect_same(test::track_all(early, frames[b].size(), period,
                                      [&](std::size_t i) { return images_of(frames[b][i]); }),
                      alone);
    EXPECT_TRUE(is_right(alone.back(), frames[b].back().T_cw, frames[b][0].T_cw)) << b;
  }
}

/// Steps of another rig, and a place that was seen before: it is found with a vocabulary alone.
template <typename Exec, typename Rig, typename Images>
void expect_found(Exec const& exec, Rig const& rig, std::vector<stereo_frame> const& frames,
                  ft::vocabulary_view const& words, Images const& images) {
  for (bool const with : {false, true}) {
    using odometry = ft::odometry<Exec, Rig>;
    auto odo = with ? odometry(exec, rig, narrow(), 1, ft::places{words, how()})
                    : odometry(exec, rig, narrow());
    std::int64_t time = 0;
    for (auto const& f : frames) { odo.track(images(f), time += period); }
    EXPECT_EQ(is_right(odo.last(), frames.back().T_cw, frames[0].T_cw), with);
  }
}

TYPED_TEST(OdometryRecovery, FindsTwoFisheyeCameras) {
  auto const rig = test::room::fisheye();
  std::vector<stereo_frame> frames;
  for (int i = 0; i < 9; ++i) {
    frames.push_back(see(rig, walls(), pose_at(static_cast<float>(i)).inverse()));
  }
  frames.push_back(frames[1]);
  expect_found(this->exec, rig, frames, this->words.view(), images_of);
}

TYPED_TEST(OdometryRecovery, FindsAPairThatIsRectifiedFirst) {
  if (!test::whole_effort()) { GTEST_SKIP() << "FT_TEST_EFFORT asks for less"; }
  ft::distorted_pair<ft::radtan8<float>> rig;
  auto const& camera = test::room::rig().camera;
  rig.left = rig.right = {camera.fx, camera.fy, camera.cx, camera.cy, {}};
  rig.target = test::room::rig();
  expect_found(this->exec, rig, carried_back(0, 9, 7), this->words.view(), images_of);
}

TYPED_TEST(OdometryRecovery, FindsAnRgbdCamera) {
  if (!test::whole_effort()) { GTEST_SKIP() << "FT_TEST_EFFORT asks for less"; }
  auto const camera = test::room::rig().camera;
  std::vector<float> depth;
  auto const images = [&](stereo_frame const& f) {
    depth.clear();
    for (int v = 0; v < test::room::height; ++v) {
      for (int u = 0; u < test::room::width; ++u) {
        auto const p = test::room::look(camera, f.T_cw.inverse(), static_cast<float>(u),
                                        static_cast<float>(v));
        depth.push_back(static_cast<float>((f.T_cw.cast<double>() * p.point).z));
      }
    }
    return ft::rgbd_images{test::room::view(f.left),
                           ft::image_view<float const>{depth.data(), test::room::width,
                                                       test::room::height, test::room::width}};
  };
  expect_found(this->exec, ft::rgbd_rig<>::make(camera, 0.25), carried_back(0, 9, 7),
               this->words.view(), images);
}

/// As in docs/guide.md. Calls use(odometry&).
template <typename Exec, typename Rig, typename Use>
void with_file(Exec const& exec, Rig const& rig, ft::odometry_params const& params,
               std::istream& file, Use const& use) {
  auto words = ft::upload(exec, ft::load_vocabulary(file).view());
  ft::odometry odometry(exec, rig, params, 1, ft::places{words.view()});
  use(odometry);
}

TYPED_TEST(OdometryRecovery, ForgetsTheKeyframesOfAMapThatIsReplaced) {
  std::stringstream file;
  ft::save_vocabulary(file, trained().view());
  auto const frames = carried_back(0, 9, 7);
  with_file(this->exec, test::room::rig(), narrow(), file, [&](auto& odo) {
    EXPECT_EQ(run(odo, frames).back().state, ft::tracking_state::tracking);
    // A loaded map has no words, and none of those from before.
    std::stringstream map;
    odo.save_map(map);
    odo.load_map(map);
    EXPECT_NE(odo.track(images_of(frames.back()), 1).state, ft::tracking_state::tracking);
  });
}

TYPED_TEST(OdometryRecovery, RefusesWhatCannotBe) {
  auto const view = this->words.view();
  auto const pair = test::room::rig();
  auto const make = [&](ft::odometry_params const& p, ft::places const& with, auto const& rig) {
    return ft::odometry(this->exec, rig, p, 1, with);
  };
  EXPECT_THROW(make(params(), {}, pair), ft::bad_argument);
  auto p = how();
  p.candidates = 0;
  EXPECT_THROW(make(params(), {view, p}, pair), ft::bad_argument);
  p = how();
  p.levels_up = -1;
  EXPECT_THROW(make(params(), {view, p}, pair), ft::bad_argument);
  auto with_imu = params();
  with_imu.imu.present = true;
  with_imu.window = {10, 5};
  EXPECT_THROW(ft::odometry(this->exec, pair, with_imu, 1, ft::inertial{}, ft::places{view, how()}),
               ft::bad_argument);
  auto unchanged = params();
  unchanged.rules.localize_only = true;
  EXPECT_THROW(make(unchanged, {view, how()}, pair), ft::bad_argument);
  ft::multi_rig<1> const rig{{{pair.camera, pair.baseline, ft::pose::identity()}}};
  EXPECT_THROW(make(params(), {view, how()}, rig), ft::bad_argument);
}

#if !defined(__CUDACC__)

TEST(OdometryRecoveryOnTheHost, AllocatesNothingInAFrame) {
  auto const frames = carried_back(0, 9, 7);
  ft::odometry odo(ft::host_exec(1), test::room::rig(), narrow(), 1,
                   ft::places{trained().view(), how()});
  test::allocation_count const allocations;
  auto const one = std::make_unique<int>(1);
  if (allocations.so_far() == 0) { GTEST_SKIP() << "this program does not count allocations"; }
  std::int64_t time = 0;
  for (auto const& f : frames) { odo.track(images_of(f), time += period); }
  EXPECT_EQ(allocations.so_far(), *one);
  EXPECT_EQ(odo.last().state, ft::tracking_state::tracking);
}

#else

TEST(OdometryRecoveryParity, HostAndDeviceGiveTheSameBits) {
  if (!test::cuda_backend::available()) { GTEST_SKIP() << "no CUDA device"; }
  test::cuda_backend backend;
  auto const frames = carried_back(0, 9, 7);
  auto const& host = trained();
  auto const words = ft::upload(backend.exec, host.view());
  test::expect_same(run_with_words(backend.exec, frames, words.view()),
                    run_with_words(ft::host_exec(), frames, host.view()));
}

#endif

}  // namespace odometry_recovery_test
