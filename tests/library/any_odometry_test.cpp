// SPDX-License-Identifier: Apache-2.0
// The compiled odometry answers as the headers do, to the byte; what it was not compiled for is
// refused with what there is.
#include "ft/any_odometry.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <functional>
#include <limits>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "ft/pipelines/erase.hpp"
#include "ft/pipelines/orb_extractor.hpp"
#include "library/rigs.hpp"
#include "tests/support/odometry_answers.hpp"
#include "tests/support/room.hpp"

namespace any_odometry_test {

constexpr std::int64_t period = 50'000'000;

ft::odometry_params params() {
  ft::odometry_params p = test::room::odometry_params(2048);
  p.prefetch = 2;
  return p;
}

ft::rig_description rectified() {
  ft::rectified_rig const rig = test::room::rig();
  auto const& c = rig.camera;
  auto const wide = [](float v) { return static_cast<double>(v); };
  return ft::rig_description::rectified_pair(wide(c.fx), wide(c.fy), wide(c.cx), wide(c.cy),
                                             rig.baseline);
}

std::vector<test::room::stereo_frame> const& walk() {
  static auto const frames = test::room::make_walk(test::room::rig(), 0, 12);
  return frames;
}
ft::any_images any_images_of(std::size_t i) {
  auto const& f = walk()[i];
  return {{test::room::view(f.left), test::room::view(f.right)}};
}

/// All that an odometry leaves: of each frame, of the last keypoints, and the map.
struct answers {
  std::vector<ft::tracking> frames;
  std::vector<float> depth;
  std::string map;
};
template <typename Odometry, typename ImagesOf>
answers run(Odometry& odo, ImagesOf const& images_of) {
  answers a;
  std::int64_t time = 0;
  for (std::size_t i = 0; i < walk().size(); ++i) {
    a.frames.push_back(odo.track(images_of(i), time += period));
  }
  auto const& k = odo.keypoints();
  a.depth.assign(k.depth, k.depth + k.keypoints[0]);
  std::ostringstream map;
  odo.save_map(map);
  a.map = map.str();
  return a;
}
void expect_same(answers const& a, answers const& b) {
  test::expect_same(a.frames, b.frames);
  EXPECT_EQ(a.depth, b.depth);
  EXPECT_TRUE(a.map == b.map);
}

TEST(any_odometry, tracks_keypoints_of_the_caller_as_the_headers_do) {
  auto p = params();
  p.own_features = true;
  ft::host_exec const exec;
  ft::orb_extractor extractor(exec, p.orb, 2);
  auto inner = ft::odometry(exec, test::room::rig(), p, 1, ft::own_features{});
  auto outer = ft::make_odometry({}, rectified(), p);
  std::vector<ft::tracking> a, b;
  for (auto const& f : walk()) {
    extractor.upload(exec, 0, test::room::view(f.left));
    extractor.upload(exec, 1, test::room::view(f.right));
    extractor.extract(exec);
    ft::given_features given;
    std::vector<float> positions[2];
    for (int i = 0; i < 2; ++i) {
      auto const kp = extractor.keypoints().slice(i);
      for (int k = 0; k < *kp.count; ++k) {
        positions[i].insert(positions[i].end(), {kp.x(k), kp.y(k)});
      }
      ft::image_features& of = i == 0 ? given.left : given.right;
      of.count = *kp.count;
      of.positions = positions[i].data();
      of.descriptors = &kp.orb(0);
      of.octave = &kp.octave(0);
      of.angle = &kp.angle(0);
      of.level_positions = true;
    }
    std::int64_t const time = period * static_cast<std::int64_t>(a.size() + 1);
    a.push_back(inner.track(given, time));
    b.push_back(outer.track(given, time));
    EXPECT_EQ(a.back().state, ft::tracking_state::tracking);
  }
  test::expect_same(a, b);
  auto without = ft::make_odometry({}, rectified(), params());
  EXPECT_THROW(without.track(ft::given_features{}, period), ft::bad_argument);
}

TEST(any_odometry, answers_as_the_headers_do) {
  ft::odometry<ft::host_exec> own(ft::host_exec(2), test::room::rig(), params());
  auto const expected = run(own, [](std::size_t i) { return images_of(walk()[i]); });
  ASSERT_EQ(expected.frames.back().state, ft::tracking_state::tracking);

  auto made = ft::make_odometry({}, rectified(), params());
  expect_same(run(made, any_images_of), expected);

  auto again = ft::make_odometry({}, rectified(), params());
  test::expect_same(test::track_all(again, walk().size(), period, any_images_of), expected.frames);

  ft::any_odometry erased =
      ft::erase(ft::odometry<ft::host_exec>(ft::host_exec(1), test::room::rig(), params()));
  expect_same(run(erased, any_images_of), expected);
  EXPECT_EQ(erased.calibration_warnings(), made.calibration_warnings());
  EXPECT_EQ(erased.memory_bytes().executor, made.memory_bytes().executor);
  erased.wait_for(nullptr);  // nothing to be done on the host
}

TEST(any_odometry, tracks_a_batch_and_begins_again_from_a_saved_map) {
  auto odo = ft::make_odometry({}, rectified(), params(), 2);
  std::string saved;
  std::vector<ft::tracking> alone[2];
  for (std::size_t i = 0; i < 4; ++i) {
    ft::any_images const images[] = {any_images_of(i), any_images_of(i)};
    auto const now = period * static_cast<std::int64_t>(i + 1);
    std::int64_t const times[] = {now, now};
    ft::tracking const* const t = odo.track(images, times);
    alone[0].push_back(t[0]);
    alone[1].push_back(t[1]);
  }
  test::expect_same(alone[0], alone[1]);
  EXPECT_EQ(odo.last(1).inliers, alone[1].back().inliers);
  std::stringstream map;
  odo.save_map(map, 0);
  odo.load_map(map, 1);
  EXPECT_EQ(odo.download_map(1).points.size(), odo.download_map(0).points.size());
  odo.reset(0);
  EXPECT_THROW(odo.track(any_images_of(0), 1), ft::bad_argument);  // one of a batch of two
}

std::string message_of(std::function<void()> const& f) {
  try {
    f();
  } catch (ft::bad_argument const& e) { return e.what(); }
  return "nothing was thrown";
}
#define EXPECT_REFUSED(expression, part)                               \
  do {                                                                 \
    std::string const said = message_of([&] { expression; });          \
    EXPECT_NE(said.find(part), std::string::npos) << "said: " << said; \
  } while (false)

TEST(any_odometry, refuses_what_it_was_not_compiled_for) {
  auto const refused = [&](ft::rig_description const& rig, char const* part) {
    EXPECT_REFUSED(ft::make_odometry({}, rig, params()), part);
  };
  auto const camera = [](ft::camera_kind kind) {
    return ft::camera_description::make(kind, {300, 300, 240, 180});
  };
  auto const sphere = camera(ft::camera_kind::double_sphere);
  auto const body = ft::rigid<double>::identity();
  char const* const other =
      "camera 0 of the monocular rig is double_sphere; ft::odometry was "
      "compiled for monocular of pinhole or kannala_brandt. ft::erase()";
  refused(ft::rig_description::monocular(sphere), other);
  refused(ft::rig_description::rgbd(sphere, 0.1), "rgbd of pinhole or radtan8");
  refused(ft::rig_description::fisheye_pair(camera(ft::camera_kind::kannala_brandt), sphere, body),
          "camera 1 of the fisheye_pair rig is double_sphere");
  ft::rig_description rig = rectified();
  rig.kind = static_cast<ft::rig_kind>(9);
  refused(rig, "rig_description::kind is 9, must be in [0, 5]");
  rig = rectified();
  rig.camera[0].kind = ft::camera_kind::radtan8;
  refused(rig, "rectified_pair rig is radtan8; ft::odometry was compiled for");
}

TEST(any_odometry, refuses_rigs_that_contradict_themselves) {
  auto const refused = [&](ft::rig_description const& rig, char const* part) {
    EXPECT_REFUSED(ft::make_odometry({}, rig, params()), part);
  };
  ft::rig_description rig = rectified();
  rig.cameras = 2;
  refused(rig, "a rectified_pair rig has 2 cameras, must have 1");
  rig.kind = ft::rig_kind::multi;
  for (int n : {0, -1, 17}) {
    rig.cameras = n;
    refused(rig, "cameras, must have 1 to 16");
  }
  auto const fisheye =
      ft::camera_description::make(ft::camera_kind::kannala_brandt, {300, 300, 240, 180});
  rig = ft::rig_description::fisheye_pair(fisheye, fisheye, ft::rigid<double>::identity());
  refused(rig, "baseline is 0");
  rig.camera[0].T_camera_body.t.x = 0.1;
  refused(rig, "must be the identity");
  rig.cameras = 1;
  refused(rig, "has 1 cameras, must have 2");
  rig = rectified();
  rig.camera[0].parameters[0] = std::numeric_limits<double>::quiet_NaN();
  refused(rig, "fx is nan");
  EXPECT_REFUSED(
      ft::camera_description::make(ft::camera_kind::pinhole,
                                   {1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17}),
      "17 parameters, must have at most 16");
}

TEST(any_odometry, refuses_readouts_that_are_none) {
  auto const refused = [&](ft::rig_description const& rig, char const* part) {
    EXPECT_REFUSED(ft::make_odometry({}, rig, params()), part);
  };
  ft::rig_description rig = rectified();
  rig.camera[0].readout_s = -0.001;
  refused(rig, "readout_s of camera 0 is -0.001");
  rig.camera[0].readout_s = std::numeric_limits<double>::quiet_NaN();
  refused(rig, "readout_s of camera 0 is nan, must be in [0, 0.1]");
  rig.camera[0].readout_s = 0.2;
  refused(rig, "readout_s of camera 0 is 0.2");
  auto const fisheye =
      ft::camera_description::make(ft::camera_kind::kannala_brandt, {300, 300, 240, 180});
  auto T = ft::rigid<double>::identity();
  T.t.x = -0.1;
  rig = ft::rig_description::fisheye_pair(fisheye, fisheye, T);
  rig.camera[1].readout_s = 0.02;
  refused(rig, "readout_s of the cameras of a fisheye_pair are 0.000000 and 0.020000");
}

TEST(any_odometry, refuses_devices_that_are_not_there) {
  int const gpus = static_cast<int>(ft::gpu_names().size());
  auto const refused = [&](int gpu, char const* part) {
    ft::device where;
    where.gpu = gpu;
    EXPECT_REFUSED(ft::make_odometry(where, rectified(), params()), part);
  };
  refused(-3, "gpu is -3, must be");
  if (gpus == 0) {
    try {
      ft::device where;
      where.gpu = 0;
      static_cast<void>(ft::make_odometry(where, rectified(), params()));
      ADD_FAILURE() << "nothing was thrown";
    } catch (ft::error const&) {}  // no CUDA, or no device
  } else {
    refused(gpus, "gpu is ");
  }
  ft::device where;
  where.threads = -1;
  EXPECT_REFUSED(ft::make_odometry(where, rectified(), params()), "threads is -1");
}

TEST(any_odometry, refuses_calls_before_it_is_made) {
  ft::any_odometry none;
  EXPECT_REFUSED(none.track(any_images_of(0), 1), "never made, or was moved from");
  EXPECT_REFUSED(none.params(), "never made, or was moved from");
  auto odo = ft::make_odometry({}, rectified(), params());
  ft::any_odometry const moved = std::move(odo);
  EXPECT_EQ(moved.batch(), 1);
  EXPECT_REFUSED(odo.reset(), "never made, or was moved from");  // NOLINT(bugprone-use-after-move)
  EXPECT_REFUSED(moved.keypoints(); ft::any_odometry(nullptr).capacity(), "never made");
}

// ---- rigs from their descriptions

using ft::library::host::distorted_pair_of;
using ft::library::host::multi_of;
using ft::library::host::rgbd_of;

TEST(rig_description, keeps_every_number_of_a_camera) {
  auto const c = ft::camera_description::make(ft::camera_kind::radtan8,
                                              {400, 401, 320, 240, .1, .2, .3, .4, .5, .6, .7, .8});
  auto rig = ft::rig_description::rgbd(c, 0.08, 0.001);
  auto const camera =
      ft::library::host::camera_of<ft::radtan8<float>>(rig, 0, ft::camera_kind::radtan8, "");
  EXPECT_EQ(camera.fx, 400.0f);
  EXPECT_EQ(camera.fy, 401.0f);
  EXPECT_EQ(camera.cx, 320.0f);
  EXPECT_EQ(camera.cy, 240.0f);
  for (int i = 0; i < 8; ++i) { EXPECT_EQ(camera.distortion[i], 0.1f * float(i + 1)) << i; }
  rig.min_depth = 0.3;
  rig.max_depth = 4;
  rig.camera[0].readout_s = 0.02;
  auto const made = rgbd_of(rig, camera);
  EXPECT_EQ(made.readout_s, 0.02f);
  EXPECT_EQ(made.baseline, 0.08);
  EXPECT_EQ(made.depth_scale, 0.001f);
  EXPECT_EQ(made.min_depth, 0.3f);
  EXPECT_EQ(made.max_depth, 4.0f);
}

TEST(rig_description, is_the_rig_of_the_headers) {
  using camera = ft::radtan8<float>;
  ft::rig_description rig;
  rig.kind = ft::rig_kind::distorted_pair;
  rig.cameras = 2;
  rig.camera[0] =
      ft::camera_description::make(ft::camera_kind::radtan8, {400, 401, 320, 240, -0.2, 0.05});
  rig.camera[1] = ft::camera_description::make(ft::camera_kind::radtan8, {402, 403, 321, 241});
  rig.camera[1].T_camera_body.t = {-0.11, 0.001, 0.002};
  double const wanted[] = {390, 390, 319, 239};
  std::copy(wanted, wanted + 4, rig.rectified);
  rig.raw_width = 640;
  rig.raw_height = 480;
  rig.camera[0].readout_s = rig.camera[1].readout_s = 0.02;
  auto const made = distorted_pair_of(rig);
  EXPECT_EQ(made.readout_s, 0.02f);
  auto const expected = ft::distorted_pair<camera>::make(
      {400, 401, 320, 240, {-0.2f, 0.05f}}, {402, 403, 321, 241, {}},
      rig.camera[1].T_camera_body.cast<float>(), {390, 390, 319, 239});
  EXPECT_EQ(std::memcmp(&made.left, &expected.left, sizeof made.left), 0);
  EXPECT_EQ(std::memcmp(&made.right, &expected.right, sizeof made.right), 0);
  EXPECT_EQ(std::memcmp(&made.R_left, &expected.R_left, sizeof made.R_left), 0);
  EXPECT_EQ(std::memcmp(&made.target.camera, &expected.target.camera, sizeof(ft::pinhole<float>)),
            0);
  EXPECT_EQ(made.target.baseline, expected.target.baseline);
  EXPECT_EQ(made.width, 640);
  EXPECT_EQ(made.height, 480);
}

TEST(rig_description, fills_a_multi_rig) {
  ft::rig_description rig;
  rig.kind = ft::rig_kind::multi;
  rig.cameras = 3;
  for (int i = 0; i < 3; ++i) {
    rig.camera[i] =
        ft::camera_description::make(ft::camera_kind::pinhole, {300.0 + i, 301, 240, 180});
    rig.camera[i].baseline = i == 1 ? 0 : 0.1;
    rig.camera[i].T_camera_body.t.x = i;
    rig.camera[i].readout_s = 0.01 * i;
  }
  auto const made = multi_of<4>(rig);
  for (int i = 0; i < 3; ++i) {
    EXPECT_EQ(made.of[i].camera.fx, 300.0f + float(i));
    EXPECT_EQ(made.of[i].single(), i == 1);
    EXPECT_EQ(made.of[i].T_cb.t.x, float(i));
    EXPECT_FLOAT_EQ(made.of[i].readout_s, 0.01f * float(i));
    EXPECT_TRUE(made.of[i].used);
  }
  EXPECT_FALSE(made.of[3].used);
}

TEST(rig_description, fills_a_mixed_rig) {
  auto const fisheye = ft::camera_description::make(ft::camera_kind::kannala_brandt,
                                                    {300, 301, 240, 180, 0.1, 0.2, 0.3, 0.4});
  ft::rig_description rig;
  rig.kind = ft::rig_kind::multi;
  rig.cameras = 4;
  rig.camera[0] = rig.camera[2] = fisheye;
  rig.camera[0].right = 2;
  rig.camera[2].T_camera_body.t.x = -0.2;
  rig.camera[1] = ft::camera_description::make(ft::camera_kind::pinhole, {300, 301, 240, 180});
  rig.camera[1].baseline = 0.1;
  rig.camera[3] =
      ft::camera_description::make(ft::camera_kind::radtan5, {310, 311, 241, 181, -0.1, 0.01});
  rig.camera[3].baseline = 0.08;
  rig.camera[3].has_depth_image = true;
  rig.depth_scale = 0.001;
  rig.max_depth = 4;
  rig.camera[2].readout_s = 0.02;
  auto const made = ft::library::host::mixed_of<5>(rig);
  EXPECT_EQ(made.of[2].readout_s, 0.02f);
  made.check();
  EXPECT_EQ(made.of[0].right, 2);
  EXPECT_EQ(made.of[2].left, 0);
  EXPECT_NEAR(made.of[0].baseline, 0.2, 1e-7);
  EXPECT_TRUE(made.of[0].camera.is(ft::camera_kind::kannala_brandt));
  EXPECT_EQ(made.of[0].camera.more[3], 0.4f);
  EXPECT_TRUE(made.of[1].has_right_image);
  EXPECT_TRUE(made.of[3].camera.is(ft::camera_kind::radtan8));
  EXPECT_EQ(made.of[3].camera.more[1], 0.01f);
  EXPECT_TRUE(made.of[3].has_depth_image);
  EXPECT_EQ(made.of[3].depth_scale, 0.001f);
  EXPECT_EQ(made.of[3].max_depth, 4.0f);
  EXPECT_FALSE(made.of[4].used);
  auto const refused = [](ft::rig_description const& of, char const* part) {
    EXPECT_REFUSED(ft::make_odometry({}, of, params()), part);
  };
  auto wrong = rig;
  wrong.camera[0].right = 4;
  refused(wrong, "right camera of camera 0 is 4, must be below 4");
  wrong.camera[0].right = -2;
  refused(wrong, "right camera of camera 0 is -2, must be below 4, or -1 for none");
  wrong = rig;
  wrong.camera[1].right = 2;  // of two left ones
  wrong.camera[1].baseline = 0;
  refused(wrong, "do not name each other as a pair");
  wrong = rig;
  wrong.camera[3].kind = ft::camera_kind::unified;
  refused(wrong, "camera 3 of the multi rig is unified; ft::odometry was compiled for multi rigs");
}

}  // namespace any_odometry_test
