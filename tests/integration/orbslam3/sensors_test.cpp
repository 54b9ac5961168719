// SPDX-License-Identifier: Apache-2.0
// Frames that the device extracts, of every kind of sensor: what the CPU adds to them (undistorted
// places, depth) reaches the device, and the searches find what a plain loop finds.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <cstring>
#include <memory>
#include <random>
#include <string>
#include <vector>

#include "integration/orbslam3/accelerator.hpp"
#include "tests/integration/orbslam3/backends.hpp"
#include "tests/integration/orbslam3/plain_search.hpp"
#include "tests/integration/orbslam3/scene.hpp"
#include "tests/integration/orbslam3/stand_in.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/random.hpp"

namespace orbslam3_test {

using accelerator = ft::orbslam3::accelerator<stand_in::types>;

stand_in::matrix grey(unsigned seed, int shift = 0) {
  auto const pixels = test::random_image(640, 480, seed);
  stand_in::matrix m;
  m.create(480, 640, 0);
  for (int y = 0; y < 480; ++y) {
    for (int x = 0; x < 640; ++x) {
      m.data[y * 640 + x] = pixels[static_cast<std::size_t>(y * 640 + (x + shift) % 640)];
    }
  }
  return m;
}
stand_in::matrix depth_image() {
  stand_in::matrix m;
  m.create(480, 640, 5);
  for (int y = 0; y < 480; ++y) {
    for (int x = 0; x < 640; ++x) {
      // Nothing, behind, no number, and depths.
      float const d = x % 50 == 0   ? 0.0f
                      : x % 51 == 0 ? -1.0f
                      : x % 53 == 0 ? NAN
                                    : 1.0f + static_cast<float>(x + y) / 200.0f;
      std::memcpy(m.data + 4 * (y * 640 + x), &d, 4);
    }
  }
  return m;
}
float depth_at(stand_in::matrix const& m, float x, float y) {
  float d;
  std::memcpy(&d, m.data + 4 * (static_cast<int>(y) * 640 + static_cast<int>(x)), 4);
  return d;
}

class extracted_frames : public on_executor {
protected:
  /// What Frame's constructor does for a sensor, with the shim in it.
  static stand_in::frame construct(accelerator& gpu, sensor kind, unsigned long id, unsigned seed) {
    bool const pair = kind == sensor::stereo || kind == sensor::fisheye_stereo;
    stand_in::steps by;
    by.features = [&](stand_in::frame& f) {
      if (pair) {
        gpu.extract(grey(seed), grey(seed, 9), f);
      } else {
        gpu.extract(grey(seed), f);
      }
    };
    bool const distorted = kind == sensor::rgbd || kind == sensor::monocular;
    if (distorted) {
      by.undistort = [](stand_in::frame& f) {
        for (auto& k : f.mvKeysUn) {
          k.pt.x += 0.02f * (k.pt.x - 320);
          k.pt.y += 0.02f * (k.pt.y - 240);
        }
      };
    }
    if (pair) {
      by.stereo = [&](stand_in::frame& f) { gpu.compute_stereo(f); };
    }
    if (kind == sensor::rgbd) {
      by.stereo = [&](stand_in::frame& f) {
        auto const image = depth_image();
        float const bf = settings_for(kind).bf;
        for (std::size_t i = 0; i < f.mvKeys.size(); ++i) {
          float const d = depth_at(image, f.mvKeys[i].pt.x, f.mvKeys[i].pt.y);
          f.mvDepth.push_back(d > 0 ? d : -1.0f);
          f.mvuRight.push_back(d > 0 ? f.mvKeysUn[i].pt.x - bf / d : -1.0f);
        }
      };
    }
    stand_in::frame f = stand_in::construct(kind, id, by);
    if (distorted) {
      f.mnMinX = -12;
      f.mnMinY = -9;
      f.mnMaxX = 652;
      f.mnMaxY = 489;
    }
    return f;
  }
  /// Map points along the rays of a frame's left keypoints.
  static std::vector<std::unique_ptr<stand_in::map_point>> points_of(stand_in::frame const& f,
                                                                     sensor kind) {
    auto const s = settings_for(kind);
    std::vector<std::unique_ptr<stand_in::map_point>> all;
    auto const& keys = f.Nleft != -1 ? f.mvKeys : f.mvKeysUn;
    std::mt19937 random(3);
    for (std::size_t i = 0; i < keys.size(); ++i) {
      auto p = std::make_unique<stand_in::map_point>();
      p->mnId = i + 1;
      float const z = 1.0f + static_cast<float>(random() % 700) / 100.0f;
      // Exact for a pinhole camera, near enough for the others.
      Eigen::Vector3f const P((keys[i].pt.x - s.left.values[2]) / s.left.values[0] * z,
                              (keys[i].pt.y - s.left.values[3]) / s.left.values[1] * z, z);
      p->SetWorldPos(P);
      float scale = 1;
      for (int l = 0; l < keys[i].octave; ++l) { scale *= 1.2f; }
      p->set_view(P.normalized(), P.norm() * scale / 3.6f, P.norm() * scale);
      p->set_descriptor(f.mDescriptors.data + i * static_cast<std::size_t>(f.mDescriptors.step));
      all.push_back(std::move(p));
    }
    return all;
  }
};

TEST_P(extracted_frames, are_searched_as_a_plain_loop_searches_them) {
  for (sensor const kind : all_sensors) {
    SCOPED_TRACE(name_of(kind));
    auto const s = settings_for(kind);
    accelerator gpu(make(s), s);
    plain_search const plain(s);
    bool const mono = kind == sensor::monocular || kind == sensor::fisheye_monocular;
    stand_in::frame last = construct(gpu, kind, 0, 1);
    auto const map = points_of(last, kind);
    for (std::size_t i = 0; i < map.size(); i += 2) { last.mvpMapPoints[i] = map[i].get(); }
    int found = 0;
    for (unsigned long id = 1; id < 4; ++id) {
      stand_in::frame current = construct(gpu, kind, id, id == 2 ? 4 : 1);
      current.SetPose({Eigen::Matrix3f::Identity(), Eigen::Vector3f(0.01f, 0, 0.005f)});
      stand_in::frame want = current;
      int const n = plain.search_last(want, last, 15, mono);
      EXPECT_EQ(gpu.search_by_projection(current, last, 15, mono), n);
      EXPECT_EQ(current.mvpMapPoints, want.mvpMapPoints);
      std::vector<stand_in::map_point*> local;
      for (auto& p : map) { local.push_back(p.get()); }
      int const more = plain.search_local(want, local, 3);
      EXPECT_EQ(gpu.search_local_points(current, local, 3), more);
      EXPECT_EQ(current.mvpMapPoints, want.mvpMapPoints);
      found += n + more;
      last = current;
    }
    EXPECT_GT(found, 100);
  }
}

TEST_P(extracted_frames, bring_scale_tables) {
  auto const s = settings_for(sensor::stereo);
  accelerator gpu(make(s), s);
  stand_in::frame const f = construct(gpu, sensor::stereo, 1, 2);
  ASSERT_EQ(f.mnScaleLevels, 8);
  ASSERT_EQ(f.mvScaleFactors.size(), 8u);
  EXPECT_FLOAT_EQ(f.mfLogScaleFactor, std::log(1.2f));
  for (std::size_t l = 0; l < 8; ++l) {
    EXPECT_FLOAT_EQ(f.mvScaleFactors[l], static_cast<float>(std::pow(1.2, l)));
    EXPECT_FLOAT_EQ(f.mvInvScaleFactors[l], 1 / f.mvScaleFactors[l]);
    EXPECT_FLOAT_EQ(f.mvLevelSigma2[l], f.mvScaleFactors[l] * f.mvScaleFactors[l]);
    EXPECT_FLOAT_EQ(f.mvInvLevelSigma2[l], 1 / f.mvLevelSigma2[l]);
  }
}

TEST_P(extracted_frames, refuse_images_of_another_size_or_number) {
  auto const s = settings_for(sensor::stereo);
  accelerator gpu(make(s), s);
  stand_in::frame f;
  stand_in::matrix small;
  small.create(100, 100, 0);
  EXPECT_THROW(gpu.extract(small, small, f), std::runtime_error);
  EXPECT_THROW(gpu.extract(grey(1), f), ft::bad_argument);
  EXPECT_THROW(gpu.extract(grey(1), stand_in::matrix(), f), std::runtime_error);
  EXPECT_THROW(gpu.compute_stereo(f), ft::bad_argument);
  // And goes on.
  gpu.extract(grey(1), grey(1, 9), f);
  EXPECT_GT(f.N, 100);
}

TEST_P(extracted_frames, without_undistorted_keypoints_are_refused) {
  auto const s = settings_for(sensor::stereo);
  accelerator gpu(make(s), s);
  stand_in::frame f;
  gpu.extract(grey(1), grey(1, 9), f);
  gpu.compute_stereo(f);
  f.mvpMapPoints.resize(f.mvKeys.size());
  f.mvbOutlier.resize(f.mvKeys.size());
  ASSERT_TRUE(f.mvKeysUn.empty());
  EXPECT_THROW(gpu.search_by_projection(f, f, 7, false), ft::bad_argument);
  f.mvKeysUn = f.mvKeys;
  EXPECT_EQ(gpu.search_by_projection(f, f, 7, false), 0);  // it holds no points
}

TEST_P(extracted_frames, refuse_settings_that_cannot_be) {
  auto const refused = [](auto const& change) {
    auto s = settings_for(sensor::stereo);
    change(s);
    EXPECT_THROW(make(s), std::runtime_error);
  };
  refused([](auto& s) { s.width = 0; });
  refused([](auto& s) { s.images = 3; });
  refused([](auto& s) { s.left.values[0] = 0; });
  refused([](auto& s) { s.bf = 0; });
  refused([](auto& s) { s.map_points = 0; });
  refused([](auto& s) { s.local_points = 0; });
  refused([](auto& s) { s.most_keypoints = -1; });
  refused([](auto& s) { s.levels = 30; });
}

INSTANTIATE_TEST_SUITE_P(executors, extracted_frames, ::testing::ValuesIn(executors()),
                         executor_name);

TEST(camera_parameters, are_those_of_the_geometric_camera) {
  stand_in::camera pinhole{0, {1, 2, 3, 4}};
  auto const p = ft::orbslam3::parameters_of(pinhole);
  EXPECT_EQ(p.kind, ft::orbslam3::lens::pinhole);
  EXPECT_EQ(p.values[3], 4);
  stand_in::camera fisheye{1, {1, 2, 3, 4, 5, 6, 7, 8}};
  auto const k = ft::orbslam3::parameters_of(fisheye);
  EXPECT_EQ(k.kind, ft::orbslam3::lens::kannala_brandt);
  EXPECT_EQ(k.values[7], 8);
  stand_in::camera other{2, {1, 2, 3, 4}};
  EXPECT_THROW(ft::orbslam3::parameters_of(other), ft::bad_argument);
}

// A matrix of floats in between would be another rotation.
TEST(orbslam3_poses, pass_through_double_and_are_rounded_once) {
  std::mt19937 random(3);
  std::normal_distribution<double> number;
  // Made first: where floats go back to double in one loop, g++ 12 leaves the rounding out (-O1
  // -ftree-vectorize).
  std::vector<stand_in::se3> poses;
  for (int i = 0; i < 1000; ++i) {
    Eigen::Quaterniond const q =
        Eigen::Quaterniond(number(random), number(random), number(random), number(random))
            .normalized();
    Eigen::Vector3f const t(1.25f, -2e-7f, static_cast<float>(number(random)));
    poses.emplace_back(q.cast<float>(), t);
  }
  for (stand_in::se3 const& T : poses) {
    auto const back = ft::orbslam3::pose_of<stand_in::se3>(ft::orbslam3::exact_transform_of(T));
    Eigen::Quaterniond const unit = T.unit_quaternion().cast<double>().normalized();
    Eigen::Vector4f const expected =
        ((unit.w() < 0 ? -1 : 1) * unit.coeffs()).cast<float>();  // one rotation has two
    EXPECT_EQ(back.unit_quaternion().coeffs(), expected);
    EXPECT_EQ(back.translation(), T.translation());
  }
}

}  // namespace orbslam3_test
